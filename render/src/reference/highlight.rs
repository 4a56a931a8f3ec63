//! What of the light is brighter than a multiple of its mean.

use glam::Vec3;

use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;

/// Every texel with what its luminance has above `threshold` means; its colour stays.
#[must_use]
pub fn darkened(radiance: &Cube<Vec3>, threshold: f32) -> Cube<Vec3> {
    let areas = (0..radiance.texels().len()).map(|index| radiance.solid_angle(index));
    let sum: Vec3 = radiance.texels().iter().zip(areas).map(|(t, sr)| *t * sr).sum();
    let dark = threshold * luminance(sum) / (4.0 * std::f32::consts::PI);
    radiance.map(|texel| {
        let bright = luminance(*texel);
        if bright > dark {
            *texel * ((bright - dark) / bright)
        } else {
            Vec3::ZERO
        }
    })
}
