//! The mirror ball's outline in a picture: where the ball really is, a little beside where it was measured.
//!
//! A ball is seen within a cone of rays of half-angle `asin(radius / distance)`; its outline is that cone's picture, an
//! ellipse bent by the lens. The search works on rays, so the lens is exact:
//!
//! 1. Across the predicted outline, every pixel and a half along it, profiles of the radiance are read. A mirror's edge has
//!    a shape of its own: a ray that grazes the ball goes straight on, so just inside the outline the ball shows, times
//!    its reflectance, what is seen just outside, and from there the radiance changes like the square root of the depth.
//!    Every place of a profile is judged by how much better that shape explains its surroundings than a cubic does. Plain
//!    edges would not do: the reflections of straight lines crowd within a pixel or two inside the outline, all around.
//! 2. All shifts of the outline within reach are tried; the one with the most evidence is the start.
//! 3. From there the cone's axis (two angles) and its half-angle are fitted to the sum of the evidence over the profiles,
//!    which is bounded for each, so that a card before the ball or the stand below it has little say; with a prior on the
//!    half-angle, which is known better than it can be seen.
//!
//! Observable are the two coordinates across the line of sight. The distance shows in the half-angle alone: a tenth of a
//! pixel on a ball of 35 pixels' radius is 0.3 %, 1.5 mm at half a metre, and any blur looks the same, so the fit reports
//! the half-angle ([`OutlineFit::growth_px`]) and leaves the distance as measured.

mod cone;
mod evidence;

use glam::{DMat3, DVec2, DVec3, Vec3};

use super::View;
use super::mirror_ball::MirrorBall;
use cone::{Cone, ConeFit};
use evidence::{Profiles, Reach};

/// How far the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlineSettings {
    /// Largest shift that is looked for, metres, above 0; cut at a quarter of the ball's radius in the picture and at
    /// 12 pixels.
    pub search_m: f64,
    /// Standard deviation of the ball's radius over its distance as measured, relative, above 0.
    pub size_sigma: f64,
    /// Standard deviation of the picture's blur beyond a pixel's own area, pixels, 0 or more: edges are expected that soft.
    pub blur_px: f64,
    /// How far outside the outline a mirror's edge is judged, pixels; half as far inside. Blurred edges need more of it.
    pub window_px: f64,
}

impl Default for OutlineSettings {
    fn default() -> Self {
        Self {
            search_m: 0.005,
            size_sigma: 0.003,
            blur_px: 0.0,
            window_px: 3.0,
        }
    }
}

/// Share of the outline that must lie in the picture.
pub const MIN_IN_PICTURE: f64 = 0.5;
/// Share of the profiles that must have an edge at all.
pub const MIN_WITH_EDGE: f64 = 0.5;
/// Share of the profiles in the picture that must agree on an outline. On path-traced pictures 37 to 62 % do, and where no
/// ball is, 5 to 28 % by chance.
pub const MIN_AGREEING: f64 = 0.3;
/// Largest standard deviation of the shift, pixels: beyond it the agreeing part of the outline is too short to tell.
pub const MAX_SIGMA_PX: f64 = 0.5;

/// Why there is no outline.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OutlineError {
    /// Too much of the ball is outside the picture, or where the lens images nothing.
    #[error("`{:.0} %` of the ball's outline lies in the picture (allowed: {:.0} % or more)", 100.0 * share, 100.0 * MIN_IN_PICTURE)]
    OutOfPicture {
        /// Share of the outline that lies in the picture.
        share: f64,
    },
    /// The ball's picture is too small to have an outline.
    #[error("the ball's picture has a radius of `{radius_px:.1}` pixels (allowed: 6 or more)")]
    TooSmall {
        /// Its radius.
        radius_px: f64,
    },
    /// The outline does not stand out.
    #[error("the picture has edges across `{:.0} %` of the ball's outline (allowed: {:.0} % or more)", 100.0 * share, 100.0 * MIN_WITH_EDGE)]
    LowContrast {
        /// Share of the outline in the picture across which there is any edge.
        share: f64,
    },
    /// There are edges, but they are not a ball's: something stands before it, or it is not there.
    #[error(
        "`{:.0} %` of the outline agree on a place, to `{sigma_px:.2}` pixels (allowed: {:.0} % or more, {MAX_SIGMA_PX} or less)",
        100.0 * share, 100.0 * MIN_AGREEING
    )]
    Covered {
        /// Share of the outline in the picture that agrees on one place.
        share: f64,
        /// Standard deviation of that place, pixels.
        sigma_px: f64,
    },
}

