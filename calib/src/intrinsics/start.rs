//! Where a solve begins: which kind of lens, about how long, and where the board was.
//!
//! Nothing here works on a plane z = 1. A lens is supposed, pixels become rays, rays give every pose
//! ([`super::planar_pose`]); the supposition that leaves the least between corners seen and predicted is the start. That is a
//! search in one number, the focal length, for each law that the model can take on.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::{
    planar_pose::{PlanarPose, planar_pose},
    problem::{Free, Problem, Sighting, State},
    warp::{WARP, WarpedBoard},
};
use crate::{
    camera::{Intrinsics, LensModel, Model},
    least_squares::{arrow::minimise, loss::Loss},
    pose::Pose,
};

/// Shortest and longest focal length supposed, in half diagonals of the picture: a round fisheye picture of 220° inside the
/// frame, and a field of view of 3°.
const FOCALS: [f64; 2] = [0.12, 40.0];

/// Ratio of one focal length supposed to the one before.
const FOCAL_STEP: f64 = 1.25;

/// Views and corners per view that judge a supposition.
const JUDGES: [usize; 2] = [16, 40];

/// Suppositions whose poses are refined for each that is asked for.
const REFINED: usize = 2;

/// Iterations for a pose under a lens that is only supposed.
const POSE_ITERATIONS: usize = 40;

/// Step, in radians, of the search for the angle at which a lens folds back.
const FOLD_STEP: f64 = 0.01;

/// Residual, in parts of the picture's diagonal, beyond which corners count linearly: an unknown distortion is no outlier.
const SCALE: f64 = 0.003;

/// A lens that might be the one.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    pub(super) intrinsics: Intrinsics,
    /// Median over the views of the median residual, in pixels.
    pub(super) score_px: f64,
}

/// The views and corners that judge suppositions: evenly taken from all.
pub(super) fn judges(sightings: &[Sighting]) -> Vec<Sighting> {
    let corners = |sighting: &Sighting| evenly(&sighting.corners, JUDGES[1]).copied().collect();
    evenly(sightings, JUDGES[0])
        .map(|sighting| Sighting {
            view: sighting.view,
            corners: corners(sighting),
        })
        .collect()
}

/// At most `count` suppositions, those that explain the sightings best, the best first; those without any pose are left out.
pub(super) fn hypotheses(
    model: Model,
    size_px: [u32; 2],
    board: &WarpedBoard,
    judges: &[Sighting],
    count: usize,
) -> Vec<Hypothesis> {
    let supposed: Vec<Intrinsics> = lenses(model, size_px).collect();
    let ranked = |supposed: Vec<Intrinsics>, pose: Locate| {
        let mut found: Vec<Hypothesis> = supposed
            .into_par_iter()
            .filter_map(|lens| judge(&lens, board, judges, pose))
            .collect();
        found.sort_by(|a, b| a.score_px.total_cmp(&b.score_px));
        found
    };
    let coarse = ranked(supposed, linear_pose);
    let refined = coarse
        .into_iter()
        .take(REFINED * count)
        .map(|hypothesis| hypothesis.intrinsics);
    let mut best = ranked(refined.collect(), pose);
    best.truncate(count);
    best
}

/// How the pose of a sighting is found: with the median of its residuals, in pixels.
type Locate = fn(&Intrinsics, &WarpedBoard, &Sighting) -> Option<(PlanarPose, f64)>;

/// The pose of one sighting through this lens, refined; `None` where there is none.
pub(super) fn pose(intrinsics: &Intrinsics, board: &WarpedBoard, sighting: &Sighting) -> Option<(PlanarPose, f64)> {
    let (linear, _) = linear_pose(intrinsics, board, sighting)?;
    let diagonal = DVec2::new(f64::from(intrinsics.size_px[0]), f64::from(intrinsics.size_px[1])).length();
    let problem = Problem {
        board,
        sightings: std::slice::from_ref(sighting),
        free: Free::poses(),
        loss: Loss::Huber,
        scale: SCALE * diagonal / sighting.corners.first()?.sigma_px,
    };
    let start = at(intrinsics, linear.camera_from_board);
    // A pose that is still moving is good enough to go on from.
    let state = minimise(&problem, start.clone(), POSE_ITERATIONS, &mut |_| {}).map_or(start, |minimum| minimum.state);
    judged(&state, board, sighting)
}

/// The pose that the rays alone give.
fn linear_pose(intrinsics: &Intrinsics, board: &WarpedBoard, sighting: &Sighting) -> Option<(PlanarPose, f64)> {
    let (mut points, mut rays): (Vec<DVec2>, Vec<DVec3>) = (Vec::new(), Vec::new());
    let lens = invertible(intrinsics);
    for corner in &sighting.corners {
        if let Some(ray) = lens.unproject(corner.pixel) {
            points.push(board.flat(corner.index).truncate());
            rays.push(ray);
        }
    }
    if 2 * points.len() < sighting.corners.len() {
        return None;
    }
    let linear = planar_pose(&points, &rays)?;
    judged(&at(intrinsics, linear.camera_from_board), board, sighting)
}

