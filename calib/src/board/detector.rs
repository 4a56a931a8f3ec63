//! A picture to the corners of a board.

use super::{
    Board, BoardView, SeenCorner, aprilgrid, charuco, chessboard,
    growth::Target,
    markers::{self, PlacedMarker},
    saddle::Saddle,
};
use crate::{
    response::ResponseCurve,
    tag::{Detector, LinearLuma, LumaError, LumaView},
};

/// Corners that a picture must show of the board to be worth anything: a pose needs four, the others check it.
pub const MIN_CORNERS: usize = 8;

/// Exponent from light to the grey values in which markers are looked for.
const BRIGHT_POWER: f64 = 0.35;

/// Values of the 16-bit picture that share a grey value, as a power of two.
const BRIGHT_SHIFT: u32 = 4;

/// Finds a board in pictures. Keeps its buffers.
#[derive(Debug)]
pub struct BoardDetector {
    board: Board,
    markers: Detector,
    targets: Vec<Target>,
    luma: LinearLuma,
    bright: Vec<u8>,
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
    /// Not the whole chessboard, or another one.
    #[error(
        "a grid of `{found_long}×{found_short}` inner corners was found, `{corners}` of them clearly (needed: all of `{columns}×{rows}`)"
    )]
    OtherChessboard {
        /// Inner corners along the longer side of what was found.
        found_long: u32,
        /// Along the shorter side.
        found_short: u32,
        /// Corners found of that.
        corners: usize,
        /// Columns of the board.
        columns: u32,
        /// Rows of the board.
        rows: u32,
    },
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
        let (markers, targets) = match *board {
            Board::AprilGrid {
                family, border_bits, ..
            } => (Detector::with_border(&[family], border_bits), aprilgrid::targets(board)),
            Board::Charuco { family, .. } => (Detector::new(&[family]), charuco::targets(board)),
            Board::Chessboard { .. } => (Detector::new(&[]), Vec::new()),
        };
        Self {
            board: *board,
            markers,
            targets,
            luma: LinearLuma::new(),
            bright: Vec::new(),
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
        let corners = match self.board {
            Board::AprilGrid { .. } => {
                let markers = self.markers();
                aprilgrid::corners(&self.luma, &self.targets, self.board.pitch_m(), &markers)
            }
            Board::Charuco { .. } => {
                let markers = self.markers();
                charuco::corners(&self.luma, &self.targets, self.board.pitch_m(), &markers)
            }
            Board::Chessboard { columns, rows, .. } => {
                chessboard::corners(&self.luma, [columns, rows]).map_err(|misfit| match misfit.found {
                    [0, 0] => Reason::Nothing,
                    [found_long, found_short] => Reason::OtherChessboard {
                        found_long,
                        found_short,
                        corners: misfit.corners,
                        columns,
                        rows,
                    },
                })?
            }
        };
        if corners.len() < MIN_CORNERS {
            return Err(Reason::TooFew {
                found: corners.len(),
                needed: MIN_CORNERS,
            });
        }
        Ok(corners)
    }

    /// Grey values in which the middle between white and black in linear light is nearer to white: where the corners of
    /// black squares touch, they count as apart, and each marker has an outline of its own.
    fn brighten(&mut self) {
        let most = self
            .luma
            .linear()
            .iter()
            .max()
            .map_or(1.0, |&most| f64::from(most).max(1.0));
        let table: Vec<u8> = (0..=u16::MAX >> BRIGHT_SHIFT)
            .map(|bin| {
                let value = (f64::from(bin) + 0.5) * f64::from(1 << BRIGHT_SHIFT);
                (255.0 * (value / most).min(1.0).powf(BRIGHT_POWER)).round() as u8
            })
            .collect();
        let bright = self
            .luma
            .linear()
            .iter()
            .map(|&value| table[usize::from(value >> BRIGHT_SHIFT)]);
        self.bright.clear();
        self.bright.extend(bright);
    }

    /// The board's markers, as far as they agree with each other.
    fn markers(&mut self) -> Vec<PlacedMarker> {
        self.brighten();
        let size = self.luma.size();
        let mut placed = self.board.place(&self.markers.detect(view(&self.bright, size)));
        if placed.len() < self.board.markers_m().len() {
            // Ink spreads, and black squares that should only touch grow together: white grown by a pixel parts them.
            self.bright = lightest_of_nine(&self.bright, size);
            placed.extend(self.board.place(&self.markers.detect(view(&self.bright, size))));
        }
        markers::consistent(&placed, self.board.pitch_m())
    }
}

fn view(pixels: &[u8], size: [usize; 2]) -> LumaView<'_> {
    LumaView::new(size, size[0], pixels).expect("`LinearLuma` has checked the size")
}

/// The lightest of every pixel and its eight neighbours.
fn lightest_of_nine(pixels: &[u8], [width, height]: [usize; 2]) -> Vec<u8> {
    let mut across = pixels.to_vec();
    for (row, source) in across
        .chunks_exact_mut(width.max(1))
        .zip(pixels.chunks_exact(width.max(1)))
    {
        for (target, three) in row.iter_mut().skip(1).zip(source.windows(3)) {
            *target = three[0].max(three[1]).max(three[2]);
        }
    }
    let mut result = across.clone();
    for y in 1..height.saturating_sub(1) {
        for x in 0..width {
            let i = y * width + x;
            result[i] = across[i - width].max(across[i]).max(across[i + width]);
        }
    }
    result
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
