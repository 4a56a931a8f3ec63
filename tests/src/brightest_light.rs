//! Where the brightest light of an environment map is.
//!
//! 1. The map's luminance is averaged with a Gaussian lobe of [`LOBE_DEG`] on the sphere, normalised to sum 1, so that a
//!    lamp of a few texels and a window compete by what they send through the same small cone.
//! 2. The highest value of the averaged map is the peak. The light is the connected region around the peak in which
//!    the averaged map exceeds [`LIGHT_SHARE`] of the peak: a lamp's lobe, a whole window with its frame, a whole panel.
//! 3. The direction is the mean of the region's directions weighted by luminance (not averaged) and solid angle.
//!
//! The centroid, not the peak, is compared: on a large even panel the peak is anywhere, the centroid of a region bounded
//! by the panel's edges is not. The same procedure is applied to the true and to the found map.

use crate::environment_map::{EnvironmentMap, HEIGHT, Sphere, WIDTH, luminance};
use glam::DVec3;
use std::f64::consts::PI;

/// Standard deviation of the averaging lobe in degrees; a texel is 0.7° wide, lamps and window bars are 2 to 5° wide.
pub const LOBE_DEG: f64 = 3.0;
/// Share of the peak above which a connected texel belongs to the light: low, so that a window brighter at its top or a
/// panel brighter at one end counts whole, and above what a wall beside a lit panel has.
pub const LIGHT_SHARE: f64 = 0.25;
/// The lobe is cut off here, in standard deviations.
const LOBE_REACH: f64 = 3.0;

/// The brightest light of an environment map.
#[derive(Clone, Copy, Debug)]
pub struct BrightestLight {
    /// Unit vector to the light's centroid, world frame.
    pub direction: DVec3,
    /// Radius in degrees of the cone that has the solid angle of the light's region.
    pub radius_deg: f64,
}

/// Finds the brightest light; `None` in a map without any light.
pub fn brightest_light(map: &EnvironmentMap, sphere: &Sphere) -> Option<BrightestLight> {
    let luminances: Vec<f64> = map.radiance.iter().map(|&texel| luminance(texel)).collect();
    let averaged = average(&luminances, sphere);
    let peak = (0..averaged.len()).max_by(|&a, &b| averaged[a].total_cmp(&averaged[b]))?;
    if averaged[peak] <= 0.0 {
        return None;
    }
    let mut centroid = DVec3::ZERO;
    let mut solid_angle = 0.0;
    for texel in connected_above(&averaged, peak, LIGHT_SHARE * averaged[peak]) {
        let texel_solid_angle = sphere.row_solid_angles[texel / WIDTH];
        solid_angle += texel_solid_angle;
        centroid += luminances[texel].max(0.0) * texel_solid_angle * sphere.directions[texel].as_dvec3();
    }
    // A cone of half angle a has the solid angle 2π (1 - cos a).
    let radius_deg = (1.0 - solid_angle / (2.0 * PI)).max(-1.0).acos().to_degrees();
    Some(BrightestLight {
        direction: centroid.try_normalize()?,
        radius_deg,
    })
}