/// Where the outline says the ball is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlineFit {
    /// Centre of the ball, world frame, metres, at the distance from the camera that was predicted.
    pub center_m: DVec3,
    /// From the predicted centre to that, metres, across the line of sight.
    pub shift_m: DVec3,
    /// Standard deviation of the shift in its least certain direction, metres.
    pub sigma_m: f64,
    /// The same shift in the picture, pixels.
    pub shift_px: DVec2,
    /// Standard deviation in the least certain direction, pixels.
    pub sigma_px: f64,
    /// Squared length of the shift in standard deviations (Mahalanobis distance, two degrees of freedom).
    pub deviation_squared: f64,
    /// How much larger the outline's radius is than predicted, pixels: an error of radius or distance, or blur.
    pub growth_px: f64,
    /// Profiles that agree.
    pub n_used: usize,
    /// Profiles in the picture.
    pub n_profiles: usize,
}

/// The cone of rays that touch the ball, as one picture shows it; camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConeSighting {
    /// Unit ray to the ball's centre.
    pub axis: DVec3,
    /// Angle between the axis and the rays that touch the ball, radians. Blur of the picture widens or narrows it a little.
    pub half_angle_rad: f64,
    /// Two unit vectors across the axis.
    pub basis: [DVec3; 2],
    /// Covariance of the axis (along the basis) and of the half-angle, radians²; blur is not in it.
    pub covariance_rad2: DMat3,
    /// Pixels per radian around the axis.
    pub px_per_rad: f64,
    /// Mean logarithm, over the profiles that agree, of what the edge of a mirror leaves unexplained of them: the lower, the
    /// better do reflectance and blur describe the edge.
    pub misfit: f64,
    /// Profiles that agree.
    pub n_used: usize,
    /// Profiles in the picture.
    pub n_profiles: usize,
}

impl OutlineFit {
    /// Whether the shift is more than measurement error: by chance one still ball in a thousand is called moved (χ² of two
    /// degrees of freedom).
    #[must_use]
    pub fn is_significant(&self) -> bool {
        self.deviation_squared > 13.8
    }
}

/// The search with its memory; one per camera.
#[derive(Debug, Default)]
pub struct OutlineFinder {
    settings: OutlineSettings,
    profiles: Profiles,
}

impl OutlineFinder {
    /// A finder that reaches as far as `settings` say.
    #[must_use]
    pub fn new(settings: OutlineSettings) -> Self {
        Self {
            settings,
            profiles: Profiles::default(),
        }
    }

    /// Finds the outline of `ball`, predicted where it was measured, in a picture. The memory is used again, so that a
    /// second picture allocates nothing.
    ///
    /// # Errors
    /// [`OutlineError`] when the picture does not tell.
    pub fn find(&mut self, view: &View<'_>, ball: &MirrorBall, reflectance: Vec3) -> Result<OutlineFit, OutlineError> {
        let found = self.search(view, ball, reflectance)?;
        Ok(report(view, &found))
    }

