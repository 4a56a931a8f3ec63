//! A camera on a headset that another system tracks: where the camera is on the headset, and where the tracker is in the world.
//!
//! With A = tracker_from_headset as tracked, B = world_from_camera as seen in pictures, X = headset_from_camera and
//! Z = world_from_tracker, every moment says `Z A X = B`. Start: Shah 2013, "Solving the robot-world/hand-eye calibration
//! problem using the Kronecker product". Then `log(B⁻¹ Z A X)` is made small, rotation and translation each in units of the
//! spread that they turn out to have.

mod refine;
mod shah;
mod track;

use nalgebra::{Matrix3, Matrix6};

use super::PoseSigma;
use crate::{least_squares::arrow::SolveError, pose::Pose};
use track::Track;

/// Moments at which both poses must be known.
pub const MIN_MOMENTS: usize = 8;

/// Spread of the rotations, in degrees, below which nothing can be told from them.
pub const MIN_SPREAD_DEG: f64 = 5.0;

/// Spread of the rotations about a second axis, in degrees, below which the shift along the first axis stays open.
pub const MIN_SECOND_SPREAD_DEG: f64 = 2.0;

/// Gap between tracked poses, in seconds, that is not bridged.
pub const MAX_GAP_S: f64 = 0.1;

/// Largest time offset that is looked for, in seconds.
pub const MAX_OFFSET_S: f64 = 0.25;

/// Step of the first search for the time offset, in seconds.
const OFFSET_STEP_S: f64 = 0.01;

/// A pose that the tracker gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedPose {
    /// When, in nanoseconds.
    pub timestamp_ns: u64,
    /// The pose.
    pub tracker_from_headset: Pose,
}

/// A moment at which a picture located the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// Name of the picture.
    pub name: String,
    /// When, in nanoseconds.
    pub timestamp_ns: u64,
    /// Where the camera was.
    pub camera_from_world: Pose,
}

/// Whether the tracker's clock is the camera's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clocks {
    /// It is.
    Same,
    /// It may be ahead or behind by a constant of at most [`MAX_OFFSET_S`], which is found too.
    Offset,
}

/// What the pictures and the tracker say together.
#[derive(Debug, Clone)]
pub struct HandEye {
    /// Where the camera is on the headset.
    pub headset_from_camera: Pose,
    /// Where the tracker is in the world.
    pub world_from_tracker: Pose,
    /// Covariance of the twist ξ in `headset_from_camera * exp(ξ)`, rotation first, in rad² and m².
    pub camera_covariance: Matrix6<f64>,
    /// Covariance of the twist ξ in `world_from_tracker * exp(ξ)`.
    pub tracker_covariance: Matrix6<f64>,
    /// What must be added to a picture's time to have the tracker's, in seconds, and its standard deviation. Where the
    /// tracker trembles as fast as the headset moves, that is too small.
    pub tracker_minus_camera_s: Option<(f64, f64)>,
    /// Spread of the rotations about each axis, in radians.
    pub rotation_spread_rad: f64,
    /// Spread of the places along each axis, in metres.
    pub place_spread_m: f64,
    /// What is left at each moment that counts.
    pub residuals: Vec<Residual>,
    /// Names of the moments that do not fit.
    pub rejected: Vec<String>,
    /// Moments at which the tracker gave no pose.
    pub untracked: usize,
}

/// What is left at a moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Name of the picture.
    pub name: String,
    /// Angle between the camera as seen and as tracked, in radians.
    pub rotation_rad: f64,
    /// Distance between both, in metres.
    pub place_m: f64,
}

/// Why the poses cannot be related.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few moments.
    #[error("`{found}` pictures are located while the tracker gave poses (needed: `{MIN_MOMENTS}`)")]
    TooFewMoments {
        /// Moments found.
        found: usize,
    },
    /// The headset was hardly turned.
    #[error("the headset was turned by `{spread_deg:.1}°` only (root mean square; needed: `{MIN_SPREAD_DEG}°`)")]
    TooLittleRotation {
        /// Spread of its rotations.
        spread_deg: f64,
    },
    /// The headset was turned about one axis.
    #[error(
        "the headset was turned about one axis only: about a second one by `{spread_deg:.1}°` (root mean square; needed: \
         `{MIN_SECOND_SPREAD_DEG}°`)"
    )]
    OneAxis {
        /// Spread about the second axis.
        spread_deg: f64,
    },
    /// The refinement failed.
    #[error("the refinement failed")]
    Solve(#[from] SolveError),
}

/// A moment with both poses.
struct Pair {
    tracker_from_headset: Pose,
    world_from_camera: Pose,
}

