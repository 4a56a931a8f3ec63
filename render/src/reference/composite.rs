//! One pixel of the finished picture, from the camera model's own functions.

use glam::{DVec2, DVec3, Vec3, Vec4};
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::Exposure;

/// The code of a pixel whose light is dimmed by `ratio`, with radiance `added`, and partly hidden by a virtual object: `over`
/// is that object's radiance times its coverage, then the coverage. Without noise of its own; that is [`noise`](super::noise).
///
/// Nothing over it, a ratio of 1 and nothing added give the camera's own `code`.
#[must_use]
pub fn pixel(of: &PixelOf<'_>, code: [u8; 3], [ratio, added]: [Vec3; 2], over: Vec4) -> [u8; 3] {
    if over.w <= 0.0 && ratio == Vec3::ONE && added == Vec3::ZERO {
        return code;
    }
    let encoded = mixed_signal(of, code, [ratio, added], over);
    encoded.to_array().map(|y| of.camera.photometry.response.encode(y))
}

/// The linear signal of that pixel, red, green, blue, not clipped.
#[must_use]
pub fn mixed_signal(of: &PixelOf<'_>, code: [u8; 3], [ratio, added]: [Vec3; 2], over: Vec4) -> DVec3 {
    let photometry = &of.camera.photometry;
    let signal = of.signal_per_radiance();
    let linear = DVec3::from_array(code.map(|c| photometry.response.linear_from_code(c)));
    let real = photometry.color * (linear / signal);
    let mixed = (real * ratio.as_dvec3() + added.as_dvec3()) * (1.0 - f64::from(over.w)) + over.truncate().as_dvec3();
    photometry.color.inverse() * mixed * signal
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

impl PixelOf<'_> {
    /// Signal of red, green and blue per unit of radiance in the camera's own primaries.
    #[must_use]
    pub fn signal_per_radiance(&self) -> DVec3 {
        let photometry = &self.camera.photometry;
        let vignetting = photometry.vignetting_at(self.pixel, self.camera.intrinsics.size_px);
        DVec3::from_array(photometry.signal_per_radiance(self.exposure)) * vignetting
    }
}