    /// Finds the cone of rays that touch `ball`, predicted where it is known to be, in a picture: for those who want its
    /// half-angle too.
    ///
    /// # Errors
    /// [`OutlineError`] when the picture does not tell.
    pub fn sight(
        &mut self,
        view: &View<'_>,
        ball: &MirrorBall,
        reflectance: Vec3,
    ) -> Result<ConeSighting, OutlineError> {
        let Found {
            fit,
            px_per_rad,
            n_profiles,
            ..
        } = self.search(view, ball, reflectance)?;
        Ok(ConeSighting {
            axis: fit.axis,
            half_angle_rad: fit.half_angle,
            basis: fit.basis,
            covariance_rad2: fit.joint_covariance_px2 * (1.0 / (px_per_rad * px_per_rad)),
            px_per_rad,
            misfit: fit.misfit,
            n_used: fit.n_used,
            n_profiles,
        })
    }

    /// The search itself.
    fn search(&mut self, view: &View<'_>, ball: &MirrorBall, reflectance: Vec3) -> Result<Found, OutlineError> {
        const MIN_RADIUS_PX: f64 = 6.0;
        const MAX_SEARCH_PX: f64 = 12.0;
        let center = view.camera_from_world.transform_point(ball.center_m);
        let distance_m = center.length();
        let nowhere = OutlineError::OutOfPicture { share: 0.0 };
        let cone = Cone::around(center, ball.radius_m).ok_or(nowhere)?;
        let px_per_rad = cone.px_per_rad(&view.camera.intrinsics).ok_or(nowhere)?;
        let radius_px = cone.half_angle * px_per_rad;
        if radius_px < MIN_RADIUS_PX {
            return Err(OutlineError::TooSmall { radius_px });
        }
        let search_px = (self.settings.search_m / distance_m * px_per_rad)
            .min(0.25 * radius_px)
            .min(MAX_SEARCH_PX);
        let reach = Reach {
            radius_px,
            search_px,
            reflectance,
            blur_px: self.settings.blur_px,
            window_px: self.settings.window_px,
        };
        self.profiles.read(view, &cone, reach);
        let (n_profiles, n_with_edge) = (self.profiles.len(), self.profiles.n_with_edge());
        let in_picture = self.profiles.share_in_picture();
        if in_picture < MIN_IN_PICTURE {
            return Err(OutlineError::OutOfPicture { share: in_picture });
        }
        let share = n_with_edge as f64 / n_profiles as f64;
        if share < MIN_WITH_EDGE {
            return Err(OutlineError::LowContrast { share });
        }
        let fit = cone::fit(&cone, &self.profiles, reach, self.settings.size_sigma * radius_px);
        let share = fit.n_used as f64 / n_profiles as f64;
        let sigma_px = fit.sigma_px();
        if share < MIN_AGREEING || sigma_px > MAX_SIGMA_PX {
            return Err(OutlineError::Covered { share, sigma_px });
        }
        Ok(Found {
            center,
            fit,
            px_per_rad,
            n_profiles,
        })
    }
}

/// What a search has found.
struct Found {
    /// The ball's predicted centre, camera frame, metres.
    center: DVec3,
    fit: ConeFit,
    px_per_rad: f64,
    n_profiles: usize,
}

fn report(view: &View<'_>, found: &Found) -> OutlineFit {
    let Found {
        center,
        fit,
        px_per_rad,
        n_profiles,
    } = *found;
    let distance_m = center.length();
    let moved = fit.axis * distance_m;
    let shift_m = view.camera_from_world.inverse().transform_vector(moved - center);
    let intrinsics = &view.camera.intrinsics;
    let shift_px = intrinsics
        .project(moved)
        .zip(intrinsics.project(center))
        .map_or(DVec2::ZERO, |(to, from)| to - from);
    let m_per_px = distance_m / px_per_rad;
    OutlineFit {
        center_m: view.camera_from_world.inverse().transform_point(moved),
        shift_m,
        sigma_m: fit.sigma_px() * m_per_px,
        shift_px,
        sigma_px: fit.sigma_px(),
        deviation_squared: fit.deviation_squared,
        growth_px: fit.growth_px,
        n_used: fit.n_used,
        n_profiles,
    }
}
