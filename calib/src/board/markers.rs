//! Markers of a board: where they are printed, and which of those found belong together.

use glam::{DMat2, DVec2};

use super::{Board, CharucoPattern};
use crate::tag::{Detection, Family};

/// Largest difference between the ways from one marker to a neighbour in the picture and on paper, relative.
const MAX_DISAGREEMENT: f64 = 0.25;

/// Markers this far apart, in pitches of the board, are neighbours: the diagonal one, or one beyond a missing one.
const NEIGHBOURHOOD: f64 = 2.1;

/// A marker on paper and in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlacedMarker {
    /// Its number on the board, from 0.
    pub(super) number: u32,
    /// Its corners on the board, in metres.
    pub(super) corners_m: [DVec2; 4],
    /// The same corners in the picture.
    pub(super) corners_px: [DVec2; 4],
}

/// Columns and rows of the squares with markers of a ChArUco board, from the top left, in the order of their ids.
pub(super) fn charuco_squares(columns: u32, rows: u32, pattern: CharucoPattern) -> impl Iterator<Item = [u32; 2]> {
    let white = (0..rows).flat_map(move |row| (0..columns).map(move |column| [column, row]));
    white.filter(move |&[column, row]| charuco_is_white(column, row, rows, pattern))
}

/// Whether a square of a ChArUco board is white; row 0 is at the top.
pub(super) fn charuco_is_white(column: u32, row: u32, rows: u32, pattern: CharucoPattern) -> bool {
    match pattern {
        CharucoPattern::BlackTopLeft => (column + row) % 2 == 1,
        CharucoPattern::BlackBottomLeft => (column + rows - 1 - row) % 2 == 1,
    }
}

impl Board {
    /// Corners of every marker, by its number on the board, in metres: bottom-left, bottom-right, top-right, top-left of
    /// the upright marker as AprilRobotics or ArUco defines it. A chessboard has none.
    pub(super) fn markers_m(&self) -> Vec<[DVec2; 4]> {
        let square = |low: DVec2, side: f64| [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|c| low + c * side);
        match *self {
            Self::AprilGrid {
                columns,
                rows,
                side_m,
                spacing_m,
                ..
            } => super::grid(columns, rows)
                .map(|cell| square(cell * (side_m + spacing_m), side_m))
                .collect(),
            Self::Charuco {
                family,
                columns,
                rows,
                square_m,
                side_m,
                pattern,
                ..
            } => charuco_squares(columns, rows, pattern)
                .map(|[column, row]| {
                    let cell = DVec2::new(f64::from(column), f64::from(rows - 1 - row));
                    let corners = square(cell * square_m + 0.5 * (square_m - side_m), side_m);
                    match family {
                        // OpenCV prints AprilTags turned by half a turn.
                        Family::Tag36h11 | Family::Tag25h9 | Family::Tag16h5 | Family::TagStandard41h12 => {
                            std::array::from_fn(|i| corners[(i + 2) % 4])
                        }
                        Family::Aruco4x4(_) | Family::Aruco5x5(_) | Family::Aruco6x6(_) => corners,
                    }
                })
                .collect(),
            Self::Chessboard { .. } => Vec::new(),
        }
    }

    /// Distance of neighbouring markers' middles, in metres; of a chessboard's corners.
    pub(super) fn pitch_m(&self) -> f64 {
        match *self {
            Self::AprilGrid { side_m, spacing_m, .. } => side_m + spacing_m,
            Self::Charuco { square_m, .. } | Self::Chessboard { square_m, .. } => square_m,
        }
    }

    /// Id of the first marker.
    pub(super) fn first_id(&self) -> u32 {
        match *self {
            Self::AprilGrid { first_id, .. } | Self::Charuco { first_id, .. } => first_id,
            Self::Chessboard { .. } => 0,
        }
    }

    /// The detections whose ids the board has, at their places on it.
    pub(super) fn place(&self, detections: &[Detection]) -> Vec<PlacedMarker> {
        let places = self.markers_m();
        let place = |detection: &Detection| {
            let number = detection.id.checked_sub(self.first_id())?;
            Some(PlacedMarker {
                number,
                corners_m: *places.get(usize::try_from(number).ok()?)?,
                corners_px: detection.corners_px,
            })
        };
        detections.iter().filter_map(place).collect()
    }
}

