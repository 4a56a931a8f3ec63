//! Where the mirror ball is and how large: from its outline in several pictures, with what that means for light.
//!
//! A ball is seen within a circular cone of rays ([`outline`](crate::probe::outline)): each picture tells the direction to
//! its centre and the cone's half-angle `asin(radius / distance)`. Pictures from different sides tell the centre by
//! crossing their lines of sight, and the radius with it. All are solved together, in the metric of their covariances, with
//! one more unknown: how much wider every outline is than the ball makes it, which is expected to be 0 ± 0.1 pixels. A picture that
//! contradicts the others is left out and named.
//!
//! [`direction`] says what the covariance of centre and radius means for the direction that a pixel shows, [`reflectance`]
//! measures how much light the ball sends back.

pub mod direction;
pub mod reflectance;
mod solve;
mod start;

use glam::{DVec3, Vec3};
use nalgebra::Matrix4;
use rayon::prelude::*;

use crate::probe::{
    View,
    mirror_ball::MirrorBall,
    outline::{ConeSighting, OutlineError, OutlineFinder, OutlineSettings},
};

/// Rounds of looking for the outline where the last solve has put it.
const ROUNDS: usize = 6;
/// The rounds end when centre and radius move by less than this, metres.
const STILL_M: f64 = 2e-6;
/// Blur that outlines are first looked for with, pixels.
const TYPICAL_BLUR_PX: f64 = 0.5;
/// How far outside the outline its edge is judged, pixels: least and most.
const WINDOW_PX: [f64; 2] = [3.0, 4.5];
/// The same in parts of the ball's radius in the picture: the reflections of the surroundings crowd in a small ball.
const WINDOW_OF_RADIUS: f64 = 0.045;
/// Blurs that are tried, pixels: the edge of a blurred mirror has another shape, and a wrong one shifts the outline.
const BLURS_PX: [f64; 6] = [0.0, 0.25, 0.5, 0.75, 1.0, 1.3];
/// Largest standard deviation of the radius, relative, of a ball that is handed out.
pub const MAX_RADIUS_SIGMA: f64 = 0.02;
/// Reflectance that outlines are looked for with before it is known.
pub const TYPICAL_REFLECTANCE: Vec3 = Vec3::splat(0.75);

/// A picture of the ball.
#[derive(Debug, Clone)]
pub struct BallView<'a> {
    /// Name, for messages.
    pub name: String,
    /// Picture, camera and pose.
    pub view: View<'a>,
    /// Standard deviation of the camera's place, metres: the outline is no better known than that.
    pub position_sigma_m: f64,
}

/// A length measured with a ruler or calliper, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Its value, above 0.
    pub value_m: f64,
    /// Its standard deviation, above 0.
    pub sigma_m: f64,
}

/// Share of an outline that agrees on the ball, below which it may be a reflection beside the edge (measured: 0.7 to 0.85, and
/// 0.4 there).
const USUAL_SHARE: f64 = 0.55;

/// Radii to start from then, relative to the first.
const OTHER_STARTS: [f64; 4] = [0.993, 1.007, 0.985, 1.015];

/// What is known beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallPrior {
    /// About where the centre is, world frame, metres; good to about 5 mm or to a quarter of the radius.
    pub center_m: DVec3,
    /// About the radius, metres; looked for when missing.
    pub radius_m: Option<f64>,
    /// The radius as measured by hand.
    pub measured_radius: Option<Measured>,
    /// Linear reflectance of red, green and blue as far as known, for the outline's look.
    pub reflectance: Vec3,
}

/// The ball as the pictures show it.
#[derive(Debug, Clone, PartialEq)]
pub struct BallFit {
    /// Centre and radius.
    pub ball: MirrorBall,
    /// Covariance of the centre's x, y, z and of the radius, metres².
    pub covariance_m2: Matrix4<f64>,
    /// How much wider all outlines are than the ball alone would make them, pixels.
    pub growth_px: f64,
    /// Standard deviation of the pictures' blur beyond a pixel's area, pixels, in steps of a quarter.
    pub blur_px: f64,
    /// Factor on the expected standard deviations that makes them those found, 1 or more; it is in the covariance.
    pub scale: f64,
    /// What became of each view, in their order.
    pub views: Vec<ViewResult>,
}

/// What became of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ViewResult {
    /// It counts.
    Used(Agreement),
    /// It shows an outline that contradicts the others.
    Rejected(Agreement),
    /// It shows no outline.
    NoOutline(OutlineError),
}

/// How a view's outline compares with the joint solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Distance of the outline's centre from the joint one, pixels.
    pub center_error_px: f64,
    /// Outline's radius minus the joint one, pixels.
    pub radius_error_px: f64,
    /// Radius of the ball in the picture, pixels.
    pub radius_px: f64,
    /// Squared deviation in expected standard deviations (three degrees of freedom).
    pub deviation_squared: f64,
    /// Share of the outline that agrees on it.
    pub share: f64,
}