/// The lens up to the angle at which its picture folds back: half-way through a solve a polynomial may do so early, and beyond
/// that angle no pixel has a ray.
fn invertible(intrinsics: &Intrinsics) -> Intrinsics {
    let mut lens = *intrinsics;
    let radius = |angle: f64| {
        let pixel = intrinsics.project(DVec3::new(angle.sin(), 0.0, angle.cos()))?;
        Some(pixel.x - intrinsics.principal_point_px.x)
    };
    if let Some(end) = intrinsics.lens.max_angle_rad() {
        let mut angle = 0.0;
        while angle + FOLD_STEP < end && radius(angle + FOLD_STEP) > radius(angle) {
            angle += FOLD_STEP;
        }
        let (model, coefficients) = (intrinsics.lens.model(), intrinsics.lens.coefficients());
        lens.lens = LensModel::from_coefficients(model, &coefficients, angle).expect("as many as the model has");
    }
    lens
}

fn at(intrinsics: &Intrinsics, camera_from_board: Pose) -> State {
    State {
        intrinsics: *intrinsics,
        warp: [0.0; WARP],
        poses: vec![camera_from_board],
    }
}

fn judged(state: &State, board: &WarpedBoard, sighting: &Sighting) -> Option<(PlanarPose, f64)> {
    let residual = |corner| state.residual(board, 0, corner).map_or(f64::INFINITY, DVec2::length);
    let camera_from_board = state.poses[0];
    let pose = PlanarPose {
        camera_from_board,
        from_the_front: camera_from_board.inverse().translation.z > 0.0,
    };
    Some((pose, median(sighting.corners.iter().map(residual).collect())?))
}

fn judge(lens: &Intrinsics, board: &WarpedBoard, judges: &[Sighting], locate: Locate) -> Option<Hypothesis> {
    let scores = judges
        .iter()
        .map(|one| locate(lens, board, one).map_or(f64::INFINITY, |(_, score)| score));
    let score_px = median(scores.collect())?;
    score_px.is_finite().then_some(Hypothesis {
        intrinsics: *lens,
        score_px,
    })
}

/// A lens as most of its kind are: 53° across the picture, or for a fisheye 180°.
pub(super) fn ordinary(model: Model, size_px: [u32; 2]) -> Intrinsics {
    let size = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1]));
    let focal = if model.is_fisheye() { size.x / PI } else { size.x };
    Intrinsics {
        size_px,
        focal_px: DVec2::splat(focal),
        principal_point_px: 0.5 * (size - 1.0),
        lens: laws(model)[0],
    }
}

/// The lenses supposed: every law at every focal length, the axis in the middle of the picture.
fn lenses(model: Model, size_px: [u32; 2]) -> impl Iterator<Item = Intrinsics> {
    let size = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1]));
    let half_diagonal = 0.5 * size.length();
    let steps = ((FOCALS[1] / FOCALS[0]).ln() / FOCAL_STEP.ln()).ceil() as i32;
    laws(model).into_iter().flat_map(move |lens| {
        (0..=steps).map(move |step| Intrinsics {
            size_px,
            focal_px: DVec2::splat(half_diagonal * FOCALS[0] * FOCAL_STEP.powi(step)),
            principal_point_px: 0.5 * (size - 1.0),
            lens,
        })
    })
}

/// Lenses of a model that others are near to: without distortion, and for models that reach from a pinhole to a fisheye some in
/// between. They image everything they can: while a lens is being solved for, no corner that was seen may be beyond its
/// largest angle.
fn laws(model: Model) -> Vec<LensModel> {
    let starts: &[&[f64]] = match model {
        Model::BrownConrady => &[&[0.0; 5]],
        Model::Rational => &[&[0.0; 8]],
        Model::KannalaBrandt => &[&[0.0; 4]],
        Model::Equisolid => &[&[]],
        Model::Eucm => &[&[0.6, 1.0], &[0.2, 1.0]],
        Model::DoubleSphere => &[&[0.0, 0.6], &[0.0, 0.2]],
    };
    let lens = |values: &&[f64]| LensModel::from_coefficients(model, values, PI);
    starts.iter().filter_map(lens).collect()
}

/// At most `count` elements, evenly spread.
fn evenly<T>(all: &[T], count: usize) -> impl Iterator<Item = &T> {
    let taken = count.min(all.len());
    (0..taken).map(move |i| &all[i * all.len() / taken])
}

/// The middle of some numbers.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
