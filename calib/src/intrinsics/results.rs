//! What a solve found, checked and told.

use glam::{DVec2, DVec3};

use super::{
    CalibratedView, Calibration, IntrinsicsError, MIN_VIEWS, Reach, RejectedBecause, RejectedCorner, RejectedView,
    Request, Residual, UncertaintyMap, Warning, coverage,
    problem::{Sighting, State, lens_part},
    solve::{LeftOut, Solved, Solver},
    start,
};
use crate::{
    board::BoardView,
    camera::{Intrinsics, LensModel},
    least_squares::arrow::SolveError,
    pose::Pose,
};

/// Angle between the board's normals, in degrees, from which on the board counts as tilted, whatever is not known.
const TILTED_DEG: f64 = 40.0;

/// Noise of a coordinate, in pixels, above which board and pictures do not belong together. Corners of a blurred picture
/// are within 0.5.
const MISMATCH_PX: f64 = 2.0;

/// Rms in pixels above which something is wrong with a good camera and a good board.
const LARGE_RMS_PX: f64 = 0.7;

/// Spread of the board's normals, in degrees, below which they are all alike.
const PARALLEL_DEG: f64 = 10.0;

/// Standard deviation of the focal length, in parts of it, above which it is not known: with views that are all alike, and in
/// any case.
const UNKNOWN_FOCAL: [f64; 2] = [0.01, 0.1];

/// Standard deviation of the focal length, in parts of it, worth a warning.
const VAGUE_FOCAL: f64 = 0.003;

/// Views below which more are worth taking.
const FEW_VIEWS: usize = 10;

/// Height of a bent board over its plane, in metres, worth a warning.
const BENT_M: f64 = 0.002;

/// Standard deviation of a projection, in pixels, worth a warning.
const UNCERTAIN_PX: f64 = 1.0;

/// Part of the picture's half diagonal that must have been reached before a lens is believed to fill its picture.
const FILLS: f64 = 0.85;

/// How far beyond the outermost corner, in parts of its angle, a lens is believed when it does not fill its picture.
const BEYOND: f64 = 1.03;

/// Step, in radians, of the search for the end of a fisheye's picture.
const ANGLE_STEP: f64 = 0.002;

/// Cells of the map that judges the lens.
pub(super) const MAP_CELLS: [usize; 2] = [32, 24];

/// Checks that enough views are left.
pub(super) fn enough(sightings: &[Sighting], views: &[BoardView], left_out: &[LeftOut]) -> Result<(), IntrinsicsError> {
    if sightings.len() >= MIN_VIEWS {
        return Ok(());
    }
    const NAMED: usize = 5;
    let reasons = left_out
        .iter()
        .take(NAMED)
        .map(|(view, reason)| format!("; `{}`: {reason}", views[*view].name));
    let mut text: String = reasons.collect();
    if left_out.len() > NAMED {
        text.push_str(&format!("; and `{}` more", left_out.len() - NAMED));
    }
    Err(IntrinsicsError::TooFewViews {
        usable: sightings.len(),
        given: views.len(),
        needed: MIN_VIEWS,
        left_out: text,
    })
}

/// Leaves out views that show the board's back; when most do, the pictures are mirrored.
pub(super) fn seen_from_the_front(
    solver: &mut Solver<'_>,
    state: &mut State,
    views: &[BoardView],
) -> Result<(), IntrinsicsError> {
    let behind: Vec<bool> = state
        .poses
        .iter()
        .map(|pose| pose.inverse().translation.z <= 0.0)
        .collect();
    let mirrored = behind.iter().filter(|behind| **behind).count();
    if 2 * mirrored > behind.len() {
        let first = behind.iter().position(|behind| *behind).expect("most are");
        return Err(IntrinsicsError::Mirrored {
            mirrored,
            views: behind.len(),
            view: views[solver.sightings[first].view].name.clone(),
        });
    }
    let mut index = 0;
    solver.sightings.retain(|sighting| {
        let stays = !behind[index];
        if !stays {
            solver.left_out.push((sighting.view, RejectedBecause::Mirrored));
        }
        index += 1;
        stays
    });
    let mut index = 0;
    state.poses.retain(|_| {
        index += 1;
        !behind[index - 1]
    });
    Ok(())
}

/// The largest angle between two of the board's normals, in radians, and between which sightings.
pub(super) fn spread(poses: &[Pose]) -> (f64, usize, usize) {
    let mut widest = (0.0, 0, 0);
    for (i, a) in poses.iter().enumerate() {
        for (j, b) in poses.iter().enumerate().skip(i + 1) {
            let angle = a.rotation.z_axis.angle_between(b.rotation.z_axis);
            if angle > widest.0 {
                widest = (angle, i, j);
            }
        }
    }
    widest
}

