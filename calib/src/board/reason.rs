//! Why a board is not found, for people to act on.

use crate::tag::LumaError;

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
    /// There is hardly any light in the picture.
    #[error("the picture is dark: its brightest pixel has `{brightest_percent:.1}` % of the signal's range")]
    Dark {
        /// Signal of the brightest pixel.
        brightest_percent: f64,
    },
    /// Most of the picture is clipped.
    #[error("`{clipped_percent:.0}` % of the picture's pixels are clipped")]
    Clipped {
        /// Share of the clipped pixels.
        clipped_percent: f64,
    },
    /// The picture is mirrored; of a chessboard that cannot be told.
    #[error("the picture is mirrored: `{markers}` markers of the board were found in its mirror image")]
    Mirrored {
        /// Markers found.
        markers: usize,
    },
    /// The board's markers have another border.
    #[error("the markers have a border of `{found}` cells (the board file says: `border_bits` is `{expected}`)")]
    OtherBorder {
        /// Cells of border found.
        found: u32,
        /// Cells of border that the board has.
        expected: u32,
    },
    /// Markers that belong together have ids that the board does not have.
    #[error("markers with ids `{lowest}` to `{highest}` were found (the board has `{first}` to `{last}`)")]
    OtherIds {
        /// Lowest id found.
        lowest: u32,
        /// Highest id found.
        highest: u32,
        /// Lowest id of the board.
        first: u32,
        /// Highest id of the board.
        last: u32,
    },
    /// The markers are not where the board has them.
    #[error(
        "the markers are not where the board has them: they fit a board of `{found}` columns (the board file says: `{expected}`)"
    )]
    OtherColumns {
        /// Columns that would fit.
        found: u32,
        /// Columns of the board.
        expected: u32,
    },
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

impl Reason {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Picture(_) => "give an undamaged picture of at most 32767 pixels a side",
            Self::Nothing | Self::TooFew { .. } => {
                "bring the board nearer, hold it still, light it evenly; compare it with the board file"
            }
            Self::Dark { .. } => "expose longer",
            Self::Clipped { .. } => "expose less",
            Self::Mirrored { .. } => "switch off whatever mirrors the camera's pictures",
            Self::OtherBorder { .. } | Self::OtherIds { .. } | Self::OtherColumns { .. } => {
                "correct the board file, or show the board that it describes"
            }
            Self::OtherChessboard { .. } => {
                "show the whole chessboard with its white margin; `columns` and `rows` count inner corners"
            }
        }
    }

    /// Whether another board was seen than the board file describes, or the same one mirrored: then no picture will do.
    #[must_use]
    pub fn is_wrong_board(&self) -> bool {
        match self {
            Self::Mirrored { .. } | Self::OtherBorder { .. } | Self::OtherIds { .. } | Self::OtherColumns { .. } => {
                true
            }
            Self::Picture(_)
            | Self::Nothing
            | Self::Dark { .. }
            | Self::Clipped { .. }
            | Self::OtherChessboard { .. }
            | Self::TooFew { .. } => false,
        }
    }
}
