//! The map as files.

use std::{
    error::Error,
    fs::{self, File},
    io::{BufWriter, Write},
    path::Path,
};

use glam::Vec3;
use image::{Rgb, RgbImage, codecs::hdr::HdrEncoder};
use mirrorball_calib::probe::{
    cube::Cube,
    equirectangular::{HEIGHT, WIDTH, equirectangular},
};

use super::ProbeError;

type AnyError = Box<dyn Error + Send + Sync>;

/// Writes `environment.exr`, `environment.hdr` and `environment.png` into a folder, which is made if need be.
pub(super) fn write(folder: &Path, radiance: &Cube<Vec3>, chart: &RgbImage) -> Result<(), ProbeError> {
    let at = |file: &Path, result: Result<(), AnyError>| {
        result.map_err(|source| ProbeError::Write {
            file: file.to_owned(),
            source,
        })
    };
    at(folder, fs::create_dir_all(folder).map_err(Into::into))?;
    let pixels = equirectangular(radiance);
    let file = folder.join("environment.exr");
    let pixel = |x: usize, y: usize| <(f32, f32, f32)>::from(pixels[y * WIDTH + x]);
    let exr = exr::prelude::write_rgb_file(&file, WIDTH, HEIGHT, pixel);
    at(&file, exr.map_err(Into::into))?;
    let file = folder.join("environment.hdr");
    at(&file, write_hdr(&file, &pixels))?;
    let file = folder.join("environment.png");
    at(&file, chart.save(&file).map_err(Into::into))
}

/// Radiance RGBE: a common exponent for the three channels of a pixel, which costs up to 1 % in the weaker ones.
fn write_hdr(file: &Path, pixels: &[Vec3]) -> Result<(), AnyError> {
    let rgb: Vec<Rgb<f32>> = pixels.iter().map(|pixel| Rgb(pixel.to_array())).collect();
    let mut out = BufWriter::new(File::create(file)?);
    HdrEncoder::new(&mut out).encode(&rgb, WIDTH, HEIGHT)?;
    Ok(out.flush()?)
}
