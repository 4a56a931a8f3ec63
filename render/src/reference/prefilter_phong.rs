//! The Phong lobe integrated over every texel.

use glam::Vec3;

use super::lobe_sum::Texels;

/// Mean of an environment under the lobe cosⁿ θ around `direction`, the normalised lobe of Phong 1975 around the
/// reflected ray.
#[must_use]
pub fn radiance(environment: &Texels, exponent: f32, direction: Vec3) -> Vec3 {
    environment.mean(direction, |cosine| cosine.max(0.0).powf(f64::from(exponent)))
}
