//! The cone of rays that touch the ball, fitted to the evidence of all profiles.

use glam::{DMat2, DMat3, DVec2, DVec3};

use super::evidence::{Profile, Profiles, Reach};
use crate::camera::Intrinsics;

/// Distance of neighbouring shifts that are tried, pixels.
const TRIAL_STEP_PX: f64 = 0.5;
/// Profiles that are asked about every trial, at most.
const MAX_TRIAL_PROFILES: usize = 100;
/// Iterations of the fit.
const ITERATIONS: usize = 30;
/// Half the distance over which derivatives of the costs are taken, pixels: half the step that they are known at.
const NUDGE_PX: f64 = 0.125;
/// Independent samples per profile: ten of three channels, half a pixel apart where a pixel is, channels alike. A cost, which
/// is the logarithm of a variance, times half of it is the logarithm of a likelihood.
const SAMPLES: f64 = 6.0;
/// Standard deviation of what all profiles of a picture have in common, pixels: what a ball's surroundings show inside its
/// outline. Measured on path-traced pictures of exactly known balls, where the fit scatters by this much.
const COMMON_SIGMA_PX: f64 = 0.08;
/// Standard deviation of the half-angle from blur, pixels.
const BLUR_SIGMA_PX: f64 = 0.1;

/// A cone of rays around an axis, in the camera frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cone {
    /// Unit ray to the ball's centre.
    pub(super) axis: DVec3,
    /// Angle between the axis and rays that touch the ball, radians.
    pub(super) half_angle: f64,
    /// Two unit vectors across the axis.
    pub(super) basis: [DVec3; 2],
}

impl Cone {
    /// The cone around a ball; `None` from inside it.
    pub(super) fn around(center: DVec3, radius_m: f64) -> Option<Self> {
        let distance_m = center.length();
        (distance_m > radius_m).then(|| {
            let axis = center / distance_m;
            let right = axis.any_orthonormal_vector();
            Self {
                axis,
                half_angle: (radius_m / distance_m).asin(),
                basis: [right, axis.cross(right)],
            }
        })
    }

    /// The ray at an angle to the axis, towards `outwards` (unit) of the basis.
    pub(super) fn ray(&self, outwards: DVec2, angle: f64) -> DVec3 {
        let sideways = self.basis[0] * outwards.x + self.basis[1] * outwards.y;
        self.axis * angle.cos() + sideways * angle.sin()
    }

    /// Pixels per radian around the axis, the mean over directions; `None` where the lens images nothing.
    pub(super) fn px_per_rad(&self, intrinsics: &Intrinsics) -> Option<f64> {
        let gradient = intrinsics.project_with_gradient(self.axis)?.gradient;
        let column = |across: DVec3| DVec2::new(gradient[0].dot(across), gradient[1].dot(across));
        let area = column(self.basis[0]).perp_dot(column(self.basis[1])).abs();
        Some(area.sqrt())
    }

    /// Angle of a ray to the axis, radians, and where around it, unit in the basis.
    fn polar(&self, ray: DVec3) -> (f64, DVec2) {
        let across = DVec2::new(ray.dot(self.basis[0]), ray.dot(self.basis[1]));
        let outwards = across.try_normalize().unwrap_or(DVec2::X);
        (across.length().atan2(ray.dot(self.axis)), outwards)
    }

    /// The cone with its axis turned towards `step` (radians, in the basis) and its half-angle changed.
    fn moved(&self, step: DVec3) -> Self {
        let axis = (self.axis + self.basis[0] * step.x + self.basis[1] * step.y).normalize();
        let right = self.basis[0].reject_from_normalized(axis).normalize();
        Self {
            axis,
            half_angle: self.half_angle + step.z,
            basis: [right, axis.cross(right)],
        }
    }
}

/// A cone that fits, and how well it is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConeFit {
    pub(super) axis: DVec3,
    pub(super) half_angle: f64,
    /// Two unit vectors across the axis.
    pub(super) basis: [DVec3; 2],
    /// Covariance of the axis in the basis, pixels².
    covariance_px2: DMat2,
    /// Covariance of axis and half-angle, pixels²: what all profiles of a picture have in common, but for blur, included.
    pub(super) joint_covariance_px2: DMat3,
    /// Squared shift of the axis in standard deviations.
    pub(super) deviation_squared: f64,
    pub(super) growth_px: f64,
    /// Mean logarithm, over the profiles that agree, of what the edge of a mirror leaves unexplained.
    pub(super) misfit: f64,
    pub(super) n_used: usize,
}

