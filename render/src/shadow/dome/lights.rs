//! Where a dome's lights stand.

use std::f32::consts::PI;

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use crate::shadow::shadow_view::{ShadowView, Sphere};

/// One light of a dome. World frame, metres, linear RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DomeLight {
    /// Where it stands.
    pub position_m: Vec3,
    /// Intensity, so that irradiance = intensity cos θ / distance².
    pub intensity: Vec3,
    /// Half the angle that it fills, radians.
    pub angular_radius_rad: f32,
}

/// A light as the shaders take it (`DomeLight` in `shared/dome.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuDomeLight {
    /// xyz: where it stands; w: tangent of half the angle that it fills.
    pub position_m: Vec4,
    /// xyz: intensity; w: 1 for a light that shines, 0 for a dark one.
    pub intensity: Vec4,
    /// Map x times depth of a point (x, y, z, 1): right, over the tangent of half the opening angle.
    pub right: Vec4,
    /// The same for y.
    pub up: Vec4,
    /// Depth along the view, metres.
    pub forward: Vec4,
    /// x, y: stored depth is x - y / depth, 1 at the near plane and 0 at the far one; z: size of a texel in the middle of
    /// the receivers, metres; w: tangent of half the opening angle.
    pub depth: Vec4,
}

impl GpuDomeLight {
    /// A light whose map of `map_size` texels shows the sphere `receivers` and is as deep as `everything`.
    #[must_use]
    pub fn new(light: &DomeLight, (receivers, everything): (Sphere, Sphere), map_size: u32) -> Self {
        let view = ShadowView::new(light.position_m, (receivers, everything), map_size);
        let row = |axis: Vec3, scale: f32| (axis * scale).extend(-axis.dot(view.position_m) * scale);
        let [right, up, forward] = view.axes;
        let [near_m, far_m] = view.depth_m;
        let slope = far_m / (far_m - near_m);
        Self {
            position_m: light.position_m.extend(light.angular_radius_rad.min(1.4).tan()),
            intensity: light.intensity.extend(f32::from(light.intensity.max_element() > 0.0)),
            right: row(right, view.tangent.recip()),
            up: row(up, view.tangent.recip()),
            forward: row(forward, 1.0),
            depth: Vec4::new(1.0 - slope, -slope * near_m, view.texel_m, view.tangent),
        }
    }

    /// Whether the map of one is the map of the other: all but brightness is alike, and none or both are dark.
    #[must_use]
    pub fn shows_the_same(&self, other: &Self) -> bool {
        let dim = |light: &Self| Self {
            intensity: Vec4::new(0.0, 0.0, 0.0, light.intensity.w),
            ..*light
        };
        dim(self) == dim(other)
    }
}

/// `n` unit directions spread evenly over the hemisphere around +z, each for the same solid angle (spherical Fibonacci
/// points: Marques et al. 2013).
#[must_use]
pub fn hemisphere(n: u32) -> Vec<Vec3> {
    let golden = PI * (3.0 - 5.0f32.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - (i as f32 + 0.5) / n as f32;
            let (sine, azimuth) = ((1.0 - z * z).sqrt(), golden * i as f32);
            Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z)
        })
        .collect()
}

/// Index of the nearest of `directions` for every direction of `of`: the cells of a dome.
#[must_use]
pub fn stratified_cells(directions: &[Vec3], of: impl Iterator<Item = Vec3>) -> Vec<usize> {
    of.map(|direction| {
        let nearest = directions
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.dot(direction).total_cmp(&b.1.dot(direction)));
        nearest.map_or(0, |(index, _)| index)
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_uniform_hemisphere_gives_pi() {
        for n in [16, 64, 256] {
            let directions = hemisphere(n);
            let irradiance: f32 = directions.iter().map(|d| d.z * 2.0 * PI / n as f32).sum();
            assert!((irradiance - PI).abs() < 0.01, "{n}: {irradiance}");
            let sum: Vec3 = directions.iter().copied().sum::<Vec3>() / n as f32;
            assert!(sum.truncate().length() < 0.05, "{n}: {sum}");
        }
    }

    #[test]
    fn stored_depth_runs_from_one_to_zero() {
        let bounds = Sphere {
            center_m: Vec3::new(0.1, 0.0, 0.2),
            radius_m: 0.5,
        };
        let light = DomeLight {
            position_m: Vec3::new(3.0, 2.0, 4.0),
            intensity: Vec3::ONE,
            angular_radius_rad: 0.1,
        };
        let gpu = GpuDomeLight::new(&light, (bounds, bounds), 256);
        let towards = (light.position_m - bounds.center_m).normalize();
        let stored = |p: Vec3| {
            let z = gpu.forward.dot(p.extend(1.0));
            assert!((gpu.right.dot(p.extend(1.0)) / z).abs() < 1.0);
            gpu.depth.x - gpu.depth.y / z
        };
        let near = stored(bounds.center_m + bounds.radius_m * towards);
        let far = stored(bounds.center_m - bounds.radius_m * towards);
        assert!((near - 1.0).abs() < 1e-3 && far.abs() < 1e-3, "{near} {far}");
    }
}