/// The board's poses and the names of the views that they are of.
pub(super) fn named(poses: &[Pose], solver: &Solver<'_>, views: &[BoardView]) -> Vec<(String, Pose)> {
    let names = solver
        .sightings
        .iter()
        .map(|sighting| views[sighting.view].name.clone());
    names.zip(poses.iter().copied()).collect()
}

/// The error for views that are all parallel, if they are; `sigma_focal` relative to the focal length, infinite where it is not
/// known.
pub(super) fn parallel(named: &[(String, Pose)], sigma_focal: f64) -> Option<IntrinsicsError> {
    let poses: Vec<Pose> = named.iter().map(|(_, pose)| *pose).collect();
    let (spread, first, second) = spread(&poses);
    let alike = spread.to_degrees() < PARALLEL_DEG;
    let limit = if alike { UNKNOWN_FOCAL[0] } else { UNKNOWN_FOCAL[1] };
    let name = |index: usize| named.get(index).map_or_else(String::new, |(name, _)| name.clone());
    let is_unknown = if sigma_focal.is_finite() {
        sigma_focal > limit
    } else {
        alike
    };
    is_unknown.then(|| IntrinsicsError::Parallel {
        spread_deg: spread.to_degrees(),
        sigma_percent: 100.0 * sigma_focal,
        first: name(first),
        second: name(second),
    })
}

/// The error for corners that are not where the board file says, if they are not.
pub(super) fn mismatch(solver: &Solver<'_>, state: &State) -> Option<IntrinsicsError> {
    let mut lengths = Vec::new();
    for (index, sighting) in solver.sightings.iter().enumerate() {
        let residuals = sighting
            .corners
            .iter()
            .map(|corner| state.residual(solver.board, index, corner));
        lengths.extend(residuals.map(|residual| residual.map_or(f64::INFINITY, DVec2::length)));
    }
    let residual_px = start::median(lengths)? / 1.18;
    (residual_px > MISMATCH_PX).then_some(IntrinsicsError::Mismatch {
        model: solver.model,
        residual_px,
    })
}

/// The calibration that a minimum is.
pub(super) fn calibration(
    request: &Request<'_>,
    views: &[BoardView],
    solver: &Solver<'_>,
    solved: &Solved,
) -> Result<Calibration, IntrinsicsError> {
    let state = &solved.minimum.state;
    let n_parameters = solver.model.parameter_names().len();
    let covariance = solved.minimum.system.shared_covariance();
    let covariance = covariance.map(|covariance| covariance * solved.variance);
    let sigma_focal = covariance.as_ref().map_or(f64::INFINITY, |covariance| {
        let relative = |i: usize| covariance[(i, i)].sqrt() / state.intrinsics.focal_px[i];
        relative(0).max(relative(1))
    });
    if let Some(error) = parallel(&named(&state.poses, solver, views), sigma_focal) {
        return Err(error);
    }
    let covariance = covariance.ok_or(IntrinsicsError::Solve(SolveError::Singular))?;
    let intrinsics = limited(&state.intrinsics, request.max_angle_rad, solver, state);
    if !intrinsics.lens.is_usable() {
        return Err(IntrinsicsError::Unusable { model: solver.model });
    }
    let mut calibration = Calibration {
        intrinsics,
        covariance: lens_part(&covariance, n_parameters),
        board_warp_m: state.warp,
        board_warp_sigma_m: solved.warp_sigma_m,
        rms_px: 0.0,
        noise: solved.variance.sqrt(),
        views: Vec::new(),
        rejected_corners: Vec::new(),
        rejected_views: Vec::new(),
        warnings: Vec::new(),
    };
    tell_views(&mut calibration, views, solver, state);
    warn(&mut calibration, sigma_focal, spread(&state.poses).0.to_degrees());
    Ok(calibration)
}

/// Fills in what became of each view and corner.
fn tell_views(calibration: &mut Calibration, views: &[BoardView], solver: &Solver<'_>, state: &State) {
    let mut order: Vec<usize> = (0..solver.sightings.len()).collect();
    order.sort_by_key(|&index| solver.sightings[index].view);
    let (mut sum, mut count) = (0.0, 0usize);
    for index in order {
        let sighting = &solver.sightings[index];
        let name = &views[sighting.view].name;
        let mut residuals = Vec::with_capacity(sighting.corners.len());
        for corner in &sighting.corners {
            let residual_px = state.residual(solver.board, index, corner).unwrap_or(DVec2::NAN);
            if corner.used {
                residuals.push(Residual {
                    corner: corner.index as u32,
                    pixel: corner.pixel,
                    residual_px,
                });
            } else {
                calibration.rejected_corners.push(RejectedCorner {
                    view: name.clone(),
                    corner: corner.index as u32,
                    pixel: corner.pixel,
                    residual_px,
                });
            }
        }
        let squares: f64 = residuals.iter().map(|r| r.residual_px.length_squared()).sum();
        (sum, count) = (sum + squares, count + residuals.len());
        calibration.views.push(CalibratedView {
            name: name.clone(),
            camera_from_board: state.poses[index],
            rms_px: (squares / residuals.len() as f64).sqrt(),
            worst_px: residuals.iter().map(|r| r.residual_px.length()).fold(0.0, f64::max),
            residuals,
        });
    }
    calibration.rms_px = (sum / count as f64).sqrt();
    let mut left_out = solver.left_out.clone();
    left_out.sort_by_key(|(view, _)| *view);
    let rejected = left_out.into_iter().map(|(view, reason)| RejectedView {
        name: views[view].name.clone(),
        reason,
    });
    calibration.rejected_views = rejected.collect();
}

