//! AprilGrids: four corners per marker, each shared with a small black square.

use glam::DVec2;

use super::{
    Board,
    growth::{Growth, Target},
    markers::{PlacedMarker, pairs},
    plane::LocalPlane,
    saddle::Saddle,
};
use crate::tag::{Layout, LinearLuma};

/// What a grid looks like around its corners.
pub(super) fn targets(board: &Board) -> Vec<Target> {
    let Board::AprilGrid {
        family,
        side_m,
        spacing_m: gap_m,
        border_bits,
        ..
    } = *board
    else {
        return Vec::new();
    };
    let border_m = side_m * f64::from(border_bits) / Layout::new(family, border_bits).quad_cells() as f64;
    let corners = board.corners_m().into_iter().enumerate();
    corners
        .map(|(index, corner)| Target {
            place_m: corner.truncate(),
            edge_m: gap_m,
            band_m: border_m.min(gap_m),
            // Bottom-left and top-right corners have the marker to the top right or the bottom left.
            rising_black: index % 2 == 0,
        })
        .collect()
}

/// The corners of a grid some of whose markers were found.
pub(super) fn corners(
    luma: &LinearLuma,
    targets: &[Target],
    pitch_m: f64,
    markers: &[PlacedMarker],
) -> Vec<(usize, Saddle)> {
    let mut growth = Growth::new(luma, targets, pitch_m);
    for marker in markers {
        let pairs: Vec<(DVec2, DVec2)> = pairs(marker).collect();
        let Some(plane) = LocalPlane::fit(&pairs) else {
            continue;
        };
        for (corner, (_, pixel)) in pairs.iter().enumerate() {
            let index = 4 * marker.number as usize + corner;
            if !growth.try_at(index, &plane) {
                growth.assume(index, *pixel);
            }
        }
    }
    growth.finish()
}
