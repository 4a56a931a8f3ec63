//! Equirectangular environment maps and the sphere they cover.

use crate::ToolError;
use glam::Vec3;
use std::{f64::consts::PI, fs::File, io::BufReader, path::Path};

/// Width of an environment map in texels.
pub const WIDTH: usize = 512;
/// Height of an environment map in texels.
pub const HEIGHT: usize = 256;

/// Radiance that arrives at a point, by direction: linear RGB, row 0 at world +z, centre column at +y, right at +x.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    /// Radiance row by row from the top, [`WIDTH`] texels each.
    pub radiance: Vec<[f32; 3]>,
}

impl EnvironmentMap {
    /// Reads an OpenEXR file: first layer with channels R, G, B, half or float, any compression.
    ///
    /// # Errors
    /// When the file is missing, is not such a map, has another size, or holds a value that is not finite.
    pub fn load(path: &Path) -> Result<Self, ToolError> {
        let file = File::open(path).map_err(|source| ToolError::Unreadable {
            path: path.to_owned(),
            role: "an environment map".to_owned(),
            source,
        })?;
        let (found_px, radiance) = read_rgb(BufReader::new(file)).map_err(|source| ToolError::Exr {
            path: path.to_owned(),
            source,
        })?;
        if found_px != [WIDTH, HEIGHT] {
            return Err(ToolError::Size {
                path: path.to_owned(),
                role: "an environment map".to_owned(),
                found_px,
                expected_px: [WIDTH, HEIGHT],
            });
        }
        for (index, texel) in radiance.iter().enumerate() {
            if let Some(&value) = texel.iter().find(|value| !value.is_finite()) {
                return Err(ToolError::NotFinite {
                    path: path.to_owned(),
                    value,
                    column: index % WIDTH,
                    row: index / WIDTH,
                });
            }
        }
        Ok(Self { radiance })
    }

    /// Makes a map from the radiance in each direction.
    pub fn from_fn(sphere: &Sphere, radiance: impl FnMut(Vec3) -> [f32; 3]) -> Self {
        Self {
            radiance: sphere.directions.iter().copied().map(radiance).collect(),
        }
    }
}

/// Decodes width, height and RGB texels; a map without texels has size 0.
fn read_rgb(file: BufReader<File>) -> Result<([usize; 2], Vec<[f32; 3]>), exr::error::Error> {
    use exr::prelude::*;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size: Vec2<usize>, _: &RgbChannels| (size.width(), vec![[0.0; 3]; size.area()]),
            |(width, texels), at: Vec2<usize>, (r, g, b): (f32, f32, f32)| texels[at.y() * *width + at.x()] = [r, g, b],
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(file)?;
    let size = image.layer_data.size;
    Ok(([size.width(), size.height()], image.layer_data.channel_data.pixels.1))
}

/// Direction and solid angle of every texel of an environment map.
#[derive(Clone, Debug)]
pub struct Sphere {
    /// Unit vectors to the texels' middles, in the order of the texels.
    pub directions: Vec<Vec3>,
    /// Solid angle of one texel of each row, in steradian; all texels together make 4π.
    pub row_solid_angles: Vec<f64>,
}

impl Sphere {
    /// Lays out the sphere of a map of [`WIDTH`] by [`HEIGHT`] texels.
    #[expect(
        clippy::new_without_default,
        reason = "a table of 131072 directions is not a default value"
    )]
    pub fn new() -> Self {
        let azimuth_step = 2.0 * PI / WIDTH as f64;
        let polar_step = PI / HEIGHT as f64;
        let mut directions = Vec::with_capacity(WIDTH * HEIGHT);
        let mut row_solid_angles = Vec::with_capacity(HEIGHT);
        for row in 0..HEIGHT {
            let (top, theta) = (row as f64 * polar_step, (row as f64 + 0.5) * polar_step);
            row_solid_angles.push(azimuth_step * (top.cos() - (top + polar_step).cos()));
            for column in 0..WIDTH {
                let phi = 2.0 * PI * ((column as f64 + 0.5) / WIDTH as f64 - 0.5);
                let direction = [theta.sin() * phi.sin(), theta.sin() * phi.cos(), theta.cos()];
                directions.push(Vec3::from_array(direction.map(|coordinate| coordinate as f32)));
            }
        }
        Self {
            directions,
            row_solid_angles,
        }
    }
}

/// Returns the luminance of linear Rec. 709 radiance (ITU-R BT.709, item 3.2).
pub fn luminance(radiance: [f32; 3]) -> f64 {
    let [r, g, b] = radiance.map(f64::from);
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sphere_is_whole_and_points_as_the_format_says() {
        let sphere = Sphere::new();
        let whole: f64 = sphere.row_solid_angles.iter().sum::<f64>() * WIDTH as f64;
        assert!((whole - 4.0 * PI).abs() < 1e-9);
        let at = |column: usize, row: usize| sphere.directions[row * WIDTH + column];
        assert!(at(100, 0).dot(Vec3::Z) > 0.9999);
        assert!(at(256, 128).dot(Vec3::Y) > 0.9999);
        assert!(at(384, 128).dot(Vec3::X) > 0.9999);
    }

    #[test]
    fn half_and_float_files_are_read_in_any_compression() {
        use exr::prelude::*;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let texel = |x: usize, y: usize| [x as f32, y as f32, 0.25];
        let channels = SpecificChannels::rgb(|at: Vec2<usize>| {
            let [r, g, b] = texel(at.x(), at.y());
            (f16::from_f32(r), f16::from_f32(g), b)
        });
        for compression in [Compression::Uncompressed, Compression::ZIP16, Compression::PIZ] {
            let encoding = Encoding {
                compression,
                ..Encoding::default()
            };
            let layer = Layer::new((WIDTH, HEIGHT), LayerAttributes::default(), encoding, channels.clone());
            Image::from_layer(layer).write().to_file(&path).unwrap();
            let map = EnvironmentMap::load(&path).unwrap();
            assert_eq!(map.radiance[3 * WIDTH + 7], texel(7, 3));
            assert_eq!(map.radiance[200 * WIDTH + 511], texel(511, 200));
        }
    }

    #[test]
    fn a_map_of_wrong_size_or_with_nan_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        exr::prelude::write_rgb_file(&path, 64, 32, |_, _| (1.0_f32, 1.0, 1.0)).unwrap();
        let error = EnvironmentMap::load(&path).unwrap_err();
        assert!(matches!(error, ToolError::Size { found_px: [64, 32], .. }), "{error}");
        exr::prelude::write_rgb_file(&path, WIDTH, HEIGHT, |x, y| {
            (1.0_f32, if (x, y) == (5, 9) { f32::NAN } else { 1.0 }, 1.0)
        })
        .unwrap();
        let error = EnvironmentMap::load(&path).unwrap_err();
        assert!(
            matches!(error, ToolError::NotFinite { column: 5, row: 9, .. }),
            "{error}"
        );
    }
}
