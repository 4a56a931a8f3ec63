//! One pixel of the real things' radiance, from the camera model's own functions.

use glam::{DVec3, Vec3};

use super::composite::PixelOf;

/// Radiance in the rig's common RGB of a pixel with `code`, times `ratio`, with the radiance `added`.
#[must_use]
pub fn pixel(camera: &PixelOf<'_>, code: [u8; 3], [ratio, added]: [Vec3; 2]) -> Vec3 {
    let photometry = &camera.camera.photometry;
    let vignetting = photometry.vignetting_at(camera.pixel, camera.camera.intrinsics.size_px);
    let signal = DVec3::from_array(photometry.signal_per_radiance(camera.exposure)) * vignetting;
    let linear = DVec3::from_array(code.map(|c| photometry.response.linear_from_code(c)));
    (photometry.color * (linear / signal)).as_vec3() * ratio + added
}