/// Finds both poses. `track` is ordered by time.
///
/// # Errors
/// When there are too few moments, the motion does not determine the poses, or the refinement does not converge.
pub fn solve(track: &[TrackedPose], moments: &[Moment], clocks: Clocks) -> Result<HandEye, HandEyeError> {
    let track = Track::new(track);
    let is_tracked = |moment: &&Moment| track.at(track.seconds(moment.timestamp_ns)).is_some();
    let tracked: Vec<&Moment> = moments.iter().filter(is_tracked).collect();
    if tracked.len() < MIN_MOMENTS {
        return Err(HandEyeError::TooFewMoments { found: tracked.len() });
    }
    check_rotations(&tracked)?;
    let start = match clocks {
        Clocks::Same => first(&track, &tracked, 0.0).ok_or(SolveError::Singular)?,
        Clocks::Offset => {
            let n = (MAX_OFFSET_S / OFFSET_STEP_S).round() as i32;
            let starts = (-n..=n).filter_map(|i| first(&track, &tracked, f64::from(i) * OFFSET_STEP_S));
            starts.min_by(|a, b| a.1.total_cmp(&b.1)).ok_or(SolveError::Singular)?
        }
    };
    let untracked = moments.len() - tracked.len();
    Ok(refine::refine(&track, &tracked, (start.0, clocks), untracked)?)
}

/// Both poses at the moments, with this offset added to their time; moments without a tracked pose are left out.
fn pairs(track: &Track<'_>, moments: &[&Moment], offset_s: f64) -> Vec<Pair> {
    let pair = |moment: &&Moment| {
        Some(Pair {
            tracker_from_headset: track.at(track.seconds(moment.timestamp_ns) + offset_s)?,
            world_from_camera: moment.camera_from_world.inverse(),
        })
    };
    moments.iter().filter_map(pair).collect()
}

/// The closed-form solution with this offset, and its median error: radians and metres alike, for comparison only.
fn first(track: &Track<'_>, moments: &[&Moment], offset_s: f64) -> Option<(refine::State, f64)> {
    let pairs = pairs(track, moments, offset_s);
    if pairs.len() < MIN_MOMENTS {
        return None;
    }
    let (headset_from_camera, world_from_tracker) = shah::solve(&pairs)?;
    let state = refine::State {
        headset_from_camera,
        world_from_tracker,
        offset_s,
    };
    let error = |pair: &Pair| {
        let twist = refine::error(&state, &pair.tracker_from_headset, &pair.world_from_camera);
        twist.rotation.length() + twist.translation.length()
    };
    let mut errors: Vec<f64> = pairs.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    Some((state, errors[errors.len() / 2]))
}

/// Refuses motions that leave something open (Tsai and Lenz 1989, section III: two axes that are not parallel are needed).
fn check_rotations(moments: &[&Moment]) -> Result<(), HandEyeError> {
    let reference = moments[0].camera_from_world;
    let turns: Vec<_> = moments
        .iter()
        .map(|moment| (moment.camera_from_world * reference.inverse()).log().rotation)
        .collect();
    let n = turns.len() as f64;
    let mean = turns.iter().sum::<glam::DVec3>() / n;
    let mut scatter = Matrix3::zeros();
    for turn in turns {
        let off = nalgebra::Vector3::from((turn - mean).to_array());
        scatter += off * off.transpose() / n;
    }
    let mut spreads: Vec<f64> = scatter
        .symmetric_eigenvalues()
        .iter()
        .map(|x| x.max(0.0).sqrt().to_degrees())
        .collect();
    spreads.sort_by(|a, b| b.total_cmp(a));
    let spread_deg = spreads[0].hypot(spreads[1]).hypot(spreads[2]);
    if spread_deg < MIN_SPREAD_DEG {
        return Err(HandEyeError::TooLittleRotation { spread_deg });
    }
    if spreads[1] < MIN_SECOND_SPREAD_DEG {
        return Err(HandEyeError::OneAxis { spread_deg: spreads[1] });
    }
    Ok(())
}

impl HandEye {
    /// How sure `headset_from_camera` is.
    #[must_use]
    pub fn camera_sigma(&self) -> PoseSigma {
        PoseSigma::of(&self.camera_covariance)
    }

