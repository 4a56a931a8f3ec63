//! The cosine integrated over every texel.

use glam::Vec3;

use super::lobe_sum::Texels;

/// Irradiance of an environment on a surface with unit normal `normal`: ∫ L cos θ dω over the hemisphere.
#[must_use]
pub fn irradiance(environment: &Texels, normal: Vec3) -> Vec3 {
    environment.sums(normal, |cosine| cosine.max(0.0)).0.as_vec3()
}