impl ConeFit {
    /// Standard deviation in the least certain direction, pixels.
    pub(super) fn sigma_px(&self) -> f64 {
        let DMat2 { x_axis: x, y_axis: y } = self.covariance_px2;
        let half_difference = 0.5 * (x.x - y.y);
        (0.5 * (x.x + y.y) + half_difference.hypot(x.y)).sqrt()
    }
}

/// Fits a cone to the evidence; `size_sigma_px` is the standard deviation of the outline's radius as predicted.
///
/// Levenberg and Marquardt's damping of Newton's method on the sum of costs.
pub(super) fn fit(predicted: &Cone, profiles: &Profiles, reach: Reach, size_sigma_px: f64) -> ConeFit {
    let problem = Problem {
        predicted,
        profiles,
        px_per_rad: reach.radius_px / predicted.half_angle,
        prior: 1.0 / size_sigma_px.hypot(BLUR_SIGMA_PX).powi(2),
    };
    let start_px = most_agreed_shift(profiles, reach);
    let mut cone = predicted.moved((start_px / problem.px_per_rad).extend(0.0));
    let mut sums = problem.sums(&cone);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let diagonal = DMat3::from_diagonal(DVec3::splat(damping * sums.curvature_scale()));
        let step_px = -((sums.curvature + diagonal).inverse() * sums.gradient);
        let next = cone.moved(step_px.clamp_length_max(1.0) / problem.px_per_rad);
        let there = problem.sums(&next);
        if step_px.is_finite() && there.cost < sums.cost {
            let is_done = sums.cost - there.cost < 1e-7 * sums.cost.abs();
            (cone, sums, damping) = (next, there, 0.3 * damping);
            if is_done {
                break;
            }
        } else if damping > 1e6 {
            break;
        } else {
            damping *= 10.0;
        }
    }
    problem.report(&cone, &sums)
}

/// What is fitted.
struct Problem<'a> {
    predicted: &'a Cone,
    profiles: &'a Profiles,
    px_per_rad: f64,
    /// Inverse variance of the half-angle, 1/pixels².
    prior: f64,
}

/// Minus the logarithm of the likelihood with its derivatives by axis (2) and half-angle, in pixels.
#[derive(Debug, Clone, Copy)]
struct Sums {
    cost: f64,
    gradient: DVec3,
    curvature: DMat3,
    /// The same of the profiles whose cost is hollow there.
    hollows: DMat3,
    n_agreeing: usize,
    misfit: f64,
}

impl Sums {
    fn curvature_scale(&self) -> f64 {
        let DMat3 { x_axis, y_axis, z_axis } = self.curvature;
        (x_axis.x.abs() + y_axis.y.abs() + z_axis.z.abs()) / 3.0
    }
}

