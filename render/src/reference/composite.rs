//! One pixel of the finished picture, from the camera model's own functions.

use glam::{DVec2, DVec3, Vec3, Vec4};
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::Exposure;

/// The code of a pixel whose light is dimmed by `ratio`, with radiance `added`, and partly hidden by a virtual object: `over` is that object's
/// radiance times its coverage, then the coverage.
///
/// Nothing over it, a ratio of 1 and nothing added give the camera's own `code`.
#[must_use]
pub fn pixel(camera: &PixelOf<'_>, code: [u8; 3], [ratio, added]: [Vec3; 2], over: Vec4) -> [u8; 3] {
    if over.w <= 0.0 && ratio == Vec3::ONE && added == Vec3::ZERO {
        return code;
    }
    let photometry = &camera.camera.photometry;
    let vignetting = photometry.vignetting_at(camera.pixel, camera.camera.intrinsics.size_px);
    let signal = DVec3::from_array(photometry.signal_per_radiance(camera.exposure)) * vignetting;
    let linear = DVec3::from_array(code.map(|c| photometry.response.linear_from_code(c)));
    let real = photometry.color * (linear / signal);
    let mixed = (real * ratio.as_dvec3() + added.as_dvec3()) * (1.0 - f64::from(over.w)) + over.truncate().as_dvec3();
    let encoded = photometry.color.inverse() * mixed * signal;
    encoded.to_array().map(|y| photometry.response.encode(y))
}

/// A pixel of a camera at an exposure.
#[derive(Debug, Clone, Copy)]
pub struct PixelOf<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The exposure in force.
    pub exposure: &'a Exposure,
    /// Column and row.
    pub pixel: DVec2,
}
