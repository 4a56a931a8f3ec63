//! Albedo of real things, from their radiance and irradiance.

use std::f32::consts::PI;

use glam::Vec3;

/// Nothing matt is lighter.
pub const LIGHTEST: f32 = 0.95;
/// What surfaces are taken for where the picture is too dark to tell.
pub const COMMON: f32 = 0.3;

/// Albedo of a surface that sends `radiance` in `irradiance`; `dark` is radiance that a picture of white shows as next to
/// nothing.
#[must_use]
pub fn albedo(radiance: Vec3, irradiance: Vec3, dark: Vec3) -> Vec3 {
    let dark = PI * dark;
    ((PI * radiance + COMMON * dark) / (irradiance + dark)).min(Vec3::splat(LIGHTEST))
}
