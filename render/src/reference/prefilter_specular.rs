//! The GGX lobe integrated over every texel.

use std::f64::consts::PI;

use glam::Vec3;

use super::lobe_sum::Texels;

/// Mean of an environment under the GGX lobe of `alpha` around `direction`, for normal = view = `direction`.
///
/// The weight of light from l is D(h) cos θ_l with h half way between l and the direction (Karis 2013, "Real shading in
/// Unreal Engine 4": importance-sampled by D(h) cos θ_h, whose density in l is D(h) / 4, and weighted by cos θ_l).
#[must_use]
pub fn radiance(environment: &Texels, alpha: f32, direction: Vec3) -> Vec3 {
    environment.mean(direction, |cosine| {
        if cosine <= 0.0 {
            return 0.0;
        }
        distribution((0.5 + 0.5 * cosine).sqrt(), f64::from(alpha)) * cosine
    })
}

/// GGX normal distribution (Walter et al. 2007, eq. 33, for the tangent written as a cosine).
fn distribution(cos_half: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    a2 / (PI * d * d)
}
