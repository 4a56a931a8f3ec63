//! Resection: where the camera is, from markers whose places are known.
//!
//! Every marker in view proposes its two planar poses. The proposals are compared by a robust error over *all*
//! markers, the best few are refined, and what then does not fit is left out. So a wrong id, a marker that was moved
//! or a covered corner costs its own evidence only, and a second marker settles which planar solution is the true one.

mod planar;
mod single;
mod solve;

use glam::{DVec2, DVec3};
use nalgebra::Matrix3;

use crate::{camera::Intrinsics, pose::Pose, rig::Rig, tag::Detection};
pub(crate) use planar::square_poses;
pub use single::{MarkerPose, marker_poses};
use solve::{Corner, Loss, Problem, Solution};

/// Error, in pixels, at which a corner counts half when proposals are compared.
const PROPOSAL_SCALE_PX: f64 = 4.0;

/// Error, in pixels, of a corner that a pose puts where the camera cannot see it.
const UNSEEN_PX: f64 = 1e6;

/// Proposals that are refined.
const REFINED_PROPOSALS: usize = 6;

/// Widest scale, in pixels, of the bounded error that turns a proposal into a pose. It starts at [`SCALE_OF_MEDIAN`]
/// times the proposal's median error, so that a wrong marker is not taken in by a proposal that is good already, and
/// is halved from solution to solution ("graduated non-convexity", Yang et al. 2020).
const WIDEST_SCALE_PX: f64 = 32.0;

/// Last scale, in pixels.
const NARROWEST_SCALE_PX: f64 = 1.0;

/// First scale in medians of a proposal's errors.
const SCALE_OF_MEDIAN: f64 = 1.5;

/// Error, in pixels, at which a corner counts half when refined proposals are compared.
const DECISION_SCALE_PX: f64 = 1.0;

/// Standard deviations beyond which a corner is left out.
const OUTLIER_SIGMAS: f64 = 5.0;

/// A corner closer than the first is never left out, one further away than the second always is, in pixels.
const OUTLIER_RANGE_PX: (f64, f64) = (1.0, 3.0);

/// Rounds of leaving out and solving again.
const OUTLIER_ROUNDS: usize = 12;

/// Median of the length of a vector with two components of unit variance (Rayleigh's distribution): sqrt(2 ln 2).
const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// Least standard deviation, in units of the expected one, that errors are judged by; exact corners have none.
const MIN_SPREAD: f64 = 0.1;

/// Corners that must agree.
const MIN_CORNERS: usize = 4;

/// Corners of a marker that must fit for the marker to count; two wrong ones mean a wrong marker.
const MIN_CORNERS_OF_MARKER: usize = 3;

/// Largest reprojection error of a pose that is handed out, in pixels.
const MAX_REPROJECTION_ERROR_PX: f64 = 2.0;

/// Error of a corner, in pixels, with which a pose must still be determined.
const PESSIMISTIC_CORNER_PX: f64 = 0.5;

/// Largest standard deviation of the camera's place, relative to the distance of the nearest marker, with such corners.
const MAX_RELATIVE_SIGMA: f64 = 0.3;

/// Systematic part of a corner's error and part that shrinks with the square root of the marker's side, in pixels, at
/// [`REFERENCE_SIDE_PX`]: lines are fitted through as many samples as the side has pixels.
const CORNER_SIGMA_PX: (f64, f64) = (0.02, 0.05);

/// Side at which the second part of [`CORNER_SIGMA_PX`] holds, in pixels.
const REFERENCE_SIDE_PX: f64 = 50.0;

/// A located camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// Where the camera is.
    pub camera_from_world: Pose,
    /// Root mean square distance, in pixels, between where the corners that count were seen and where the pose puts
    /// them.
    pub reprojection_error_px: f64,
    /// Markers that count.
    pub markers: usize,
    /// Corners that count.
    pub corners: usize,
    /// Markers of the rig that were seen but did not fit.
    pub rejected_markers: usize,
    /// Standard deviation of the camera's centre in metres, along its worst direction, from the residuals.
    pub position_sigma_m: f64,
}

