//! A picture to the corners of a board.

use super::{
    Board, BoardView, NotFound, Reason, SeenCorner, aprilgrid, charuco,
    chessboard::{self, OtherGrid},
    growth::Target,
    marker_search::MarkerSearch,
    saddle::Saddle,
};
use crate::{response::ResponseCurve, tag::LinearLuma};

/// Corners that a picture must show of the board to be worth anything: a pose needs four, the others check it.
pub const MIN_CORNERS: usize = 8;

/// Signal of the brightest pixel below which a picture is dark, relative to the range.
const DARK: f64 = 0.01;

/// Values of the 16-bit picture from which on a pixel is clipped.
const CLIPPED: u16 = 65_000;

/// Share of the pixels that are most of a picture.
const MOSTLY: f64 = 0.5;

/// Finds a board in pictures. Keeps its buffers.
#[derive(Debug)]
pub struct BoardDetector {
    board: Board,
    /// `None` for a chessboard.
    markers: Option<MarkerSearch>,
    targets: Vec<Target>,
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

impl BoardDetector {
    /// A detector for this board.
    #[must_use]
    pub fn new(board: &Board) -> Self {
        let targets = match board {
            Board::AprilGrid { .. } => aprilgrid::targets(board),
            Board::Charuco { .. } => charuco::targets(board),
            Board::Chessboard { .. } => Vec::new(),
        };
        Self {
            board: *board,
            markers: MarkerSearch::new(board),
            targets,
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
            .map(|corners| found(name, &corners))
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
    ) -> Result<Vec<(usize, Saddle)>, Reason> {
        self.luma.set(rgb, size, response)?;
        let markers = match &mut self.markers {
            Some(search) => search.find(&self.luma)?,
            None => Vec::new(),
        };
        let (luma, targets, pitch_m) = (&self.luma, &self.targets, self.board.pitch_m());
        let corners = match self.board {
            Board::AprilGrid { .. } => aprilgrid::corners(luma, targets, pitch_m, &markers),
            Board::Charuco { .. } => charuco::corners(luma, targets, pitch_m, &markers),
            Board::Chessboard { columns, rows, .. } => {
                chessboard::corners(luma, [columns, rows]).map_err(|other| self.other_chessboard(&other))?
            }
        };
        match corners.len() {
            0 => Err(self.exposure()),
            found if found < MIN_CORNERS => Err(Reason::TooFew {
                found,
                needed: MIN_CORNERS,
            }),
            _ => Ok(corners),
        }
    }

    fn other_chessboard(&self, other: &OtherGrid) -> Reason {
        let Board::Chessboard { columns, rows, .. } = self.board else {
            return Reason::Nothing;
        };
        if other.corners < MIN_CORNERS {
            return self.exposure();
        }
        Reason::OtherChessboard {
            found_long: other.found[0],
            found_short: other.found[1],
            corners: other.corners,
            columns,
            rows,
        }
    }

    /// What the exposure has to do with it that nothing was found.
    fn exposure(&self) -> Reason {
        let linear = self.luma.linear();
        let brightest = f64::from(linear.iter().copied().max().unwrap_or(0)) / f64::from(u16::MAX);
        let clipped = linear.iter().filter(|&&value| value >= CLIPPED).count() as f64 / linear.len().max(1) as f64;
        if brightest < DARK {
            Reason::Dark {
                brightest_percent: 100.0 * brightest,
            }
        } else if clipped > MOSTLY {
            Reason::Clipped {
                clipped_percent: 100.0 * clipped,
            }
        } else {
            Reason::Nothing
        }
    }
}

fn found(name: &str, corners: &[(usize, Saddle)]) -> FoundBoard {
    let mut widths: Vec<f64> = corners.iter().map(|(_, saddle)| saddle.edge_width_px).collect();
    widths.sort_by(f64::total_cmp);
    let corners = corners.iter().map(|(corner, saddle)| SeenCorner {
        corner: u32::try_from(*corner).expect("boards have less than 2³² corners"),
        pixel: saddle.pixel,
        sigma_px: saddle.sigma_px,
    });
    FoundBoard {
        view: BoardView {
            name: name.to_owned(),
            corners: corners.collect(),
        },
        edge_width_px: widths[widths.len() / 2],
    }
}
