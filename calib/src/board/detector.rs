//! A picture to the corners of a board.

use super::{Board, BoardView, SeenCorner};
use crate::{
    response::ResponseCurve,
    tag::{Detector, Family, LinearLuma, LumaError},
};

/// Corners that a picture must show of the board to be worth anything: a pose needs four, the others check it.
pub const MIN_CORNERS: usize = 8;

/// Finds a board in pictures. Keeps its buffers.
#[derive(Debug)]
pub struct BoardDetector {
    board: Board,
    markers: Detector,
    luma: LinearLuma,
}

/// A board in a picture, and how well it is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBoard {
    /// The corners.
    pub view: BoardView,
    /// Width of the edges at the corners in pixels, the median: standard deviation of the Gaussian that blurs a step as
    /// they are blurred. A sharp picture has 0.3 to 0.7.
    pub edge_width_px: f64,
}

/// A picture in which the board was not found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no board in `{name}`")]
pub struct NotFound {
    /// Name of the picture.
    pub name: String,
    /// Why.
    #[source]
    pub reason: Reason,
}

/// Why the board was not found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Reason {
    /// The bytes are not a picture.
    #[error("the picture cannot be read")]
    Picture(#[from] LumaError),
    /// Nothing of the board is there.
    #[error("nothing of the board was found")]
    Nothing,
    /// Too little of it.
    #[error("`{found}` corners were found (needed: `{needed}`)")]
    TooFew {
        /// Corners found.
        found: usize,
        /// Corners needed.
        needed: usize,
    },
}

impl BoardDetector {
    /// A detector for this board.
    #[must_use]
    pub fn new(board: &Board) -> Self {
        let families: &[Family] = match board {
            Board::AprilGrid { family, .. } | Board::Charuco { family, .. } => &[*family],
            Board::Chessboard { .. } => &[],
        };
        Self {
            board: *board,
            markers: Detector::new(families),
            luma: LinearLuma::new(),
        }
    }

    /// Finds the board in a picture of `size` columns and rows, three bytes per pixel (red, green, blue), encoded with
    /// `response`; where that is not known, [`ResponseCurve::srgb`] will do. `name` is what the view or error is called.
    ///
    /// # Errors
    /// When the bytes are not a picture, or too little of the board is seen in it.
    pub fn detect(
        &mut self,
        name: &str,
        rgb: &[u8],
        size: [usize; 2],
        response: &ResponseCurve,
    ) -> Result<FoundBoard, NotFound> {
        self.search(rgb, size, response)
            .map(|(corners, edge_width_px)| FoundBoard {
                view: BoardView {
                    name: name.to_owned(),
                    corners,
                },
                edge_width_px,
            })
            .map_err(|reason| NotFound {
                name: name.to_owned(),
                reason,
            })
    }

    fn search(
        &mut self,
        rgb: &[u8],
        size: [usize; 2],
        response: &ResponseCurve,
    ) -> Result<(Vec<SeenCorner>, f64), Reason> {
        self.luma.set(rgb, size, response)?;
        let Board::AprilGrid {
            columns,
            rows,
            first_id,
            ..
        } = self.board
        else {
            return Err(Reason::Nothing);
        };
        let markers = self.markers.detect(self.luma.luma());
        let corners: Vec<SeenCorner> = markers
            .iter()
            .filter_map(|marker| Some((marker.id.checked_sub(first_id)?, marker)))
            .filter(|(index, _)| *index < columns * rows)
            .flat_map(|(index, marker)| {
                (0..4).map(move |corner| SeenCorner {
                    corner: 4 * index + corner,
                    pixel: marker.corners_px[corner as usize],
                    sigma_px: 0.1,
                })
            })
            .collect();
        if corners.is_empty() {
            return Err(Reason::Nothing);
        }
        if corners.len() < MIN_CORNERS {
            return Err(Reason::TooFew {
                found: corners.len(),
                needed: MIN_CORNERS,
            });
        }
        Ok((corners, 0.5))
    }
}
