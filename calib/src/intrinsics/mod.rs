//! A camera's lens from pictures of a board.
//!
//! **Start**: no plane z = 1 anywhere, so lenses beyond 90° from the axis are like all others (`start.rs`). **Solve**: Levenberg
//! and Marquardt on the arrow of lens, board warp and poses, robust, outliers named in rounds (`solve.rs`). The board is
//! allowed to be bent: a bow of 1 mm that nobody solves for puts a lens off by more than a pixel while the residuals stay
//! small. **How sure**: covariance, and what it means in pixels over the picture ([`UncertaintyMap`]). **What is
//! missing**: [`Guide`].

mod coverage;
mod error;
mod field;
mod planar_pose;
mod problem;
mod results;
mod solve;
mod start;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
mod warp;

use glam::DVec2;
use nalgebra::DMatrix;

pub use coverage::{Advice, Guide, Taken, select};
pub use error::IntrinsicsError;
pub use field::{Difference, Reach, UncertaintyMap};

use problem::{Corner, Sighting};
use solve::Solver;
use warp::WarpedBoard;

use crate::{
    board::{Board, BoardView},
    camera::{Intrinsics, Model},
    least_squares::arrow::Iteration,
    pose::Pose,
};

/// Fewest views that can be used. Two of a flat board determine a lens without distortion; a third checks it.
pub const MIN_VIEWS: usize = 3;

/// What is to be calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request<'a> {
    /// The board in the views.
    pub board: &'a Board,
    /// Width and height of the pictures in pixels.
    pub size_px: [u32; 2],
    /// The lens model wanted.
    pub model: Model,
    /// For a fisheye, the angle to the axis in radians beyond which nothing is imaged. Without it, that is the angle of the
    /// picture's corners when corners of the board were seen nearly there, and a little beyond the outermost corner of the
    /// board when not, as in a round picture; and no more than the angle up to which the lens is one to one.
    pub max_angle_rad: Option<f64>,
}

/// A lens, and how sure it is.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Covariance of [`Intrinsics::parameters`], scaled by the variance of the residuals.
    pub covariance: DMatrix<f64>,
    /// How the board is bent: with x and y from -1 to 1 over its corners,
    /// `z = w[0] (1 - x²) + w[1] (1 - y²) + w[2] x y`, in metres, z out of the paper. All zero
    /// where the corners do not ask for a bend: the lens is then that of a flat board.
    pub board_warp_m: [f64; 3],
    /// Standard deviations of the warp, in metres: also of one that was found to be nothing, where they say how much of a bend
    /// would have been noticed.
    pub board_warp_sigma_m: [f64; 3],
    /// Root mean square of the residuals' lengths, in pixels, over the corners that are believed.
    pub rms_px: f64,
    /// Standard deviation of the residuals over the corners' `sigma_px`; the covariance is scaled by its square.
    pub noise: f64,
    /// The views, in the order given.
    pub views: Vec<CalibratedView>,
    /// Corners that do not fit.
    pub rejected_corners: Vec<RejectedCorner>,
    /// Views that take no part.
    pub rejected_views: Vec<RejectedView>,
    /// What should not be so.
    pub warnings: Vec<Warning>,
}

/// A view that took part.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedView {
    /// Its name.
    pub name: String,
    /// Where the board was.
    pub camera_from_board: Pose,
    /// The corners that are believed.
    pub residuals: Vec<Residual>,
    /// Root mean square of the residuals' lengths, in pixels.
    pub rms_px: f64,
    /// Length of the largest, in pixels.
    pub worst_px: f64,
}

/// A corner that is believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Which one: an index into [`Board::corners_m`].
    pub corner: u32,
    /// Where it was seen, in pixels.
    pub pixel: DVec2,
    /// Seen minus expected, in pixels.
    pub residual_px: DVec2,
}

/// A corner that does not fit.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedCorner {
    /// The view.
    pub view: String,
    /// Which one: an index into [`Board::corners_m`].
    pub corner: u32,
    /// Where it was seen, in pixels.
    pub pixel: DVec2,
    /// Seen minus expected, in pixels; not finite when it cannot be seen at all.
    pub residual_px: DVec2,
}

/// A view that takes no part.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedView {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: RejectedBecause,
}

/// Why a view takes no part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RejectedBecause {
    /// Hardly anything of the board was found.
    #[error("too few corners were found (needed: at least 6)")]
    TooFewCorners,
    /// No pose explains the corners.
    #[error("no pose of the board explains its corners")]
    NoPose,
    /// The view contradicts the others.
    #[error("its corners do not fit the other views: the board or the camera moved, or another board is seen")]
    DoesNotFit,
    /// The board is mirrored.
    #[error("it shows the board mirrored")]
    Mirrored,
}

