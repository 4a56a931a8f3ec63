//! The GGX lobe integrated over every texel: no sampling, no mips.

use std::f64::consts::PI;

use glam::Vec3;

use mirrorball_calib::probe::cube::Cube;

/// Mean of `environment` under the GGX lobe of `alpha` around `direction`, for normal = view = `direction`.
///
/// The weight of light from l is D(h) cos θ_l with h half way between l and the direction (Karis 2013, "Real shading in
/// Unreal Engine 4": importance-sampled by D(h) cos θ_h, whose density in l is D(h) / 4, and weighted by cos θ_l).
#[must_use]
pub fn radiance(environment: &Cube<Vec3>, alpha: f32, direction: Vec3) -> Vec3 {
    let normal = direction.as_dvec3().normalize();
    let (mut sum, mut weights) = (glam::DVec3::ZERO, 0.0);
    for (index, texel) in environment.texels().iter().enumerate() {
        let light = environment.direction(index).as_dvec3();
        let cos_light = normal.dot(light);
        if cos_light > 0.0 {
            let cos_half = normal.dot((normal + light).normalize());
            let weight =
                distribution(cos_half, f64::from(alpha)) * cos_light * f64::from(environment.solid_angle(index));
            sum += weight * texel.as_dvec3();
            weights += weight;
        }
    }
    (sum / weights).as_vec3()
}

/// GGX normal distribution (Walter et al. 2007, eq. 33, for the tangent written as a cosine).
fn distribution(cos_half: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    a2 / (PI * d * d)
}
