//! Calibration boards: what is printed on them, and where its corners were seen.
//!
//! **Board frame**: the board seen upright, as it is printed: x to the right, y up, z out of the paper; right-handed,
//! metres. The origin is the bottom-left corner of the bottom-left marker (AprilGrid), of the bottom-left square (ChArUco), or the
//! bottom-left inner corner (chessboard).

mod aprilgrid;
mod candidates;
mod charuco;
mod chessboard;
mod detector;
mod file;
mod growth;
mod marker_search;
mod markers;
mod plane;
mod reason;
mod saddle;

use glam::{DVec2, DVec3};

pub use detector::{BoardDetector, FoundBoard, MIN_CORNERS};
pub use file::BoardFileError;
pub use reason::{NotFound, Reason};

use crate::tag::Family;

/// A board as it is printed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Board {
    /// Markers in a grid, small black squares where their corners meet (Kalibr's "aprilgrid"). Ids count from the
    /// bottom-left marker, row by row.
    AprilGrid {
        /// Family of the markers.
        family: Family,
        /// Markers from left to right.
        columns: u32,
        /// Markers from bottom to top.
        rows: u32,
        /// Side of a marker's black square.
        side_m: f64,
        /// Gap between markers.
        spacing_m: f64,
        /// Cells of black border around the code: 1, or 2 as Kalibr prints it.
        border_bits: u32,
        /// Id of the bottom-left marker.
        first_id: u32,
    },
    /// A chessboard with markers in its white squares, as OpenCV makes it. Ids count from the top-left marker, row by row.
    Charuco {
        /// Family of the markers.
        family: Family,
        /// Squares from left to right.
        columns: u32,
        /// Squares from top to bottom.
        rows: u32,
        /// Side of a square.
        square_m: f64,
        /// Side of a marker's black square.
        side_m: f64,
        /// Id of the top-left marker.
        first_id: u32,
        /// Which square is at the top left.
        pattern: CharucoPattern,
    },
    /// A chessboard.
    Chessboard {
        /// Inner corners from left to right.
        columns: u32,
        /// Inner corners from bottom to top.
        rows: u32,
        /// Side of a square.
        square_m: f64,
    },
}

/// Colours of a ChArUco board; the two differ for an even number of rows only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CharucoPattern {
    /// The top-left square is black (OpenCV from 4.6 on).
    BlackTopLeft,
    /// The bottom-left square is black, whatever that makes of the top-left one (OpenCV before 4.6, its "legacy pattern").
    BlackBottomLeft,
}

/// A board in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// Name of the picture.
    pub name: String,
    /// Corners that were seen, by rising `corner`; each at most once.
    pub corners: Vec<SeenCorner>,
}

/// A corner of the board in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenCorner {
    /// Which one: an index into [`Board::corners_m`].
    pub corner: u32,
    /// Where it was seen, in pixels.
    pub pixel: DVec2,
    /// Standard deviation expected of either coordinate, in pixels; of relative importance only.
    pub sigma_px: f64,
}

impl Board {
    /// The corners that detection looks for, in the board frame, z = 0.
    ///
    /// AprilGrid: four per marker, markers by id, corners bottom-left, bottom-right, top-right, top-left. ChArUco and
    /// chessboard: inner corners, row by row from the bottom-left.
    #[must_use]
    pub fn corners_m(&self) -> Vec<DVec3> {
        match *self {
            Self::AprilGrid {
                columns,
                rows,
                side_m,
                spacing_m,
                ..
            } => grid(columns, rows)
                .flat_map(|cell| {
                    let corner = cell * (side_m + spacing_m);
                    [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|offset| (corner + offset * side_m).extend(0.0))
                })
                .collect(),
            Self::Charuco {
                columns,
                rows,
                square_m,
                ..
            } => grid(columns.saturating_sub(1), rows.saturating_sub(1))
                .map(|cell| ((cell + 1.0) * square_m).extend(0.0))
                .collect(),
            Self::Chessboard {
                columns,
                rows,
                square_m,
            } => grid(columns, rows).map(|cell| (cell * square_m).extend(0.0)).collect(),
        }
    }
}

/// Cells of a grid, row by row from the bottom-left.
fn grid(columns: u32, rows: u32) -> impl Iterator<Item = DVec2> {
    (0..rows).flat_map(move |row| (0..columns).map(move |column| DVec2::new(f64::from(column), f64::from(row))))
}