/// Why there is no pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoPose {
    /// No marker was seen.
    #[error("no marker in the picture")]
    NoMarkers,
    /// Markers were seen, but none that the rig knows.
    #[error("none of the `{seen}` markers in the picture belongs to the rig")]
    NoKnownMarker {
        /// Number of markers seen.
        seen: usize,
    },
    /// No marker's corners are the picture of a square in front of the camera.
    #[error("none of the `{known}` known markers has corners that can be the picture of a square")]
    NoSquare {
        /// Number of markers of the rig seen.
        known: usize,
    },
    /// Less than four corners agree with any one pose.
    #[error("the corners of the `{known}` known markers agree on no pose")]
    NoAgreement {
        /// Number of markers of the rig seen.
        known: usize,
    },
    /// The corners leave the camera's place open.
    #[error(
        "the corners do not determine the pose: the camera's place would be uncertain by `{position_sigma_m:.3} m` \
         (allowed: `{allowed_m:.3} m`)"
    )]
    Degenerate {
        /// Standard deviation of the camera's centre, in metres, for corners good to half a pixel.
        position_sigma_m: f64,
        /// Largest one allowed.
        allowed_m: f64,
    },
    /// The best pose fits badly.
    #[error("the best pose is off by `{reprojection_error_px:.2} px` (allowed: at most `2 px`)")]
    TooLargeError {
        /// Root mean square error over the corners that count, in pixels.
        reprojection_error_px: f64,
    },
}

/// One marker in the picture with its corners.
struct Sighting {
    corners: [Corner; 4],
    rays: [DVec3; 4],
    side_m: f64,
    world_from_marker: Pose,
}

/// Locates the camera from the markers seen in one picture. Equal input gives an equal result, bit for bit.
///
/// Markers that the rig does not have, corners that are not finite or that no ray reaches, and whatever contradicts the
/// majority, are ignored.
///
/// # Errors
/// When no pose can be trusted; the reason is named.
pub fn locate(observations: &[Detection], rig: &Rig, intrinsics: &Intrinsics) -> Result<Located, NoPose> {
    if observations.is_empty() {
        return Err(NoPose::NoMarkers);
    }
    let sightings: Vec<Sighting> = observations
        .iter()
        .filter_map(|detection| Sighting::of(detection, rig, intrinsics))
        .collect();
    let known = sightings.len();
    if known == 0 {
        return Err(NoPose::NoKnownMarker {
            seen: observations.len(),
        });
    }
    let proposals = ranked_proposals(&sightings, intrinsics);
    if proposals.is_empty() {
        return Err(NoPose::NoSquare { known });
    }
    let fits = proposals.iter().filter_map(|start| fit(&sightings, intrinsics, *start));
    let best = fits
        .min_by(|a, b| a.total_cost.total_cmp(&b.total_cost))
        .ok_or(NoPose::NoAgreement { known })?;
    best.check(&sightings)
}

impl Sighting {
    /// `None` for a marker that is not the rig's or whose corners are not in the lens' image.
    fn of(detection: &Detection, rig: &Rig, intrinsics: &Intrinsics) -> Option<Self> {
        let marker = rig
            .marker(detection.id)
            .filter(|marker| marker.family == detection.family)?;
        let mut rays = [DVec3::ZERO; 4];
        for (ray, pixel) in rays.iter_mut().zip(detection.corners_px) {
            *ray = intrinsics.unproject(pixel)?;
        }
        let sigma_px = corner_sigma_px(detection);
        let places = marker.corners_world();
        let corners = std::array::from_fn(|i| Corner {
            world: places[i],
            pixel: detection.corners_px[i],
            sigma_px,
        });
        Some(Self {
            corners,
            rays,
            side_m: marker.side_m,
            world_from_marker: marker.world_from_marker,
        })
    }
}

/// Standard deviation expected of a detection's corners in pixels; of relative importance only.
pub(crate) fn corner_sigma_px(detection: &Detection) -> f64 {
    let (constant, shrinking) = CORNER_SIGMA_PX;
    constant.hypot(shrinking * (REFERENCE_SIDE_PX / detection.mean_side_px().max(1.0)).sqrt())
}

/// The planar solutions of all markers, best first, as many as shall be refined.
fn ranked_proposals(sightings: &[Sighting], intrinsics: &Intrinsics) -> Vec<Pose> {
    let mut proposals: Vec<(f64, Pose)> = sightings
        .iter()
        .flat_map(|sighting| {
            let marker_from_world = sighting.world_from_marker.inverse();
            let poses = square_poses(&sighting.rays, sighting.side_m);
            poses
                .into_iter()
                .map(move |camera_from_marker| camera_from_marker * marker_from_world)
        })
        .map(|pose| (robust_cost(sightings, intrinsics, &pose, PROPOSAL_SCALE_PX), pose))
        .collect();
    proposals.sort_by(|a, b| a.0.total_cmp(&b.0));
    proposals
        .into_iter()
        .take(REFINED_PROPOSALS)
        .map(|(_, pose)| pose)
        .collect()
}

