//! A cube turned about x, y and z in turn.

use std::f32::consts::PI;

use glam::{Quat, Vec3};

use crate::passes::cylindrical::{STEPS, SWEEP_RAD};
use mirrorball_calib::probe::cube::Cube;

/// Irradiance for every normal as the filter has it: π times the filtered radiance.
#[must_use]
pub fn irradiance(radiance: &Cube<Vec3>) -> Cube<Vec3> {
    let mut filtered = radiance.clone();
    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
        filtered = about(&filtered, axis);
    }
    filtered.map(|texel| PI * *texel)
}

/// Mean over little turns about `axis`.
fn about(source: &Cube<Vec3>, axis: Vec3) -> Cube<Vec3> {
    let mut out = source.clone();
    for index in 0..source.texels().len() {
        let direction = source.direction(index);
        let sum: Vec3 = (0..STEPS)
            .map(|step| {
                let angle_rad = SWEEP_RAD * ((step as f32 + 0.5) / STEPS as f32 - 0.5);
                source.bilinear(Quat::from_axis_angle(axis, angle_rad) * direction)
            })
            .sum();
        out.texels_mut()[index] = sum / STEPS as f32;
    }
    out
}