/// Why there is no ball.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BallError {
    /// No picture at all.
    #[error("there is no picture with a pose")]
    NoViews,
    /// The ball is in no picture.
    #[error("none of `{n_views}` pictures shows the ball's outline; `{view}`: {reason}")]
    NotSeen {
        /// Pictures looked at.
        n_views: usize,
        /// One of them.
        view: String,
        /// What is wrong there.
        reason: OutlineError,
    },
    /// One picture tells no distance.
    #[error("one picture (`{view}`) cannot tell a near small ball from a far large one")]
    OneView {
        /// The picture.
        view: String,
    },
    /// All pictures are from one side.
    #[error(
        "the pictures do not tell the radius: it would be uncertain by `{:.2} mm` (allowed: `{:.2} mm`)",
        1e3 * sigma_m,
        1e3 * allowed_m
    )]
    RadiusUnknown {
        /// Standard deviation of the radius, metres.
        sigma_m: f64,
        /// Largest one allowed, metres.
        allowed_m: f64,
    },
    /// The outlines are not of one ball that stands still.
    #[error(
        "the outlines disagree: no majority of `{seen}` is of one ball that stands still; furthest off is `{worst}` by `{error_px:.1}` px"
    )]
    Disagree {
        /// Pictures with an outline.
        seen: usize,
        /// The one furthest off.
        worst: String,
        /// How far.
        error_px: f64,
    },
    /// The solve goes astray.
    #[error("the solve for the ball does not converge")]
    NotConverged,
}

