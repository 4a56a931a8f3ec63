//! Irradiance of an environment map over a sphere of normals, and its error against a true map.

use crate::environment_map::{EnvironmentMap, Sphere, WIDTH, luminance};
use glam::Vec3;
use serde::Serialize;

/// Relative error of the irradiance, in percent of the true irradiance for the same normal.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IrradianceError {
    /// Mean over all normals of the error of luminance.
    pub mean_percent: f64,
    /// Worst normal's error of luminance.
    pub worst_percent: f64,
    /// Mean over the normals that do not point down.
    pub upper_mean_percent: f64,
    /// Worst of the normals that do not point down.
    pub upper_worst_percent: f64,
    /// Mean over all normals, by channel.
    pub rgb_mean_percent: [f64; 3],
}

/// Returns the irradiance on surfaces with these normals: E = Σ L max(n · d, 0) dω over all texels, by channel.
pub fn irradiance(map: &EnvironmentMap, sphere: &Sphere, normals: &[Vec3]) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0_f64; 3]; normals.len()];
    for (index, (texel, direction)) in map.radiance.iter().zip(&sphere.directions).enumerate() {
        let weighted = texel.map(|radiance| f64::from(radiance) * sphere.row_solid_angles[index / WIDTH]);
        for (sum, normal) in sums.iter_mut().zip(normals) {
            let cosine = f64::from(normal.dot(*direction).max(0.0));
            for channel in 0..3 {
                sum[channel] += weighted[channel] * cosine;
            }
        }
    }
    sums.into_iter().map(|sum| sum.map(|channel| channel as f32)).collect()
}

/// Compares irradiances for the same normals; a normal without true irradiance is left out.
pub fn compare(found: &[[f32; 3]], truth: &[[f32; 3]], normals: &[Vec3]) -> IrradianceError {
    let mut errors = Errors::default();
    let mut upper = Errors::default();
    let mut channels = [Errors::default(); 3];
    for ((found, truth), normal) in found.iter().zip(truth).zip(normals) {
        errors.add(luminance(*found), luminance(*truth));
        if normal.z >= 0.0 {
            upper.add(luminance(*found), luminance(*truth));
        }
        for channel in 0..3 {
            channels[channel].add(found[channel].into(), truth[channel].into());
        }
    }
    IrradianceError {
        mean_percent: errors.mean_percent(),
        worst_percent: errors.worst_percent,
        upper_mean_percent: upper.mean_percent(),
        upper_worst_percent: upper.worst_percent,
        rgb_mean_percent: channels.map(|channel| channel.mean_percent()),
    }
}

/// Running mean and maximum of relative errors.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    sum_percent: f64,
    worst_percent: f64,
    count: f64,
}

impl Errors {
    fn add(&mut self, found: f64, truth: f64) {
        if truth > 0.0 {
            let percent = 100.0 * (found - truth).abs() / truth;
            self.sum_percent += percent;
            self.worst_percent = self.worst_percent.max(percent);
            self.count += 1.0;
        }
    }

    fn mean_percent(&self) -> f64 {
        if self.count > 0.0 {
            self.sum_percent / self.count
        } else {
            0.0
        }
    }
}

/// Returns 162 normals spread evenly over the sphere: an icosahedron, every triangle divided in four, twice.
pub fn normals() -> Vec<Vec3> {
    let mut vertices = icosahedron_vertices();
    let mut edges = nearest_pairs(&vertices);
    for _ in 0..2 {
        vertices.extend(edges.iter().map(|&(a, b)| (a + b).normalize()).collect::<Vec<_>>());
        edges = nearest_pairs(&vertices);
    }
    vertices
}

/// Returns the cyclic permutations of (0, ±1, ±φ), φ being the golden ratio.
fn icosahedron_vertices() -> Vec<Vec3> {
    let golden = 0.5 * (1.0 + 5_f32.sqrt());
    let mut vertices = Vec::new();
    for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
        vertices.extend([Vec3::new(0.0, a, b), Vec3::new(a, b, 0.0), Vec3::new(b, 0.0, a)]);
    }
    vertices.iter().map(|vertex| vertex.normalize()).collect()
}

/// Returns the edges of a subdivided icosahedron: the pairs less than 1.3 times the least distance apart.
///
/// Edges of one subdivision differ by less than 18 % in length, diagonals are at least √3 times as long.
fn nearest_pairs(vertices: &[Vec3]) -> Vec<(Vec3, Vec3)> {
    let pairs = || (1..vertices.len()).flat_map(|a| (0..a).map(move |b| (vertices[a], vertices[b])));
    let least = pairs().map(|(a, b)| a.distance(b)).fold(f32::INFINITY, f32::min);
    pairs().filter(|(a, b)| a.distance(*b) < 1.3 * least).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_normals_are_an_icosphere() {
        let normals = normals();
        assert_eq!(normals.len(), 162);
        assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-6));
        assert!(normals.iter().sum::<Vec3>().length() < 1e-4);
    }

    #[test]
    fn analytic_environments_give_their_irradiance() {
        let (sphere, normals) = (Sphere::new(), normals());
        let gradient = Vec3::new(0.2, -0.5, 0.3);
        type Light = fn(Vec3, Vec3) -> f32;
        let cases: [(Light, &dyn Fn(Vec3) -> f64); 3] = [
            (|_, _| 1.0, &|_| PI),
            (|d, a| 1.0 + a.dot(d), &|n| {
                PI + 2.0 * PI / 3.0 * f64::from(gradient.dot(n))
            }),
            (|d, _| f32::from(d.y > 0.0), &|n| 0.5 * PI * (1.0 + f64::from(n.y))),
        ];
        for (radiance, expected) in cases {
            let map = EnvironmentMap::from_fn(&sphere, |d| [radiance(d, gradient); 3]);
            for (found, normal) in irradiance(&map, &sphere, &normals).iter().zip(&normals) {
                let error = (f64::from(found[1]) - expected(*normal)).abs();
                assert!(error < 1e-3 * PI, "{error} at {normal}");
            }
        }
    }

    #[test]
    fn a_scaled_map_has_the_scale_as_error() {
        let (sphere, normals) = (Sphere::new(), normals());
        let truth = EnvironmentMap::from_fn(&sphere, |d| [1.0 + d.x, 2.0, 1.5 - d.z]);
        let found = EnvironmentMap::from_fn(&sphere, |d| [1.1 * (1.0 + d.x), 2.2, 1.1 * (1.5 - d.z)]);
        let [truth, found] = [truth, found].map(|map| irradiance(&map, &sphere, &normals));
        let error = compare(&found, &truth, &normals);
        let all = [
            error.mean_percent,
            error.worst_percent,
            error.upper_mean_percent,
            error.upper_worst_percent,
        ];
        for percent in all.into_iter().chain(error.rgb_mean_percent) {
            assert!((percent - 10.0).abs() < 1e-3, "{error:?}");
        }
    }
}
