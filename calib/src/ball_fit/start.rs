//! How large the ball is, roughly: radii are tried.

use rayon::prelude::*;

use super::{BallPrior, BallView};
use crate::probe::{
    mirror_ball::MirrorBall,
    outline::{OutlineFinder, OutlineSettings},
};

/// Radii that are tried, metres.
const RANGE_M: [f64; 2] = [0.008, 0.16];
/// Ratio of neighbouring radii; the outline's fit reaches that far.
const RATIO: f64 = 1.03;
/// Views that are asked at most.
const MAX_VIEWS: usize = 4;

/// The radius whose outline the pictures support best, metres: the one on which the largest share of the outline agrees, over
/// all views. A wrong one finds a circle in one picture or another, but not in all of them.
pub(super) fn radius_m(views: &[BallView<'_>], prior: &BallPrior) -> f64 {
    let stride = views.len().div_ceil(MAX_VIEWS);
    let n_radii = ((RANGE_M[1] / RANGE_M[0]).ln() / RATIO.ln()).ceil() as i32;
    let settings = OutlineSettings {
        search_m: 0.006,
        size_sigma: RATIO - 1.0,
        blur_px: super::TYPICAL_BLUR_PX,
        window_px: super::WINDOW_PX[0],
    };
    let tried: Vec<(f64, f64)> = (0..=n_radii)
        .into_par_iter()
        .map(|step| {
            let ball = MirrorBall {
                center_m: prior.center_m,
                radius_m: RANGE_M[0] * RATIO.powi(step),
            };
            let share = |view: &BallView<'_>| {
                let window_px = super::window_px(&view.view, &ball);
                let mut finder = OutlineFinder::new(OutlineSettings { window_px, ..settings });
                let sighting = finder.sight(&view.view, &ball, prior.reflectance);
                sighting.map_or(0.0, |sighting| sighting.n_used as f64 / sighting.n_profiles as f64)
            };
            (views.iter().step_by(stride).map(share).sum(), ball.radius_m)
        })
        .collect();
    let best = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(RANGE_M[0], |(_, radius_m)| radius_m)
}
