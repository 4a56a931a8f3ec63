//! Shadows on phantoms by casting rays.

use glam::Vec3;

use crate::scene::occluders::Occluders;
use crate::shadow::dome::DomeLight;

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
pub fn ratio(point_m: Vec3, normal: Vec3, lights: &[DomeLight], blockers: Blockers<'_>, near: Vec3) -> Vec3 {
    let (mut with, mut without) = (near, near);
    for light in lights {
        let light_m = light.position_m;
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
pub fn irradiance(light: &DomeLight, point_m: Vec3, normal: Vec3) -> Vec3 {
    let to_light = light.position_m - point_m;
    let cosine = normal.dot(to_light.normalize()).max(0.0);
    light.intensity * cosine / to_light.length_squared()
}
