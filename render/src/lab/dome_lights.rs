//! The shadow scene's light as surroundings: uniform light from everywhere and one light, seen from the middle of the scene.

use std::f32::consts::PI;

use glam::Vec3;
use mirrorball_calib::lights::{LightCounts, LightMethod, LightTracker};
use mirrorball_calib::probe::cube::Cube;

use crate::shadow::ShadowMethod;
use crate::shadow::dome::{self, DomeLight, DomePlan, Surroundings};
use crate::shadow::light::ShadowLight;
use crate::shadow::shadow_view::Sphere;

/// Edge of the cube that the light is painted into, texels.
const CUBE_SIZE: u32 = 64;
/// Lights that stand nowhere are put so far away, in radii of the scene.
const FAR_RADII: f32 = 100.0;

/// The lights of a dome method for uniform radiance `ambient` and one light, as the scene inside `bounds` sees them.
pub(super) fn plan(
    method: ShadowMethod,
    (light, ambient): (&ShadowLight, Vec3),
    bounds: Sphere,
    tracker: &mut LightTracker,
) -> DomePlan {
    let painted = Painted::new(light, ambient, bounds);
    let stable = if method == ShadowMethod::Stable {
        tracker.update(&painted.radiance, &painted.distance_m)
    } else {
        &[]
    };
    let around = Surroundings {
        radiance: &painted.radiance,
        distance_m: &painted.distance_m,
        center_m: bounds.center_m,
        far_m: painted.far_m(),
        stable,
        hand: (painted.at_its_place(light), PI * ambient),
    };
    dome::plan(method, &around)
}

/// A tracker for [`ShadowMethod::Stable`]: light comes from above.
pub(super) fn stable_tracker() -> LightTracker {
    let mut open = Cube::filled(32, false);
    for index in 0..open.texels().len() {
        open.texels_mut()[index] = open.direction(index).z > 0.0;
    }
    LightTracker::new(LightMethod::Stable, &open, LightCounts { dome: 48, bright: 16 })
}

/// The light as a cube around the middle of the scene.
struct Painted {
    radiance: Cube<Vec3>,
    distance_m: Cube<f32>,
    bounds: Sphere,
}

impl Painted {
    fn new(light: &ShadowLight, ambient: Vec3, bounds: Sphere) -> Self {
        /// Places per edge of a rectangle that are painted.
        const GRID: u32 = 24;
        let mut painted = Self {
            radiance: Cube::filled(CUBE_SIZE, ambient),
            distance_m: Cube::filled(CUBE_SIZE, f32::INFINITY),
            bounds,
        };
        let center = bounds.center_m;
        match *light {
            ShadowLight::Directional { towards, irradiance } => painted.add(towards, irradiance, f32::INFINITY),
            ShadowLight::Point { position_m, intensity } => {
                let offset = position_m - center;
                painted.add(offset, intensity / offset.length_squared().max(1e-6), offset.length());
            }
            ShadowLight::Spot {
                position_m,
                axis,
                cone_rad: [inner, outer],
                intensity,
            } => {
                let offset = position_m - center;
                let angle = (-offset).angle_between(axis);
                let share = ((outer - angle) / (outer - inner).max(1e-6)).clamp(0.0, 1.0);
                painted.add(
                    offset,
                    share * intensity / offset.length_squared().max(1e-6),
                    offset.length(),
                );
            }
            ShadowLight::Rect {
                center_m,
                half_u_m,
                half_v_m,
                radiance,
            } => {
                let across = half_u_m.cross(half_v_m);
                let (normal, area) = (across.normalize_or_zero(), 4.0 * across.length());
                let at = |k: u32| (k as f32 + 0.5) / GRID as f32 * 2.0 - 1.0;
                for (i, j) in (0..GRID).flat_map(|i| (0..GRID).map(move |j| (i, j))) {
                    let offset = center_m + at(i) * half_u_m + at(j) * half_v_m - center;
                    let squared = offset.length_squared().max(1e-6);
                    let cosine = (-offset.dot(normal) / squared.sqrt()).max(0.0);
                    let share = cosine * area / (GRID * GRID) as f32 / squared;
                    painted.add(offset, radiance * share, squared.sqrt());
                }
            }
        }
        painted
    }

    fn add(&mut self, direction: Vec3, irradiance: Vec3, distance_m: f32) {
        let index = self.radiance.index_of(direction);
        let added = irradiance / self.radiance.solid_angle(index);
        self.radiance.texels_mut()[index] += added;
        self.distance_m.texels_mut()[index] = distance_m;
    }

    fn far_m(&self) -> f32 {
        FAR_RADII * self.bounds.radius_m
    }

    /// The one light as a dome's only light.
    fn at_its_place(&self, light: &ShadowLight) -> DomeLight {
        let far_m = self.far_m();
        let position_m = light.place_m([0.0; 2], self.bounds.center_m, far_m);
        let offset = position_m - self.bounds.center_m;
        let intensity = match *light {
            ShadowLight::Directional { irradiance, .. } => irradiance * far_m * far_m,
            ShadowLight::Point { intensity, .. } | ShadowLight::Spot { intensity, .. } => intensity,
            ShadowLight::Rect {
                half_u_m,
                half_v_m,
                radiance,
                ..
            } => {
                let across = half_u_m.cross(half_v_m);
                radiance * 4.0 * across.dot(-offset.normalize_or(Vec3::Z)).max(0.0)
            }
        };
        DomeLight {
            position_m,
            intensity,
            angular_radius_rad: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Sphere = Sphere {
        center_m: Vec3::ZERO,
        radius_m: 1.0,
    };

    fn upward(plan: &DomePlan) -> f32 {
        let irradiance = |l: &DomeLight| l.intensity.x * l.position_m.normalize().z / l.position_m.length_squared();
        plan.lights.iter().map(irradiance).sum::<f32>() + plan.unshaded.x
    }

    #[test]
    fn every_method_has_the_same_light_on_a_surface_that_faces_up() {
        let light = ShadowLight::Rect {
            center_m: Vec3::new(0.5, 0.0, 1.5),
            half_u_m: Vec3::new(0.2, 0.0, 0.0),
            half_v_m: Vec3::new(0.0, -0.2, 0.0),
            radiance: Vec3::splat(20.0),
        };
        let ambient = Vec3::splat(0.3);
        let offset = Vec3::new(0.5, 0.0, 1.5);
        let cosine = offset.normalize().z;
        let expected = 20.0 * 0.16 * cosine * cosine / offset.length_squared() + PI * 0.3;
        for method in ShadowMethod::ALL
            .into_iter()
            .filter(|m| m.family() == crate::shadow::Family::Dome)
        {
            let plan = plan(method, (&light, ambient), BOUNDS, &mut stable_tracker());
            assert!(plan.lights.len() <= method.dome_lights() as usize, "{method:?}");
            let found = upward(&plan);
            let tolerance = if matches!(method, ShadowMethod::Dome16) {
                0.15
            } else {
                0.07
            };
            assert!(
                (found / expected - 1.0).abs() < tolerance,
                "{method:?}: {found} {expected}"
            );
        }
    }
}
