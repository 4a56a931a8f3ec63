//! Radiance in a picture of the mirror ball, or of a fisheye camera, before noise.

use super::camera::{Ball, Camera};
use crate::environment_map::{EnvironmentMap, HEIGHT, WIDTH};
use glam::DVec3;
use std::f64::consts::PI;

/// Samples across a pixel on the ball: a lamp of 2° covers few pixels, and its energy should be right to 1 %.
const BALL_SAMPLES: u32 = 8;
/// Samples across a pixel of the fisheye camera, whose pixels are smaller than a texel of the map.
const FISHEYE_SAMPLES: u32 = 4;

/// Linear radiance in every pixel of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiancePicture {
    /// Width and height.
    pub size_px: [u32; 2],
    /// Red, green and blue, row by row from the top.
    pub pixels: Vec<[f32; 3]>,
}

impl RadiancePicture {
    /// Returns the radiance in a pixel.
    ///
    /// # Panics
    /// When the pixel is outside the picture.
    pub fn at(&self, column: u32, row: u32) -> [f32; 3] {
        self.pixels[(row * self.size_px[0] + column) as usize]
    }
}

/// What a mirror ball stands in.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// Radiance that arrives at the ball's centre, constant within a texel.
    pub map: &'a EnvironmentMap,
    /// Everything that is not the table is this far from the ball's centre, metres.
    pub distance_m: f64,
    /// Height of the table, an endless plane, in the world, metres.
    pub table_z_m: f64,
}

impl Surroundings<'_> {
    /// Returns the radiance that comes back along a ray, which starts near the ball's centre.
    fn radiance(&self, center_m: DVec3, from_m: DVec3, ray: DVec3) -> [f32; 3] {
        let offset_m = from_m - center_m;
        // |offset + t ray| = distance, the root in front.
        let along = offset_m.dot(ray);
        let far_m = -along
            + (along * along - offset_m.length_squared() + self.distance_m.powi(2))
                .max(0.0)
                .sqrt();
        let table_m = if ray.z < 0.0 {
            (self.table_z_m - from_m.z) / ray.z
        } else {
            far_m
        };
        texel(self.map, offset_m + far_m.min(table_m) * ray)
    }
}

/// Returns the picture that a camera has of a mirror ball; off the ball it is the background's.
///
/// # Panics
/// When the background is not of the camera's size.
pub fn ball_picture(
    camera: &Camera,
    ball: &Ball,
    surroundings: &Surroundings<'_>,
    background: &RadiancePicture,
) -> RadiancePicture {
    assert_eq!(background.size_px, camera.size_px, "a background of this camera");
    let (camera_m, center_m) = (camera.center_m(), DVec3::from_array(ball.center_m));
    let on_ball = |at_px: [f64; 2]| -> Option<[f32; 3]> {
        let ray = camera.ray(at_px)?;
        let hit_m = camera_m + nearest_hit_m(camera_m - center_m, ray, ball.radius_m)? * ray;
        let normal = (hit_m - center_m) / ball.radius_m;
        let reflected = ray - 2.0 * ray.dot(normal) * normal;
        let radiance = surroundings.radiance(center_m, hit_m, reflected);
        Some([0, 1, 2].map(|channel| ball.reflectance[channel] as f32 * radiance[channel]))
    };
    picture(camera, |column, row| {
        let behind = background.at(column, row);
        // A ball is convex and many pixels wide: a pixel whose neighbourhood misses it at all corners shows none of it.
        let [x, y] = [f64::from(column), f64::from(row)];
        let corners = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];
        if corners.iter().all(|[dx, dy]| on_ball([x + dx, y + dy]).is_none()) {
            return behind;
        }
        average([column, row], BALL_SAMPLES, |at_px| on_ball(at_px).unwrap_or(behind))
    })
}

/// Returns the picture that a fisheye camera has of the environment at its lens; black outside the image circle.
pub fn fisheye_picture(camera: &Camera, map: &EnvironmentMap) -> RadiancePicture {
    let radiance = |at_px: [f64; 2]| camera.ray(at_px).map_or([0.0; 3], |ray| texel(map, ray));
    picture(camera, |column, row| average([column, row], FISHEYE_SAMPLES, radiance))
}

fn picture(camera: &Camera, mut radiance: impl FnMut(u32, u32) -> [f32; 3]) -> RadiancePicture {
    let [width, height] = camera.size_px;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    RadiancePicture {
        size_px: camera.size_px,
        pixels: pixels.map(|(column, row)| radiance(column, row)).collect(),
    }
}

