//! ChArUco boards: inner corners of a chessboard, named by the markers in its white squares (Garrido-Jurado et al. 2014).

use super::{
    Board,
    growth::{Growth, Target},
    markers::{PlacedMarker, charuco_is_white, pairs},
    plane::LocalPlane,
    saddle::Saddle,
};
use crate::tag::LinearLuma;

/// What a board looks like around its inner corners.
pub(super) fn targets(board: &Board) -> Vec<Target> {
    let Board::Charuco {
        columns,
        rows,
        square_m,
        side_m,
        pattern,
        ..
    } = *board
    else {
        return Vec::new();
    };
    let corners = board.corners_m().into_iter().zip(0..);
    corners
        .map(|(corner, index)| {
            let (column, row) = (index % (columns - 1), index / (columns - 1));
            Target {
                place_m: corner.truncate(),
                edge_m: square_m,
                band_m: 0.5 * (square_m - side_m),
                // The square to the bottom left of the corner; rows count from the top there, from the bottom here.
                rising_black: !charuco_is_white(column, rows - 1 - row, rows, pattern),
            }
        })
        .collect()
}

/// The inner corners of a board some of whose markers were found.
pub(super) fn corners(
    luma: &LinearLuma,
    targets: &[Target],
    pitch_m: f64,
    markers: &[PlacedMarker],
) -> Vec<(usize, Saddle)> {
    let mut growth = Growth::new(luma, targets, pitch_m);
    for marker in markers {
        let Some(plane) = LocalPlane::fit(&pairs(marker).collect::<Vec<_>>()) else {
            continue;
        };
        let middle = 0.5 * (marker.corners_m[0] + marker.corners_m[2]);
        for (index, target) in targets.iter().enumerate() {
            if target.place_m.distance(middle) < 0.75 * pitch_m {
                growth.try_at(index, &plane);
            }
        }
    }
    growth.finish()
}