/// Robust error of a pose over every corner (Cauchy's, which forgives a wrong marker); at `scale_px` a corner counts
/// half.
fn robust_cost(sightings: &[Sighting], intrinsics: &Intrinsics, pose: &Pose, scale_px: f64) -> f64 {
    let corner_cost = |corner: &Corner| {
        let error = solve::residual(intrinsics, pose, corner).map_or(UNSEEN_PX, DVec2::length);
        (1.0 + (error / scale_px).powi(2)).ln()
    };
    sightings
        .iter()
        .flat_map(|sighting| &sighting.corners)
        .map(corner_cost)
        .sum()
}

/// A refined proposal.
struct Fit {
    solution: Solution,
    errors_px: Vec<[f64; 4]>,
    kept: Vec<[bool; 4]>,
    /// Standard deviation found, in units of [`Corner::sigma_px`].
    scale: f64,
    total_cost: f64,
}

/// Refines a proposal: narrow down to what agrees, then solve for that, leave out what does not fit, take back what
/// does, until the same corners stay.
fn fit(sightings: &[Sighting], intrinsics: &Intrinsics, start: Pose) -> Option<Fit> {
    let mut pose = narrowed(sightings, intrinsics, start)?;
    let mut kept = within(&errors_px(sightings, intrinsics, &pose), OUTLIER_RANGE_PX.1);
    for round in 0..OUTLIER_ROUNDS {
        let corners = kept_corners(sightings, &kept);
        if corners.len() < MIN_CORNERS {
            return None;
        }
        let scale = spread(&corners, intrinsics, &pose)?;
        let solution = solve::refine(
            &Problem {
                intrinsics,
                corners: &corners,
                loss: Loss::Huber,
                scale,
            },
            pose,
        )?;
        pose = solution.camera_from_world;
        let errors_px = errors_px(sightings, intrinsics, &pose);
        let limit = OUTLIER_SIGMAS * sigma_of_kept(&errors_px, &kept)?;
        let next = within(&errors_px, limit.clamp(OUTLIER_RANGE_PX.0, OUTLIER_RANGE_PX.1));
        if next == kept || round + 1 == OUTLIER_ROUNDS {
            let total_cost = robust_cost(sightings, intrinsics, &pose, DECISION_SCALE_PX);
            let scale = spread(&corners, intrinsics, &pose)?;
            return Some(Fit {
                solution,
                errors_px,
                kept,
                scale,
                total_cost,
            });
        }
        kept = next;
    }
    None
}

/// Follows the minimum of a bounded error while its scale shrinks, so that the majority wins.
fn narrowed(sightings: &[Sighting], intrinsics: &Intrinsics, start: Pose) -> Option<Pose> {
    let mut pose = start;
    let errors = errors_px(sightings, intrinsics, &pose).into_iter().flatten().collect();
    let mut scale_px = (SCALE_OF_MEDIAN * median(errors)?).clamp(NARROWEST_SCALE_PX, WIDEST_SCALE_PX);
    loop {
        let visible: Vec<Corner> = sightings
            .iter()
            .flat_map(|sighting| sighting.corners)
            .filter(|corner| solve::residual(intrinsics, &pose, corner).is_some())
            .collect();
        let typical_sigma_px = median(visible.iter().map(|corner| corner.sigma_px).collect())?;
        let scale = scale_px / typical_sigma_px;
        let problem = Problem {
            intrinsics,
            corners: &visible,
            loss: Loss::Bounded,
            scale,
        };
        pose = solve::refine(&problem, pose)?.camera_from_world;
        if scale_px <= NARROWEST_SCALE_PX {
            return Some(pose);
        }
        scale_px = (0.5 * scale_px).max(NARROWEST_SCALE_PX);
    }
}

/// Distances between seen and predicted corners in pixels, marker by marker; infinite where the camera cannot see one.
fn errors_px(sightings: &[Sighting], intrinsics: &Intrinsics, pose: &Pose) -> Vec<[f64; 4]> {
    let error = |corner: &Corner| solve::residual(intrinsics, pose, corner).map_or(f64::INFINITY, DVec2::length);
    sightings
        .iter()
        .map(|sighting| sighting.corners.each_ref().map(error))
        .collect()
}