/// Returns the angle between two unit vectors in degrees, accurate also where it is tiny.
pub fn angle_deg(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

/// Averages a map with the lobe, solid angles included.
fn average(values: &[f64], sphere: &Sphere) -> Vec<f64> {
    // Every row twice in a row, so that a row turned by some columns is one slice.
    let wrapped: Vec<f32> = values
        .chunks(WIDTH)
        .flat_map(|row| [row, row])
        .flatten()
        .map(|&v| v as f32)
        .collect();
    let mut averaged = Vec::with_capacity(values.len());
    for row in 0..HEIGHT {
        let mut sums = [0.0_f32; WIDTH];
        for tap in lobe_around(row, sphere) {
            let turned = &wrapped[2 * WIDTH * tap.row + tap.columns_right..][..WIDTH];
            for (sum, value) in sums.iter_mut().zip(turned) {
                *sum += tap.weight as f32 * value;
            }
        }
        averaged.extend(sums.map(f64::from));
    }
    averaged
}

/// A texel within the lobe, seen from a texel of a given row.
struct Tap {
    row: usize,
    columns_right: usize,
    weight: f64,
}

/// Returns the texels within the lobe around the texels of a row, with weights that sum to 1.
fn lobe_around(row: usize, sphere: &Sphere) -> Vec<Tap> {
    let middle = sphere.directions[row * WIDTH];
    let sigma = LOBE_DEG.to_radians();
    let rows = (LOBE_REACH * sigma / PI * HEIGHT as f64).ceil() as usize;
    let mut taps = Vec::new();
    // Unit vectors no more than an angle a apart are no more than 2 sin(a / 2) apart.
    let reach = (2.0 * (0.5 * LOBE_REACH * sigma).sin()) as f32;
    for tap_row in row.saturating_sub(rows)..(row + rows + 1).min(HEIGHT) {
        for columns_right in 0..WIDTH {
            let distance = middle.distance(sphere.directions[tap_row * WIDTH + columns_right]);
            if distance <= reach {
                let angle = 2.0 * (0.5 * f64::from(distance)).asin();
                let weight = (-0.5 * (angle / sigma).powi(2)).exp() * sphere.row_solid_angles[tap_row];
                taps.push(Tap {
                    row: tap_row,
                    columns_right,
                    weight,
                });
            }
        }
    }
    let sum: f64 = taps.iter().map(|tap| tap.weight).sum();
    taps.iter_mut().for_each(|tap| tap.weight /= sum);
    taps
}

/// Returns the texels above a threshold that are connected with a start texel, itself included.
fn connected_above(values: &[f64], start: usize, threshold: f64) -> Vec<usize> {
    let mut reached = vec![false; values.len()];
    reached[start] = true;
    let mut region = vec![start];
    let mut next = 0;
    while let Some(&texel) = region.get(next) {
        next += 1;
        for neighbour in neighbours(texel) {
            if !reached[neighbour] && values[neighbour] > threshold {
                reached[neighbour] = true;
                region.push(neighbour);
            }
        }
    }
    region
}

/// Returns the four texels that share an edge; over a pole is the texel of the same row on the other side.
fn neighbours(texel: usize) -> [usize; 4] {
    let (row, column) = (texel / WIDTH, texel % WIDTH);
    let across = row * WIDTH + (column + WIDTH / 2) % WIDTH;
    [
        row * WIDTH + (column + 1) % WIDTH,
        row * WIDTH + (column + WIDTH - 1) % WIDTH,
        if row == 0 { across } else { texel - WIDTH },
        if row == HEIGHT - 1 { across } else { texel + WIDTH },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dim room with a light of given radiance within a cone around a direction.
    fn room(sphere: &Sphere, towards: DVec3, radius_deg: f64, radiance: f32) -> EnvironmentMap {
        let cosine = radius_deg.to_radians().cos() as f32;
        let towards = towards.normalize().as_vec3();
        EnvironmentMap::from_fn(sphere, |d| {
            [if d.dot(towards) > cosine {
                radiance
            } else {
                0.2 + 0.1 * d.z
            }; 3]
        })
    }

    /// A direction by height over the horizon and azimuth from +y towards +x.
    fn towards(height_deg: f64, azimuth_deg: f64) -> DVec3 {
        let (height, azimuth) = (height_deg.to_radians(), azimuth_deg.to_radians());
        DVec3::new(height.cos() * azimuth.sin(), height.cos() * azimuth.cos(), height.sin())
    }

    #[test]
    fn lamps_windows_and_panels_are_found_where_they_are() {
        let sphere = Sphere::new();
        for (radius_deg, radiance) in [(1.5, 2000.0), (18.0, 12.0), (45.0, 2.0)] {
            for direction in [towards(30.0, 20.0), towards(5.0, 179.0), towards(88.0, -60.0)] {
                let light = brightest_light(&room(&sphere, direction, radius_deg, radiance), &sphere).unwrap();
                assert!(
                    angle_deg(light.direction, direction.normalize()) < 0.2,
                    "{radius_deg}: {light:?}"
                );
                assert!(
                    light.radius_deg > radius_deg - 0.5 && light.radius_deg < radius_deg + 6.0,
                    "{light:?}"
                );
            }
        }
    }

    #[test]
    fn a_lamp_moved_by_five_degrees_is_five_degrees_off() {
        let sphere = Sphere::new();
        let lights = [30.0, 35.0].map(|height_deg| {
            brightest_light(&room(&sphere, towards(height_deg, 40.0), 2.0, 600.0), &sphere)
                .unwrap()
                .direction
        });
        let angle = angle_deg(lights[0], lights[1]);
        assert!((angle - 5.0).abs() < 0.1, "{angle}");
    }

    #[test]
    fn the_centroid_of_an_even_panel_does_not_follow_a_ripple() {
        let sphere = Sphere::new();
        let panel = room(&sphere, towards(80.0, 10.0), 40.0, 2.0);
        let mut rippled = panel.clone();
        for (texel, direction) in rippled.radiance.iter_mut().zip(&sphere.directions) {
            let ripple = 1.0 + 0.05 * (9.0 * direction.x + 1.0).sin();
            *texel = texel.map(|radiance| radiance * ripple);
        }
        let [a, b] = [&panel, &rippled].map(|map| brightest_light(map, &sphere).unwrap().direction);
        assert!(angle_deg(a, b) < 0.5, "{}", angle_deg(a, b));
    }

    #[test]
    fn a_dark_map_has_no_light() {
        let sphere = Sphere::new();
        assert!(brightest_light(&EnvironmentMap::from_fn(&sphere, |_| [0.0; 3]), &sphere).is_none());
    }
}
