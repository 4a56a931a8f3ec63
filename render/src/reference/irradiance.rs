//! Light from near things as harmonics: the whole projection over a cube whose far texels are black.

use glam::Vec3;

use crate::probe::surroundings::NOTHING_M;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::sh::IrradianceSh;

/// Harmonics of the texels of `environment` that show a phantom; `hit_m` is the distance to it, metres,
/// [`NOTHING_M`] where there is none.
#[must_use]
pub fn near_light(environment: &Cube<Vec3>, hit_m: &Cube<f32>) -> IrradianceSh {
    let mut near = environment.clone();
    for (radiance, hit_m) in near.texels_mut().iter_mut().zip(hit_m.texels()) {
        if *hit_m >= NOTHING_M {
            *radiance = Vec3::ZERO;
        }
    }
    IrradianceSh::from_cube(&near)
}
