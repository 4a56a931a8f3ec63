//! Radiance cubes as equirectangular pictures.

use std::f32::consts::PI;

use glam::Vec3;

use super::cube::Cube;

/// Columns of the picture.
pub const WIDTH: usize = 512;
/// Rows of the picture.
pub const HEIGHT: usize = 256;

/// Unit direction (world) of a place in the picture; (`i`, `j`) at integers are pixel centres.
///
/// Row 0 at +z, centre column at +y, right at +x.
#[must_use]
pub fn direction(i: f32, j: f32) -> Vec3 {
    let theta = PI * (j + 0.5) / HEIGHT as f32;
    let phi = 2.0 * PI * ((i + 0.5) / WIDTH as f32 - 0.5);
    Vec3::new(theta.sin() * phi.sin(), theta.sin() * phi.cos(), theta.cos())
}

/// Column and row of the pixel that shows a direction (world, of any length above 0) in a picture of `size_px` columns and
/// rows: the inverse of [`direction`].
#[must_use]
pub fn pixel_of(direction: Vec3, size_px: [usize; 2]) -> [usize; 2] {
    let [width, height] = size_px.map(|s| s as f32);
    let unit = direction.normalize_or(Vec3::Z);
    let column = (unit.x.atan2(unit.y) / (2.0 * PI) + 0.5) * width;
    let row = unit.z.clamp(-1.0, 1.0).acos() / PI * height;
    [
        (column as usize).min(size_px[0] - 1),
        (row as usize).min(size_px[1] - 1),
    ]
}

/// The cube as an equirectangular picture, row after row; each pixel the mean of nine places in it.
#[must_use]
pub fn equirectangular(radiance: &Cube<Vec3>) -> Vec<Vec3> {
    const OFFSETS: [f32; 3] = [-1.0 / 3.0, 0.0, 1.0 / 3.0];
    let pixel = |i: usize, j: usize| {
        let mut sum = Vec3::ZERO;
        for dj in OFFSETS {
            for di in OFFSETS {
                sum += radiance.nearest(direction(i as f32 + di, j as f32 + dj));
            }
        }
        sum / 9.0
    };
    (0..HEIGHT)
        .flat_map(|j| (0..WIDTH).map(move |i| (i, j)))
        .map(|(i, j)| pixel(i, j))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axes_lie_where_the_format_says() {
        let near = |a: Vec3, b: Vec3| assert!((a - b).length() < 0.02, "{a} {b}");
        near(direction(255.5, -0.5), Vec3::Z);
        near(direction(255.5, 127.5), Vec3::Y);
        near(direction(383.5, 127.5), Vec3::X);
        near(direction(255.5, 255.5), Vec3::NEG_Z);
    }

    #[test]
    fn pixels_and_directions_are_inverse() {
        for (i, j) in [(0, 0), (511, 255), (256, 128), (100, 30)] {
            assert_eq!(pixel_of(direction(i as f32, j as f32), [WIDTH, HEIGHT]), [i, j]);
        }
    }

    #[test]
    fn a_lamp_keeps_its_place_and_energy() {
        let lamp = Vec3::new(0.4, -0.3, 0.7).normalize();
        let mut cube = Cube::filled(128, Vec3::ZERO);
        for i in 0..cube.texels().len() {
            if cube.direction(i).dot(lamp) > 3f32.to_radians().cos() {
                cube.texels_mut()[i] = Vec3::splat(100.0);
            }
        }
        let energy: f32 = cube
            .texels()
            .iter()
            .enumerate()
            .map(|(i, t)| t.x * cube.solid_angle(i))
            .sum();
        let picture = equirectangular(&cube);
        let (mut sum, mut mean) = (0.0, Vec3::ZERO);
        for (k, pixel) in picture.iter().enumerate() {
            let (i, j) = (k % WIDTH, k / WIDTH);
            let d = direction(i as f32, j as f32);
            let area = (2.0 * PI / WIDTH as f32) * (PI / HEIGHT as f32) * (1.0 - d.z * d.z).sqrt();
            sum += pixel.x * area;
            mean += d * pixel.x * area;
        }
        assert!((sum / energy - 1.0).abs() < 0.01, "{sum} {energy}");
        assert!(mean.normalize().dot(lamp) > 0.1f32.to_radians().cos());
    }
}