/// Which corners are within the limit; none of a marker that has too few of them.
fn within(errors_px: &[[f64; 4]], limit: f64) -> Vec<[bool; 4]> {
    let of_marker = |errors: &[f64; 4]| {
        let kept = errors.map(|error| error <= limit);
        let enough = kept.iter().filter(|kept| **kept).count() >= MIN_CORNERS_OF_MARKER;
        kept.map(|kept| kept && enough)
    };
    errors_px.iter().map(of_marker).collect()
}

fn kept_corners(sightings: &[Sighting], kept: &[[bool; 4]]) -> Vec<Corner> {
    let pairs = sightings
        .iter()
        .zip(kept)
        .flat_map(|(sighting, kept)| sighting.corners.iter().zip(kept));
    pairs.filter_map(|(corner, kept)| kept.then_some(*corner)).collect()
}

/// Standard deviation of the corners that are kept, in pixels; robust.
fn sigma_of_kept(errors_px: &[[f64; 4]], kept: &[[bool; 4]]) -> Option<f64> {
    let pairs = errors_px.iter().flatten().zip(kept.iter().flatten());
    sigma(pairs.filter_map(|(error, kept)| kept.then_some(*error)).collect())
}

/// Standard deviation of the corners at this pose, in units of their expected one; robust, never zero.
fn spread(corners: &[Corner], intrinsics: &Intrinsics, pose: &Pose) -> Option<f64> {
    let deviation = |corner: &Corner| Some(solve::residual(intrinsics, pose, corner)?.length() / corner.sigma_px);
    Some(sigma(corners.iter().filter_map(deviation).collect())?.max(MIN_SPREAD))
}

/// Standard deviation of either component of errors of these lengths that a pose was fitted to, which takes up six of
/// them.
fn sigma(lengths: Vec<f64>) -> Option<f64> {
    let components = 2.0 * lengths.len() as f64;
    Some(median(lengths)? / RAYLEIGH_MEDIAN * (components / (components - 6.0).max(1.0)).sqrt())
}

/// The upper median; `None` of nothing.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

impl Fit {
    /// Hands the pose out if it can be trusted.
    fn check(&self, sightings: &[Sighting]) -> Result<Located, NoPose> {
        let known = sightings.len();
        let camera_from_world = self.solution.camera_from_world;
        let kept = || {
            self.errors_px
                .iter()
                .flatten()
                .zip(self.kept.iter().flatten())
                .filter(|(_, kept)| **kept)
        };
        let corners = kept().count();
        if corners < MIN_CORNERS {
            return Err(NoPose::NoAgreement { known });
        }
        let reprojection_error_px = (kept().map(|(error, _)| error * error).sum::<f64>() / corners as f64).sqrt();
        if !(reprojection_error_px <= MAX_REPROJECTION_ERROR_PX && camera_from_world.is_finite()) {
            return Err(NoPose::TooLargeError { reprojection_error_px });
        }
        let nearest_m = sightings
            .iter()
            .map(|sighting| {
                camera_from_world
                    .transform_point(sighting.world_from_marker.translation)
                    .length()
            })
            .fold(f64::INFINITY, f64::min);
        let position_sigma_m = self.position_sigma_m();
        let sigma_of_scale = self.scale * kept_corners(sightings, &self.kept)[0].sigma_px;
        let pessimistic_m = position_sigma_m * (PESSIMISTIC_CORNER_PX / sigma_of_scale);
        let allowed_m = MAX_RELATIVE_SIGMA * nearest_m;
        if pessimistic_m.is_nan() || pessimistic_m > allowed_m {
            return Err(NoPose::Degenerate {
                position_sigma_m: pessimistic_m,
                allowed_m,
            });
        }
        let markers = self
            .kept
            .iter()
            .filter(|marker| marker.iter().any(|kept| *kept))
            .count();
        let rejected_markers = known - markers;
        Ok(Located {
            camera_from_world,
            reprojection_error_px,
            markers,
            corners,
            rejected_markers,
            position_sigma_m,
        })
    }

    /// The camera's centre moves by `-Rᵀ v` when the pose is changed by a twist with translation v.
    fn position_sigma_m(&self) -> f64 {
        let Some(covariance) = self.solution.information.try_inverse() else {
            return f64::INFINITY;
        };
        let translation: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into_owned();
        translation.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}
