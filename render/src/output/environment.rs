//! Radiance cubes as equirectangular OpenEXR pictures.

use std::path::Path;

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::equirectangular::{HEIGHT, WIDTH, equirectangular};

use crate::error::RenderError;

/// Writes a cube as `file`.
///
/// # Errors
/// [`RenderError::Write`] when the file cannot be written.
pub fn write_exr(file: &Path, radiance: &Cube<Vec3>) -> Result<(), RenderError> {
    let pixels = equirectangular(radiance);
    let pixel = |x: usize, y: usize| <(f32, f32, f32)>::from(pixels[y * WIDTH + x]);
    exr::prelude::write_rgb_file(file, WIDTH, HEIGHT, pixel).map_err(|error| RenderError::Write {
        file: file.to_owned(),
        source: Box::new(error),
    })
}