/// The largest group of markers that are neighbours and agree about where they are, each number once.
pub(super) fn consistent(markers: &[PlacedMarker], pitch_m: f64) -> Vec<PlacedMarker> {
    let mut group: Vec<usize> = (0..markers.len()).collect();
    for a in 0..markers.len() {
        for b in 0..a {
            if group[a] != group[b] && agree(&markers[a], &markers[b], NEIGHBOURHOOD * pitch_m) {
                let (from, to) = (group[a], group[b]);
                group
                    .iter_mut()
                    .filter(|group| **group == from)
                    .for_each(|group| *group = to);
            }
        }
    }
    let size = |of: usize| group.iter().filter(|&&group| group == of).count();
    let Some(largest) = (0..markers.len())
        .rev()
        .max_by_key(|&of| size(group[of]))
        .map(|of| group[of])
    else {
        return Vec::new();
    };
    let mut members: Vec<PlacedMarker> = (0..markers.len())
        .filter(|&i| group[i] == largest)
        .map(|i| markers[i])
        .collect();
    members.sort_by_key(|marker| marker.number);
    members.dedup_by_key(|marker| marker.number);
    members
}

/// The four corners of a marker on the board and in the picture.
pub(super) fn pairs(marker: &PlacedMarker) -> impl Iterator<Item = (DVec2, DVec2)> {
    marker.corners_m.into_iter().zip(marker.corners_px)
}

/// Whether the way from one marker to the other is as long in the picture as on paper. It is judged by the mean of both
/// markers' scales and directions, which is right to third order however much the lens bends it.
fn agree(a: &PlacedMarker, b: &PlacedMarker, reach_m: f64) -> bool {
    let way_m = middle(&b.corners_m) - middle(&a.corners_m);
    if a.number == b.number || way_m.length() > reach_m {
        return false;
    }
    let way_px = middle(&b.corners_px) - middle(&a.corners_px);
    let scale = 0.5 * (pixels_per_metre(a) + pixels_per_metre(b));
    let expected = scale * way_m;
    way_px.distance(expected) < MAX_DISAGREEMENT * expected.length()
}

fn middle(corners: &[DVec2; 4]) -> DVec2 {
    0.25 * corners.iter().sum::<DVec2>()
}

/// How pixels move with places on the board, at a marker's middle.
fn pixels_per_metre(marker: &PlacedMarker) -> DMat2 {
    let sides = |[a, b, c, d]: [DVec2; 4]| DMat2::from_cols(0.5 * (b - a + c - d), 0.5 * (d - a + c - b));
    sides(marker.corners_px) * sides(marker.corners_m).inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tag::DictionarySize;

    fn board(pattern: CharucoPattern) -> Board {
        Board::Charuco {
            family: Family::Aruco4x4(DictionarySize::N50),
            columns: 5,
            rows: 4,
            square_m: 0.04,
            side_m: 0.03,
            first_id: 3,
            pattern,
        }
    }

    /// OpenCV 5.0: `CharucoBoard((5, 4), 0.04, 0.03, dictionary)`, with and without `setLegacyPattern`, its y axis turned up.
    #[test]
    fn charuco_markers_are_where_opencv_has_them() {
        let first = |pattern| board(pattern).markers_m()[0][0];
        assert!(first(CharucoPattern::BlackTopLeft).distance(DVec2::new(0.045, 0.125)) < 1e-12);
        assert!(first(CharucoPattern::BlackBottomLeft).distance(DVec2::new(0.005, 0.125)) < 1e-12);
        assert_eq!(board(CharucoPattern::BlackTopLeft).markers_m().len(), 10);
    }

    /// Markers as a camera straight above sees them, 1000 pixels per metre.
    fn seen(board: &Board) -> Vec<PlacedMarker> {
        let markers = board.markers_m().into_iter().zip(0..);
        markers
            .map(|(corners_m, number)| PlacedMarker {
                number,
                corners_m,
                corners_px: corners_m.map(|corner| DVec2::new(1000.0 * corner.x, 300.0 - 1000.0 * corner.y)),
            })
            .collect()
    }

    #[test]
    fn markers_in_the_wrong_place_are_left_out() {
        let board = board(CharucoPattern::BlackTopLeft);
        let mut markers = seen(&board);
        assert_eq!(consistent(&markers, board.pitch_m()), markers);
        markers[4].corners_px = markers[7].corners_px;
        markers[5].corners_px.rotate_left(2);
        let good = consistent(&markers, board.pitch_m());
        let numbers: Vec<u32> = good.iter().map(|marker| marker.number).collect();
        assert_eq!(numbers, [0, 1, 2, 3, 6, 7, 8, 9]);
        assert_eq!(consistent(&[], 1.0), []);
    }
}