/// Something that should not be so.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Warning {
    /// Few views.
    #[error("only {views} views: take 20 or more")]
    FewViews {
        /// Views that take part.
        views: usize,
    },
    /// Parts of the picture without a corner.
    #[error("no corner was seen in {percent:.0} % of the picture: there the lens is extrapolated")]
    Coverage {
        /// Part of the picture, in per cent.
        percent: f64,
    },
    /// The board was hardly tilted.
    #[error(
        "the board was hardly tilted: its normals are all within {spread_deg:.0} degrees, so the focal length is known to {sigma_percent:.2} % only"
    )]
    HardlyTilted {
        /// Largest angle between two normals, in degrees.
        spread_deg: f64,
        /// Standard deviation of the focal length, in per cent of it.
        sigma_percent: f64,
    },
    /// The residuals are large.
    #[error(
        "residuals of {rms_px:.2} px are large: blurred pictures, a rolling shutter, a board that is not as its file says, or the wrong lens model"
    )]
    LargeResiduals {
        /// Root mean square, in pixels.
        rms_px: f64,
    },
    /// The board is bent.
    #[error("the board is bent by {bend_mm:.1} mm; this is solved for, but a flat board is better")]
    Bent {
        /// Largest height over the plane, in millimetres.
        bend_mm: f64,
    },
    /// The lens is not known well everywhere.
    #[error("the lens is known to {worst_px:.2} px only in parts of the picture")]
    Uncertain {
        /// Largest standard deviation, in pixels.
        worst_px: f64,
    },
}

impl Calibration {
    /// Standard deviations of [`Intrinsics::parameters`].
    #[must_use]
    pub fn sigmas(&self) -> Vec<f64> {
        self.covariance
            .diagonal()
            .iter()
            .map(|variance| variance.max(0.0).sqrt())
            .collect()
    }

    /// How sure the lens is over the picture; see [`UncertaintyMap::new`].
    #[must_use]
    pub fn uncertainty(&self, cells: [usize; 2], reach: Reach) -> Option<UncertaintyMap> {
        UncertaintyMap::new(&self.intrinsics, &self.covariance, cells, reach)
    }
}

/// Finds the lens with which the board was seen. `progress` hears of every iteration.
///
/// # Errors
/// When there are too few usable views, corners contradict the board, the board was always turned the same way, or the solve
/// does not converge: see [`IntrinsicsError`].
pub fn calibrate(
    request: &Request<'_>,
    views: &[BoardView],
    progress: &mut dyn FnMut(Iteration),
) -> Result<Calibration, IntrinsicsError> {
    let board = WarpedBoard::new(request.board.corners_m());
    let (all, left_out) = sightings(&board, views)?;
    results::enough(&all, views, &left_out)?;
    let mut solver = Solver {
        board: &board,
        model: request.model,
        sightings: all,
        left_out,
        progress,
    };
    let mut state = solver.start(request.size_px).ok_or(IntrinsicsError::Mismatch {
        model: request.model,
        residual_px: f64::INFINITY,
    })?;
    results::seen_from_the_front(&mut solver, &mut state, views)?;
    results::enough(&solver.sightings, views, &solver.left_out)?;
    if let Some(error) = results::mismatch(&solver, &state) {
        return Err(error);
    }
    let begun = results::named(&state.poses, &solver, views);
    let solved = solver.finish(state);
    results::enough(&solver.sightings, views, &solver.left_out)?;
    let minimum = match solved {
        Ok(minimum) => minimum,
        // A valley without an end is what views that are all alike make of the cost.
        Err(error) => return Err(results::parallel(&begun, f64::INFINITY).unwrap_or_else(|| error.into())),
    };
    let solved = solver.conclude(minimum)?;
    if let Some(error) = results::mismatch(&solver, &solved.minimum.state) {
        return Err(error);
    }
    results::calibration(request, views, &solver, &solved)
}

/// Checks that all views have one size, and says which.
///
/// # Errors
/// [`IntrinsicsError::MixedSizes`], or [`IntrinsicsError::TooFewViews`] when there is none.
pub fn common_size(views: &[(String, [u32; 2])]) -> Result<[u32; 2], IntrinsicsError> {
    let Some((first, first_size_px)) = views.first() else {
        return Err(IntrinsicsError::TooFewViews {
            usable: 0,
            given: 0,
            needed: MIN_VIEWS,
            left_out: String::new(),
        });
    };
    match views.iter().find(|(_, size_px)| size_px != first_size_px) {
        None => Ok(*first_size_px),
        Some((view, size_px)) => Err(IntrinsicsError::MixedSizes {
            first: first.clone(),
            first_size_px: *first_size_px,
            view: view.clone(),
            size_px: *size_px,
        }),
    }
}

/// The views as the solver wants them, and those with too few corners.
fn sightings(
    board: &WarpedBoard,
    views: &[BoardView],
) -> Result<(Vec<Sighting>, Vec<solve::LeftOut>), IntrinsicsError> {
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for (index, view) in views.iter().enumerate() {
        let mut corners: Vec<Corner> = Vec::with_capacity(view.corners.len());
        for corner in &view.corners {
            if corner.corner as usize >= board.len() {
                return Err(IntrinsicsError::NoSuchCorner {
                    view: view.name.clone(),
                    corner: corner.corner,
                    last: board.len().saturating_sub(1),
                });
            }
            let sane = corner.pixel.is_finite() && corner.sigma_px.is_finite() && corner.sigma_px > 0.0;
            let twice = corners.iter().any(|other| other.index == corner.corner as usize);
            if !sane || twice {
                return Err(IntrinsicsError::BadCorner {
                    view: view.name.clone(),
                    corner: corner.corner,
                    problem: if twice {
                        "it is given twice"
                    } else {
                        "its numbers are not finite, or its `sigma_px` is not above 0"
                    },
                });
            }
            corners.push(Corner {
                index: corner.corner as usize,
                pixel: corner.pixel,
                sigma_px: corner.sigma_px,
                used: true,
            });
        }
        if corners.len() < planar_pose::MIN_CORNERS {
            left_out.push((index, RejectedBecause::TooFewCorners));
        } else {
            all.push(Sighting { view: index, corners });
        }
    }
    Ok((all, left_out))
}
