//! A given environment map in place of the measured light, to tell errors of the light from those of the shadows.

use std::path::Path;

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::equirectangular::pixel_of;

use crate::error::RenderError;

/// Places per edge of a cube's texel at which the map is read.
const PLACES: u32 = 4;

/// Reads an equirectangular OpenEXR map (row 0 at world +z, centre column at +y, right at +x; width twice the height) as a
/// cube of `size` × `size` texels a face, in linear radiance.
///
/// # Errors
/// [`RenderError::Read`] for a file that cannot be opened, [`RenderError::EnvironmentIn`] for one that is no such map or
/// holds values below zero or not finite.
pub fn read_exr(file: &Path, size: u32) -> Result<Cube<Vec3>, RenderError> {
    let wrong = |message: String| RenderError::EnvironmentIn {
        file: file.to_owned(),
        message,
    };
    std::fs::File::open(file).map_err(|source| RenderError::Read {
        file: file.to_owned(),
        source,
    })?;
    let (pixels, width) = read_rgb(file).map_err(|error| wrong(error.to_string()))?;
    let height = pixels.len() / width.max(1);
    if width == 0 || width != 2 * height {
        return Err(wrong(format!(
            "it has {width} × {height} pixels; a map of all directions is twice as wide as high"
        )));
    }
    if let Some(at) = pixels.iter().position(|p| !p.is_finite() || p.min_element() < 0.0) {
        let (column, row, value) = (at % width, at / width, pixels[at]);
        return Err(wrong(format!(
            "pixel ({column}, {row}) is {value}; radiance is finite and not below zero"
        )));
    }
    let read = |direction: Vec3| {
        let [i, j] = pixel_of(direction, [width, height]);
        pixels[j * width + i]
    };
    let fine = size * PLACES;
    let mut cube = Cube::filled(size, Vec3::ZERO);
    let mut weights = Cube::filled(size, 0.0f32);
    let fine_cube = Cube::filled(fine, ());
    for index in 0..fine_cube.texels().len() {
        let direction = fine_cube.direction(index);
        let (at, weight) = (cube.index_of(direction), fine_cube.solid_angle(index));
        cube.texels_mut()[at] += weight * read(direction);
        weights.texels_mut()[at] += weight;
    }
    for (texel, &weight) in cube.texels_mut().iter_mut().zip(weights.texels()) {
        *texel /= weight.max(f32::MIN_POSITIVE);
    }
    Ok(cube)
}

/// Pixels row after row, and their number in a row.
fn read_rgb(file: &Path) -> Result<(Vec<Vec3>, usize), exr::error::Error> {
    use exr::prelude::*;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size: Vec2<usize>, _: &RgbChannels| (vec![Vec3::ZERO; size.area()], size.width()),
            |(pixels, width), at: Vec2<usize>, (r, g, b): (f32, f32, f32)| {
                pixels[at.y() * *width + at.x()] = Vec3::new(r, g, b);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(file)?;
    Ok(image.layer_data.channel_data.pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::environment::write_exr;

    fn lamp_over_grey() -> Cube<Vec3> {
        let mut cube = Cube::filled(64, Vec3::splat(0.5));
        let lamp = cube.index_of(Vec3::new(0.3, -0.5, 0.8));
        cube.texels_mut()[lamp] = Vec3::new(900.0, 800.0, 700.0);
        cube
    }

    fn power(cube: &Cube<Vec3>) -> Vec3 {
        let texel = |i: usize| cube.texels()[i] * cube.solid_angle(i);
        (0..cube.texels().len()).map(texel).sum()
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("map.exr");
        let cube = lamp_over_grey();
        write_exr(&file, &cube).unwrap();
        let back = read_exr(&file, 64).unwrap();
        assert!((power(&back) / power(&cube) - 1.0).abs().max_element() < 0.02);
        let brightest =
            |c: &Cube<Vec3>| (0..c.texels().len()).max_by(|&a, &b| c.texels()[a].x.total_cmp(&c.texels()[b].x));
        let (at, expected) = (brightest(&back).unwrap(), brightest(&cube).unwrap());
        assert!(back.direction(at).dot(cube.direction(expected)) > 0.999);
    }

    #[test]
    fn what_is_no_map_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("map.exr");
        assert!(matches!(read_exr(&file, 32), Err(RenderError::Read { .. })));
        std::fs::write(&file, b"no picture").unwrap();
        assert!(matches!(read_exr(&file, 32), Err(RenderError::EnvironmentIn { .. })));
        exr::prelude::write_rgb_file(&file, 8, 8, |_, _| (0.0f32, 0.0f32, 0.0f32)).unwrap();
        assert!(read_exr(&file, 32).unwrap_err().to_string().contains("8 × 8"));
        exr::prelude::write_rgb_file(&file, 8, 4, |x, y| {
            if (x, y) == (3, 2) {
                (1.0f32, f32::NAN, 1.0f32)
            } else {
                (1.0, 1.0, 1.0)
            }
        })
        .unwrap();
        assert!(read_exr(&file, 32).unwrap_err().to_string().contains("pixel (3, 2)"));
    }
}
