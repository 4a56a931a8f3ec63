//! Why there is no lens.

use crate::{camera::Model, least_squares::arrow::SolveError};

/// Why a camera could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IntrinsicsError {
    /// Too few pictures show enough of the board.
    #[error("`{usable}` of `{given}` views can be used (needed: at least `{needed}`){left_out}")]
    TooFewViews {
        /// Views that can be used.
        usable: usize,
        /// Views given.
        given: usize,
        /// Views needed.
        needed: usize,
        /// Which views were left out and why; begins with a separator, or is empty.
        left_out: String,
    },
    /// The pictures are not all of one size.
    #[error("view `{view}` has `{}×{}` pixels, `{first}` has `{}×{}`", size_px[0], size_px[1], first_size_px[0], first_size_px[1])]
    MixedSizes {
        /// First view.
        first: String,
        /// Its size.
        first_size_px: [u32; 2],
        /// A view of another size.
        view: String,
        /// Its size.
        size_px: [u32; 2],
    },
    /// A corner is not on the board.
    #[error("view `{view}` has a corner `{corner}`; the board has corners `0` to `{last}`")]
    NoSuchCorner {
        /// The view.
        view: String,
        /// The corner.
        corner: u32,
        /// The board's last.
        last: usize,
    },
    /// A corner is given twice, or its numbers make no sense.
    #[error("corner `{corner}` of view `{view}` is not usable: {problem}")]
    BadCorner {
        /// The view.
        view: String,
        /// The corner.
        corner: u32,
        /// What is wrong.
        problem: &'static str,
    },
    /// Most views show the board's back.
    #[error("`{mirrored}` of `{views}` views show the board mirrored, view `{view}` among them")]
    Mirrored {
        /// Views that do.
        mirrored: usize,
        /// Views with a pose.
        views: usize,
        /// One of them.
        view: String,
    },
    /// The board's corners are not where the board file says.
    #[error("a board and a lens `{model}` leave `{residual_px:.1}` px between corners seen and expected")]
    Mismatch {
        /// The model.
        model: Model,
        /// Noise of a coordinate, from the median.
        residual_px: f64,
    },
    /// The board was always turned the same way.
    #[error(
        "the views do not determine the focal length (its standard deviation is `{sigma_percent:.1}` %): the board's \
         normals are all within `{spread_deg:.1}` degrees (view `{first}` to view `{second}`)"
    )]
    Parallel {
        /// Largest angle between two normals, in degrees.
        spread_deg: f64,
        /// Standard deviation of the focal length, in per cent of it.
        sigma_percent: f64,
        /// The views with the largest angle.
        first: String,
        /// The views with the largest angle.
        second: String,
    },
    /// The solve failed.
    #[error("the lens cannot be solved for")]
    Solve(#[from] SolveError),
    /// The numbers found are no lens.
    #[error("the solve ends at a lens `{model}` that does not map the picture one to one")]
    Unusable {
        /// The model.
        model: Model,
    },
}

impl IntrinsicsError {
    /// Whether the pictures or the board file are to blame.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::TooFewViews { .. }
            | Self::MixedSizes { .. }
            | Self::NoSuchCorner { .. }
            | Self::BadCorner { .. }
            | Self::Mirrored { .. }
            | Self::Mismatch { .. }
            | Self::Parallel { .. } => true,
            Self::Solve(_) | Self::Unusable { .. } => false,
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::TooFewViews { .. } => {
                "take 20 to 40 pictures of the whole board, sharp and well lit, all over the picture and tilted by 20 to 45 degrees"
            }
            Self::MixedSizes { .. } => "give pictures of one camera in one mode only",
            Self::NoSuchCorner { .. } => "the board file does not describe the board in the pictures",
            Self::BadCorner { .. } => "mend the file of corners",
            Self::Mirrored { .. } => "give the pictures as the camera takes them: turn its mirroring off",
            Self::Mismatch { .. } => {
                "measure the board (side, spacing, squares) and compare with the board file; for a wide lens choose another `--model`"
            }
            Self::Parallel { .. } => {
                "take pictures of the board tilted by 20 to 45 degrees to the left, right, up and down"
            }
            Self::Solve(_) => {
                "take more pictures, tilted and all over the picture, or choose a model with fewer parameters"
            }
            Self::Unusable { .. } => "choose another `--model`, or take pictures with the board at the picture's edges",
        }
    }
}