fn warn(calibration: &mut Calibration, sigma_focal: f64, spread_deg: f64) {
    let mut warnings = Vec::new();
    let views = calibration.views.len();
    if views < FEW_VIEWS {
        warnings.push(Warning::FewViews { views });
    }
    let pixels = calibration
        .views
        .iter()
        .flat_map(|view| view.residuals.iter().map(|r| r.pixel));
    let empty = coverage::empty_part(&calibration.intrinsics, pixels);
    if empty > 0.1 {
        warnings.push(Warning::Coverage { percent: 100.0 * empty });
    }
    if sigma_focal > VAGUE_FOCAL && spread_deg < TILTED_DEG {
        warnings.push(Warning::HardlyTilted {
            spread_deg,
            sigma_percent: 100.0 * sigma_focal,
        });
    }
    if calibration.rms_px > LARGE_RMS_PX {
        warnings.push(Warning::LargeResiduals {
            rms_px: calibration.rms_px,
        });
    }
    let [x, y, twist] = calibration.board_warp_m;
    let bend = (x + y).abs().max(x.abs()).max(y.abs()).max(twist.abs());
    if bend > BENT_M {
        warnings.push(Warning::Bent { bend_mm: 1e3 * bend });
    }
    let map = UncertaintyMap::new(
        &calibration.intrinsics,
        &calibration.covariance,
        MAP_CELLS,
        Reach::Infinity,
    );
    if let Some(worst_px) = map.map(|map| map.worst_px()).filter(|worst| *worst > UNCERTAIN_PX) {
        warnings.push(Warning::Uncertain { worst_px });
    }
    calibration.warnings = warnings;
}

/// The lens with the angle beyond which it images nothing; see [`Request::max_angle_rad`].
fn limited(lens: &Intrinsics, wanted: Option<f64>, solver: &Solver<'_>, state: &State) -> Intrinsics {
    let mut limited = *lens;
    if lens.lens.max_angle_rad().is_some() {
        let angle = wanted.unwrap_or_else(|| measured_angle(lens, solver, state));
        let model = lens.lens.model();
        limited.lens = LensModel::from_coefficients(model, &lens.lens.coefficients(), angle)
            .expect("as many coefficients as the model has");
    }
    limited
}

fn measured_angle(lens: &Intrinsics, solver: &Solver<'_>, state: &State) -> f64 {
    let from_centre = |pixel: DVec2| (pixel - lens.principal_point_px).length();
    let (mut angle, mut radius) = (0.0f64, 0.0f64);
    for (pose, sighting) in state.poses.iter().zip(&solver.sightings) {
        for corner in sighting.corners.iter().filter(|corner| corner.used) {
            let point = pose.transform_point(solver.board.bent(corner.index, &state.warp));
            angle = angle.max(point.angle_between(DVec3::Z));
            radius = radius.max(from_centre(corner.pixel));
        }
    }
    let size = DVec2::new(f64::from(lens.size_px[0]), f64::from(lens.size_px[1])) - 0.5;
    let picture_corners = [
        DVec2::splat(-0.5),
        DVec2::new(size.x, -0.5),
        DVec2::new(-0.5, size.y),
        size,
    ];
    let farthest = picture_corners
        .into_iter()
        .max_by(|a, b| from_centre(*a).total_cmp(&from_centre(*b)));
    let farthest = farthest.expect("a picture has four corners");
    let wanted = if radius >= FILLS * from_centre(farthest) {
        std::f64::consts::PI
    } else {
        angle * BEYOND
    };
    // Outwards from the outermost corner as long as the radius grows, and no farther than the picture's corner.
    let outwards = ((farthest - lens.principal_point_px) / lens.focal_px).normalize();
    let radius_at = |angle: f64| {
        lens.project((outwards * angle.sin()).extend(angle.cos()))
            .map(from_centre)
    };
    let mut reached = angle * (1.0 + 1e-9);
    while let (Some(here), Some(next)) = (radius_at(reached), radius_at(reached + ANGLE_STEP)) {
        if reached >= wanted || here >= from_centre(farthest) || next <= here {
            break;
        }
        reached += ANGLE_STEP;
    }
    reached.min(std::f64::consts::PI)
}