/// Finds the ball in pictures.
///
/// Outlines can settle on the reflections just beside the edge, all of them, and then agree on a ball that is 1 % too large. It
/// shows in [`Agreement::share`], 0.4 where 0.7 to 0.85 is usual: then other radii are started from, and the ball with the
/// largest shares is taken.
///
/// # Errors
/// [`BallError`] when the pictures do not tell.
pub fn fit(views: &[BallView<'_>], prior: &BallPrior) -> Result<BallFit, BallError> {
    if views.is_empty() {
        return Err(BallError::NoViews);
    }
    if let ([view], None) = (views, prior.measured_radius) {
        return Err(BallError::OneView {
            view: view.name.clone(),
        });
    }
    let known = prior
        .measured_radius
        .map(|measured| measured.value_m)
        .or(prior.radius_m);
    let radius_m = known.unwrap_or_else(|| start::radius_m(views, prior));
    let from = |factor: f64| {
        let start = MirrorBall {
            center_m: prior.center_m,
            radius_m: factor * radius_m,
        };
        settle(views, prior, start)
    };
    let first = from(1.0)?;
    if first.mean_share() >= USUAL_SHARE {
        return Ok(first);
    }
    let others = OTHER_STARTS.into_iter().filter_map(|factor| from(factor).ok());
    Ok(others.fold(first, |best, other| {
        if other.mean_share() > best.mean_share() {
            other
        } else {
            best
        }
    }))
}

impl BallFit {
    /// Mean over the views that count of the share of the outline that agrees on it.
    fn mean_share(&self) -> f64 {
        let shares = self.views.iter().filter_map(|view| match view {
            ViewResult::Used(agreement) => Some(agreement.share),
            ViewResult::Rejected(_) | ViewResult::NoOutline(_) => None,
        });
        let (sum, n) = shares.fold((0.0, 0.0), |(sum, n), share| (sum + share, n + 1.0));
        sum / f64::max(n, 1.0)
    }
}

/// Looks and solves in turns, from a start to where the outlines agree.
fn settle(views: &[BallView<'_>], prior: &BallPrior, start: MirrorBall) -> Result<BallFit, BallError> {
    let mut ball = start;
    // The first look reaches far; the others start from a joint solution.
    let mut settings = OutlineSettings {
        search_m: 0.008,
        size_sigma: 0.03,
        blur_px: TYPICAL_BLUR_PX,
        window_px: WINDOW_PX[0],
    };
    for round in 0..ROUNDS {
        if round == 1 {
            settings.blur_px = most_likely_blur(views, &ball, prior.reflectance, settings);
        }
        let sightings = look(views, &ball, prior.reflectance, settings);
        // From where the ball is not, and with the wrong blur, good pictures' outlines are further off than they say.
        let expected_scale = if round == 0 { solve::MAX_SCALE } else { 1.0 };
        let solution = solve_for(views, &sightings, prior, (&ball, expected_scale))?;
        let moved = (solution.ball.center_m - ball.center_m).length() + (solution.ball.radius_m - ball.radius_m).abs();
        ball = solution.ball;
        settings.search_m = 0.003;
        if round > 0 && moved < STILL_M {
            break;
        }
    }
    let sightings = look(views, &ball, prior.reflectance, settings);
    let solution = solve_for(views, &sightings, prior, (&ball, 1.0))?;
    finish(views, &sightings, &solution, settings.blur_px)
}

/// The blur with which the edge of a mirror leaves least of the pictures unexplained.
fn most_likely_blur(views: &[BallView<'_>], ball: &MirrorBall, reflectance: Vec3, settings: OutlineSettings) -> f64 {
    let misfit = |blur_px: f64| {
        let sightings = look(views, ball, reflectance, OutlineSettings { blur_px, ..settings });
        let misfits = sightings.iter().flatten().map(|sighting| sighting.misfit);
        let (sum, n) = misfits.fold((0.0, 0), |(sum, n), misfit| (sum + misfit, n + 1));
        // A blur with which hardly a picture shows an outline is not the pictures'.
        if 2 * n < views.len() as i32 {
            f64::INFINITY
        } else {
            sum / f64::from(n)
        }
    };
    let misfits = BLURS_PX.map(misfit);
    let best = (0..BLURS_PX.len())
        .min_by(|a, b| misfits[*a].total_cmp(&misfits[*b]))
        .expect("blurs are tried");
    BLURS_PX[best]
}

type Sightings = Vec<Result<ConeSighting, OutlineError>>;

/// How far outside the ball's outline its edge is judged in a view, pixels.
fn window_px(view: &View<'_>, ball: &MirrorBall) -> f64 {
    let distance_m = view.camera_from_world.transform_point(ball.center_m).length();
    let radius_px = view.camera.intrinsics.focal_px.x * ball.radius_m / distance_m;
    (WINDOW_OF_RADIUS * radius_px).clamp(WINDOW_PX[0], WINDOW_PX[1])
}

/// The outline in every view.
fn look(views: &[BallView<'_>], ball: &MirrorBall, reflectance: Vec3, settings: OutlineSettings) -> Sightings {
    views
        .par_iter()
        .map(|view| {
            let window_px = window_px(&view.view, ball);
            OutlineFinder::new(OutlineSettings { window_px, ..settings }).sight(&view.view, ball, reflectance)
        })
        .collect()
}

fn solve_for(
    views: &[BallView<'_>],
    sightings: &Sightings,
    prior: &BallPrior,
    (start, expected_scale): (&MirrorBall, f64),
) -> Result<solve::Solution, BallError> {
    let mut seen: Vec<solve::Seen> = views
        .iter()
        .zip(sightings)
        .enumerate()
        .filter_map(|(index, (view, sighting))| Some(solve::Seen::new(index, view, start, sighting.as_ref().ok()?)))
        .collect();
    solve::share_sides(&mut seen, start);
    let only = |index: usize| views[index].name.clone();
    match (seen.as_slice(), prior.measured_radius) {
        ([], _) => Err(not_seen(views, sightings)),
        ([one], None) => Err(BallError::OneView { view: only(one.index) }),
        _ => solve::robust(&seen, start, prior.measured_radius, expected_scale).ok_or(BallError::NotConverged),
    }
}

fn not_seen(views: &[BallView<'_>], sightings: &Sightings) -> BallError {
    let first = views.iter().zip(sightings);
    let (view, reason) = first
        .filter_map(|(view, sighting)| Some((view.name.clone(), sighting.as_ref().err().copied()?)))
        .next()
        .expect("a view without an outline has a reason");
    BallError::NotSeen {
        n_views: views.len(),
        view,
        reason,
    }
}

fn finish(
    views: &[BallView<'_>],
    sightings: &Sightings,
    solution: &solve::Solution,
    blur_px: f64,
) -> Result<BallFit, BallError> {
    // Not before the last look, for the same reason.
    if solution.is_contradictory() {
        let (worst, error_px) = solution.worst;
        return Err(BallError::Disagree {
            seen: sightings.iter().flatten().count(),
            worst: views[worst].name.clone(),
            error_px,
        });
    }
    if !solution.has_settled {
        return Err(BallError::NotConverged);
    }
    let sigma_m = solution.covariance_m2[(3, 3)].sqrt();
    let allowed_m = MAX_RADIUS_SIGMA * solution.ball.radius_m;
    if sigma_m.is_nan() || sigma_m > allowed_m {
        return Err(BallError::RadiusUnknown { sigma_m, allowed_m });
    }
    let results = views
        .iter()
        .zip(sightings)
        .enumerate()
        .map(|(index, (view, sighting))| match sighting {
            Err(error) => ViewResult::NoOutline(*error),
            Ok(sighting) => {
                let seen = solve::Seen::new(index, view, &solution.ball, sighting);
                let agreement = seen.agreement(solution, sighting);
                if solution.used.contains(&index) {
                    ViewResult::Used(agreement)
                } else {
                    ViewResult::Rejected(agreement)
                }
            }
        });
    Ok(BallFit {
        ball: solution.ball,
        covariance_m2: solution.covariance_m2,
        growth_px: solution.growth_px,
        blur_px,
        scale: solution.scale,
        views: results.collect(),
    })
}
