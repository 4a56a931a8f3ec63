//! Lobes integrated over every texel of a cube: no tree, no lists.

use glam::{DVec3, Vec3};

use mirrorball_calib::probe::cube::Cube;

/// A cube as a list of little lights.
#[derive(Debug, Clone, PartialEq)]
pub struct Texels {
    /// Direction, solid angle in steradians, radiance.
    texels: Vec<(DVec3, f64, DVec3)>,
}

impl Texels {
    /// The texels of a cube, each in the direction of its centre.
    #[must_use]
    pub fn new(radiance: &Cube<Vec3>) -> Self {
        let texel = |(index, texel): (usize, &Vec3)| {
            let area_sr = f64::from(radiance.solid_angle(index));
            (radiance.direction(index).as_dvec3(), area_sr, texel.as_dvec3())
        };
        Self {
            texels: radiance.texels().iter().enumerate().map(texel).collect(),
        }
    }

    /// Mean of the radiance, each texel weighted by its solid angle and `weight` of its cosine to `direction`.
    #[must_use]
    pub fn mean(&self, direction: Vec3, weight: impl Fn(f64) -> f64) -> Vec3 {
        let (sum, weights) = self.sums(direction, weight);
        (sum / weights).as_vec3()
    }

    /// Sum of the radiance times solid angle and `weight`, and of the weights.
    pub(super) fn sums(&self, direction: Vec3, weight: impl Fn(f64) -> f64) -> (DVec3, f64) {
        let direction = direction.as_dvec3().normalize();
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for (light, area_sr, radiance) in &self.texels {
            let weight = weight(direction.dot(*light)) * area_sr;
            sum += weight * *radiance;
            weights += weight;
        }
        (sum, weights)
    }
}