/// The mean over a pixel's area, by samples on a regular grid.
fn average(pixel: [u32; 2], samples: u32, radiance: impl Fn([f64; 2]) -> [f32; 3]) -> [f32; 3] {
    let offset = |index: u32| (f64::from(index) + 0.5) / f64::from(samples) - 0.5;
    let mut sum = [0.0_f32; 3];
    for y in 0..samples {
        for x in 0..samples {
            let sample = radiance([f64::from(pixel[0]) + offset(x), f64::from(pixel[1]) + offset(y)]);
            for channel in 0..3 {
                sum[channel] += sample[channel];
            }
        }
    }
    sum.map(|channel| channel / (samples * samples) as f32)
}

/// Distance along a ray to a sphere around the origin, seen from outside.
fn nearest_hit_m(from_m: DVec3, ray: DVec3, radius_m: f64) -> Option<f64> {
    let along = from_m.dot(ray);
    let discriminant = along * along - from_m.length_squared() + radius_m * radius_m;
    (discriminant >= 0.0 && along < 0.0).then(|| -along - discriminant.sqrt())
}

/// The texel in a direction, which need not be a unit vector.
fn texel(map: &EnvironmentMap, direction: DVec3) -> [f32; 3] {
    let theta = (direction.z / direction.length()).clamp(-1.0, 1.0).acos();
    let phi = direction.x.atan2(direction.y);
    let row = ((theta / PI * HEIGHT as f64) as usize).min(HEIGHT - 1);
    let column = ((phi / (2.0 * PI) + 0.5) * WIDTH as f64) as usize % WIDTH;
    map.radiance[row * WIDTH + column]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        environment_map::{Sphere, luminance},
        simulation::{Exposure, SimulatedRig},
        statistics::median,
    };
    use std::path::PathBuf;

    fn data(path: &str) -> PathBuf {
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/data")).join(path)
    }

    #[test]
    fn every_direction_finds_its_texel() {
        let sphere = Sphere::new();
        let map = EnvironmentMap::from_fn(&sphere, |d| d.to_array());
        for direction in &sphere.directions {
            assert_eq!(texel(&map, 3.0 * direction.as_dvec3()), direction.to_array());
        }
    }

    /// Median relative difference of luminance between a recorded picture and the simulated one, where neither clips.
    fn difference(recorded: &RadiancePicture, simulated: &RadiancePicture, clip: f32) -> f64 {
        let pairs = recorded.pixels.iter().zip(&simulated.pixels);
        let counted = pairs.filter(|(a, b)| a != b && a.iter().chain(*b).all(|&value| value > 0.02 && value < clip));
        median(
            counted
                .map(|(a, b)| (luminance(*a) / luminance(*b) - 1.0).abs())
                .collect(),
        )
        .unwrap()
    }

    #[test]
    fn a_simulated_picture_is_the_path_traced_one() {
        let exposures = [
            (
                "two_cameras",
                "static_ball",
                "000003",
                (0.004_694, 2.0, [1.0, 1.141_299_963, 1.419_499_993]),
            ),
            (
                "fisheye",
                "static_fisheye",
                "000005",
                (0.014_54, 1.0, [1.164_399_981, 1.089_200_02, 1.0]),
            ),
        ];
        for (name, map, frame, (exposure_s, gain, white_balance)) in exposures {
            let rig = SimulatedRig::load(&data(&format!("{name}/recording/rig.toml"))).unwrap();
            let map = EnvironmentMap::load(&data(&format!("{name}/truth/env/{map}.exr"))).unwrap();
            let exposure = Exposure {
                exposure_s,
                gain,
                white_balance,
            };
            let camera = rig.probe_camera().unwrap();
            let recorded = image::open(data(&format!("{name}/recording/probe/{frame}.png"))).unwrap();
            let recorded = camera.develop(&recorded.into_rgb8(), &exposure);
            let surroundings = Surroundings {
                map: &map,
                distance_m: 1.7,
                table_z_m: -0.002,
            };
            let simulated = match &rig.ball {
                Some(ball) if camera.role == "ball" => ball_picture(camera, ball, &surroundings, &recorded),
                _ => fisheye_picture(camera, &map),
            };
            let difference = difference(&recorded, &simulated, 1.0);
            // Noise is 1 % of a code, and things on the table are not where the endless table is.
            assert!(difference < 0.03, "{name}: {difference}");
        }
    }
}