    /// How sure `world_from_tracker` is.
    #[must_use]
    pub fn tracker_sigma(&self) -> PoseSigma {
        PoseSigma::of(&self.tracker_covariance)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::extrinsics::simulation::{Noise, pose, squared_deviations};
    use crate::pose::Twist;

    const START_NS: u64 = 1_700_000_000_000_000_000;

    struct Simulation {
        track: Vec<TrackedPose>,
        moments: Vec<Moment>,
    }

    fn headset_from_camera() -> Pose {
        pose([0.1, -0.3, 1.2], [0.03, 0.05, -0.08])
    }

    fn world_from_tracker() -> Pose {
        pose([1.0, 0.4, -2.0], [1.5, -0.7, 2.0])
    }

    /// A head that looks about for `n` pictures at 10 Hz, tracked at 200 Hz. `axes`: how far it turns about each, radians.
    fn look_about(n: usize, axes: DVec3, noise: (&mut Noise, f64, f64), offset_s: f64) -> Simulation {
        let (noise, rotation_rad, place_m) = noise;
        let at = |t: f64| {
            let turn = DVec3::new((1.3 * t).sin(), (0.9 * t + 1.0).sin(), (0.7 * t + 2.0).sin()) * axes;
            let place = DVec3::new((0.8 * t).sin(), (1.1 * t).cos(), (0.5 * t).sin()) * 0.3;
            pose(turn.to_array(), place.to_array())
        };
        let ns = |t: f64| START_NS + (t * 1e9).round() as u64;
        let mut track = Vec::new();
        for i in 0..n * 20 + 400 {
            let t = 0.005 * i as f64;
            let jitter = Twist {
                rotation: noise.vector(rotation_rad),
                translation: noise.vector(place_m),
            };
            track.push(TrackedPose {
                timestamp_ns: ns(t),
                tracker_from_headset: at(t) * Pose::exp(jitter),
            });
        }
        let moment = |i: usize| {
            let t = 0.5 + 0.1 * i as f64 + 0.0021;
            let world_from_camera = world_from_tracker() * at(t + offset_s) * headset_from_camera();
            Moment {
                name: format!("{i}"),
                timestamp_ns: ns(t),
                camera_from_world: world_from_camera.inverse(),
            }
        };
        Simulation {
            moments: (0..n).map(moment).collect(),
            track,
        }
    }

    const ABOUT: DVec3 = DVec3::new(0.4, 0.5, 0.3);

    #[test]
    fn exact_poses_give_exact_answers() {
        let all = look_about(40, ABOUT, (&mut Noise(1), 0.0, 0.0), 0.0);
        let found = solve(&all.track, &all.moments, Clocks::Same).unwrap();
        // Between tracked poses the head does not move along a screw, quite.
        assert!(
            (found.headset_from_camera.inverse() * headset_from_camera())
                .translation
                .length()
                < 1e-5
        );
        assert!(
            (found.world_from_tracker.inverse() * world_from_tracker())
                .translation
                .length()
                < 1e-5
        );
        assert_eq!(
            (found.untracked, found.rejected.len(), found.residuals.len()),
            (0, 0, 40)
        );
    }

    #[test]
    fn sigma_is_what_errors_are() {
        let (mut camera, mut tracker, mut offset) = (0.0, 0.0, 0.0);
        let n = 16;
        for seed in 0..n {
            let all = look_about(50, ABOUT, (&mut Noise(seed), 1e-3, 1e-3), 0.0);
            let found = solve(&all.track, &all.moments, Clocks::Offset).unwrap();
            let off = (found.headset_from_camera.inverse() * headset_from_camera()).log();
            camera += squared_deviations(off, &found.camera_covariance) / 6.0;
            let off = (found.world_from_tracker.inverse() * world_from_tracker()).log();
            tracker += squared_deviations(off, &found.tracker_covariance) / 6.0;
            let (seconds, sigma) = found.tracker_minus_camera_s.unwrap();
            offset += (seconds / sigma).powi(2);
        }
        for sum in [camera, tracker, offset] {
            let ratio = f64::sqrt(sum / n as f64);
            assert!((1.0 / 1.5..1.5).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn clocks_may_differ() {
        let all = look_about(60, ABOUT, (&mut Noise(3), 5e-4, 5e-4), 0.0634);
        let found = solve(&all.track, &all.moments, Clocks::Offset).unwrap();
        let (seconds, sigma) = found.tracker_minus_camera_s.unwrap();
        assert!((seconds - 0.0634).abs() < 1e-3, "{seconds} {sigma}");
        let off = found.headset_from_camera.inverse() * headset_from_camera();
        assert!(off.translation.length() < 1e-3, "{off:?}");
    }

    #[test]
    fn a_pose_that_jumps_is_named() {
        let mut all = look_about(40, ABOUT, (&mut Noise(4), 5e-4, 5e-4), 0.0);
        all.moments[7].camera_from_world.translation.x += 0.1;
        let found = solve(&all.track, &all.moments, Clocks::Same).unwrap();
        assert_eq!(found.rejected, ["7"]);
        let off = found.headset_from_camera.inverse() * headset_from_camera();
        assert!(off.translation.length() < 1e-3, "{off:?}");
    }

    #[test]
    fn motions_that_leave_something_open_are_refused() {
        let still = look_about(40, ABOUT * 0.05, (&mut Noise(1), 0.0, 0.0), 0.0);
        let error = solve(&still.track, &still.moments, Clocks::Same).unwrap_err();
        assert!(matches!(error, HandEyeError::TooLittleRotation { .. }), "{error}");
        let nodding = look_about(40, DVec3::X * 0.5, (&mut Noise(1), 0.0, 0.0), 0.0);
        let error = solve(&nodding.track, &nodding.moments, Clocks::Same).unwrap_err();
        assert!(matches!(error, HandEyeError::OneAxis { .. }), "{error}");
        let mut gone = look_about(40, ABOUT, (&mut Noise(1), 0.0, 0.0), 0.0);
        gone.track.truncate(200);
        let error = solve(&gone.track, &gone.moments, Clocks::Same).unwrap_err();
        assert_eq!(error, HandEyeError::TooFewMoments { found: 5 });
    }
}
