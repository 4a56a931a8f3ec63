//! One pixel of a display that shows no camera picture.

use glam::{Vec3, Vec4};

/// sRGB codes of linear light (IEC 61966-2-1).
#[must_use]
pub fn srgb(linear: Vec3) -> [u8; 3] {
    linear.to_array().map(|x| {
        let x = x.clamp(0.0, 1.0);
        let encoded = if x <= 0.003_130_8 {
            12.92 * x
        } else {
            1.055 * x.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded).round() as u8
    })
}

/// Codes of a pixel of a display that one looks through: `real` is the radiance of the real thing there, `ratio` what
/// virtual objects change of its light, and `over` the virtual object's radiance times its coverage, then the coverage.
#[must_use]
pub fn looked_through(real: Vec3, ratio: Vec3, over: Vec4, exposure: f32) -> [u8; 3] {
    let added = real * (ratio.max(Vec3::ONE) - 1.0);
    srgb(exposure * (added * (1.0 - over.w) + over.truncate()))
}