impl Problem<'_> {
    fn sums(&self, cone: &Cone) -> Sums {
        let growth_px = (cone.half_angle - self.predicted.half_angle) * self.px_per_rad;
        let mut sums = Sums {
            cost: 0.5 * self.prior * growth_px * growth_px,
            gradient: DVec3::Z * (self.prior * growth_px),
            curvature: DMat3::from_diagonal(DVec3::Z * self.prior),
            hollows: DMat3::from_diagonal(DVec3::Z * self.prior),
            n_agreeing: 0,
            misfit: 0.0,
        };
        for (profile, costs) in self.profiles.iter() {
            let (offset_px, row) = self.crossing(cone, profile);
            let [before, here, after] =
                [-NUDGE_PX, 0.0, NUDGE_PX].map(|nudge| 0.5 * SAMPLES * costs.at(offset_px + nudge));
            sums.cost += here;
            sums.gradient += row * ((after - before) / (2.0 * NUDGE_PX));
            let bend = (after - 2.0 * here + before) / (NUDGE_PX * NUDGE_PX);
            let square = DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            sums.curvature += square * bend;
            sums.hollows += square * bend.max(0.0);
            if costs.agrees(profile, offset_px) {
                sums.n_agreeing += 1;
                sums.misfit += costs.misfit_at(offset_px);
            }
        }
        sums
    }

    /// Where a cone's outline crosses a profile, pixels outside the predicted one, and how that moves with the cone.
    fn crossing(&self, cone: &Cone, profile: &Profile) -> (f64, DVec3) {
        let (angle, outwards) = cone.polar(profile.ray);
        let slant = outwards.dot(profile.outwards).max(0.5);
        let scale = profile.px_per_rad / slant;
        (
            scale * (cone.half_angle - angle),
            outwards.extend(1.0) * (scale / self.px_per_rad),
        )
    }

    fn report(&self, cone: &Cone, sums: &Sums) -> ConeFit {
        let across = |curvature: DMat3| {
            let covariance = curvature.inverse();
            DMat2::from_cols(covariance.x_axis.truncate(), covariance.y_axis.truncate())
        };
        let is_definite = |m: &DMat2| m.is_finite() && m.x_axis.x > 0.0 && m.determinant() > 0.0;
        // Where ranges of evidence end, the curvature of the sum can be that of a saddle: then only hollows count.
        let across = Some(across(sums.curvature))
            .filter(is_definite)
            .unwrap_or_else(|| across(sums.hollows));
        let is_minimum = is_definite(&across);
        let covariance_px2 = if is_minimum {
            across + DMat2::from_diagonal(DVec2::splat(COMMON_SIGMA_PX * COMMON_SIGMA_PX))
        } else {
            DMat2::from_diagonal(DVec2::splat(1e6))
        };
        let joint = [sums.curvature, sums.hollows].map(|curvature| curvature.inverse());
        let joint = joint.into_iter().find(is_positive);
        let joint_covariance_px2 = joint
            .filter(|_| is_minimum)
            .map_or(DMat3::from_diagonal(DVec3::splat(1e6)), |covariance| {
                covariance + DMat3::from_diagonal(DVec3::splat(COMMON_SIGMA_PX * COMMON_SIGMA_PX))
            });
        let (angle, outwards) = self.predicted.polar(cone.axis);
        let shift_px = outwards * angle * self.px_per_rad;
        ConeFit {
            axis: cone.axis,
            half_angle: cone.half_angle,
            basis: cone.basis,
            covariance_px2,
            joint_covariance_px2,
            deviation_squared: shift_px.dot(covariance_px2.inverse() * shift_px),
            growth_px: (cone.half_angle - self.predicted.half_angle) * self.px_per_rad,
            misfit: sums.misfit / sums.n_agreeing as f64,
            n_used: sums.n_agreeing,
        }
    }
}

/// Whether a symmetric matrix is positive definite: its leading minors are (Sylvester).
fn is_positive(m: &DMat3) -> bool {
    let minor = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    m.is_finite() && m.x_axis.x > 0.0 && minor > 0.0 && m.determinant() > 0.0
}

/// The shift, in pixels in the predicted cone's basis, whose outline has the most evidence.
///
/// A circle's edge shifted by d meets a profile towards n at `d·n - (d×n)² / 2r`, to second order.
fn most_agreed_shift(profiles: &Profiles, reach: Reach) -> DVec2 {
    let n = (reach.search_px / TRIAL_STEP_PX).floor() as i32;
    let stride = profiles.len().div_ceil(MAX_TRIAL_PROFILES).max(1);
    let mut best = (f64::INFINITY, DVec2::ZERO);
    for i in 0..(2 * n + 1) * (2 * n + 1) {
        let shift = DVec2::new(f64::from(i % (2 * n + 1) - n), f64::from(i / (2 * n + 1) - n)) * TRIAL_STEP_PX;
        if shift.length() > reach.search_px {
            continue;
        }
        let cost = profiles
            .iter()
            .step_by(stride)
            .map(|(profile, costs)| {
                let sideways = profile.outwards.perp_dot(shift);
                costs.at(profile.outwards.dot(shift) - 0.5 * sideways * sideways / reach.radius_px)
            })
            .sum();
        if cost < best.0 {
            best = (cost, shift);
        }
    }
    best.1
}
