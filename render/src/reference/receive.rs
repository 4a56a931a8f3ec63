//! Shadows on phantoms by casting rays, and percentage-closer filtering texel by texel.

use glam::{Vec2, Vec3};

use super::shadow_map::DepthMap;
use crate::gpu::types::GpuLight;
use crate::scene::occluders::Occluders;

/// What stands in the light's way, world frame.
#[derive(Debug, Clone, Copy)]
pub struct Blockers<'a> {
    /// Real things.
    pub phantoms: &'a Occluders,
    /// Virtual objects.
    pub virtuals: &'a Occluders,
}

/// Irradiance at `point_m` with all objects over irradiance with the real ones alone; `near` comes from near things and
/// is in both. Shadows have hard edges.
#[must_use]
pub fn ratio(point_m: Vec3, normal: Vec3, lights: &[GpuLight], blockers: Blockers<'_>, near: Vec3) -> Vec3 {
    let (mut with, mut without) = (near, near);
    for light in lights {
        let light_m = light.position_m.truncate();
        let direct = irradiance(light, point_m, normal);
        if !blockers.phantoms.blocks(point_m, light_m) {
            without += direct;
            if !blockers.virtuals.blocks(point_m, light_m) {
                with += direct;
            }
        }
    }
    with / without.max(Vec3::splat(1e-9))
}

/// Irradiance of one light, nothing in its way.
#[must_use]
pub fn irradiance(light: &GpuLight, point_m: Vec3, normal: Vec3) -> Vec3 {
    let to_light = light.position_m.truncate() - point_m;
    let cosine = normal.dot(to_light.normalize()).max(0.0);
    light.intensity.truncate() * cosine / to_light.length_squared()
}

/// Share of the light past a depth map at `uv` (0 ..= 1, rows from the top): the mean of `taps` × `taps` bilinear
/// comparisons, spread over `reach_texels` to each side; one comparison where that is 0 (Reeves et al. 1987).
#[must_use]
pub fn pcf(map: &DepthMap, uv: Vec2, (taps, reach_texels): (u32, f32), depth: f32) -> f32 {
    let texel = uv * map.size as f32 - 0.5;
    if reach_texels <= 0.0 {
        return compare(map, texel, depth);
    }
    let step = 2.0 * reach_texels / (taps - 1) as f32;
    let mut sum = 0.0;
    for y in 0..taps {
        for x in 0..taps {
            let offset = Vec2::new(x as f32, y as f32) * step - reach_texels;
            sum += compare(map, texel + offset, depth);
        }
    }
    sum / (taps * taps) as f32
}

/// Share of the four texels around `texel` (centres at integers), weighted bilinearly, that lie no nearer than `depth`.
fn compare(map: &DepthMap, texel: Vec2, depth: f32) -> f32 {
    let corner = texel.floor();
    let f = texel - corner;
    let lit = |dx: f32, dy: f32| {
        if depth <= map.at(corner.x + dx, corner.y + dy) {
            1.0
        } else {
            0.0
        }
    };
    let top = lit(0.0, 0.0) * (1.0 - f.x) + lit(1.0, 0.0) * f.x;
    let bottom = lit(0.0, 1.0) * (1.0 - f.x) + lit(1.0, 1.0) * f.x;
    top * (1.0 - f.y) + bottom * f.y
}
