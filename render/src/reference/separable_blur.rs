//! Each face blurred as a picture of its own.

use std::f32::consts::PI;

use glam::Vec3;

use crate::passes::separable_blur::ITERATIONS;
use mirrorball_calib::probe::cube::{Cube, FACES};

/// Irradiance for every normal as the blur has it: π times the blurred radiance.
#[must_use]
pub fn irradiance(radiance: &Cube<Vec3>) -> Cube<Vec3> {
    let mut blurred = radiance.clone();
    for _ in 0..ITERATIONS {
        blurred = along(&blurred, [1, 0]);
        blurred = along(&blurred, [0, 1]);
    }
    blurred.map(|texel| PI * *texel)
}

/// Mean of four bilinear taps at -1.5, -0.5, 0.5 and 1.5 texels along a row or a column; the face's edge repeats.
fn along(source: &Cube<Vec3>, step: [i32; 2]) -> Cube<Vec3> {
    let size = source.size() as i32;
    let mut out = source.clone();
    for index in 0..FACES as i32 * size * size {
        let (face, y, x) = (index / (size * size), index / size % size, index % size);
        let texel = |i: i32| {
            let at = |t: i32, s: i32| (t + i * s).clamp(0, size - 1);
            source.texels()[((face * size + at(y, step[1])) * size + at(x, step[0])) as usize]
        };
        let taps = [-2, -1, 0, 1].map(|i| 0.5 * (texel(i) + texel(i + 1)));
        out.texels_mut()[index as usize] = 0.25 * taps.iter().sum::<Vec3>();
    }
    out
}
