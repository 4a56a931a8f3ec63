//! The shadow scene's light as a dome: uniform light from everywhere and one light, seen from the middle of the scene.

use std::f32::consts::PI;

use glam::Vec3;
use mirrorball_calib::lights::{KeyLight, LightCounts, LightMethod, LightTracker};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;

use crate::passes::shadow_map::Sphere;
use crate::shadow::ShadowMethod;
use crate::shadow::dome::{DomeLight, RayMode, Unshaded, hemisphere, stratified_cells};
use crate::shadow::light::ShadowLight;

/// Edge of the cube that the light is painted into, texels.
const CUBE_SIZE: u32 = 64;
/// Lights that stand nowhere are put so far away, in radii of the scene.
const FAR_RADII: f32 = 100.0;
/// A light that gives less than this share of all light is too dim for its shadow to be seen (D13).
const DIM_SHARE: f32 = 0.002;
/// Part of the dome's cells that are darker than what counts as the scene's base brightness (D14).
const BASE_QUANTILE: f32 = 0.25;

/// What a dome method draws.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DomePlan {
    /// The lights.
    pub(super) lights: Vec<DomeLight>,
    /// Irradiance that nothing shades.
    pub(super) unshaded: Vec3,
}

/// Most lights that a method uses.
pub(super) fn lights_max(method: ShadowMethod) -> u32 {
    match method {
        ShadowMethod::Dome16 => 16,
        ShadowMethod::Dome256 => 256,
        ShadowMethod::Hand => 1,
        _ => 64,
    }
}

/// How a method's rays look for what is in the way.
pub(super) fn mode(method: ShadowMethod) -> RayMode {
    match method {
        ShadowMethod::AmbientOcclusion | ShadowMethod::DomeImproved | ShadowMethod::Stable => RayMode::Soft,
        _ => RayMode::Hard,
    }
}

/// Where a method's unshaded light comes from.
pub(super) fn unshaded_from(method: ShadowMethod) -> Unshaded {
    match method {
        ShadowMethod::BaseBrightness => Unshaded::Above,
        _ => Unshaded::Everywhere,
    }
}

/// The lights of a dome method for uniform radiance `ambient` and one light, as the scene inside `bounds` sees them.
pub(super) fn plan(
    method: ShadowMethod,
    (light, ambient): (&ShadowLight, Vec3),
    bounds: Sphere,
    tracker: &mut LightTracker,
) -> DomePlan {
    let painted = Painted::new(light, ambient, bounds);
    match method {
        ShadowMethod::Hand => DomePlan {
            lights: vec![painted.at_its_place(light)],
            unshaded: PI * ambient,
        },
        ShadowMethod::AmbientOcclusion => DomePlan {
            lights: painted.even(lights_max(method)),
            unshaded: Vec3::ZERO,
        },
        ShadowMethod::DomeImproved => DomePlan {
            lights: painted.improved(lights_max(method)),
            unshaded: Vec3::ZERO,
        },
        ShadowMethod::BaseBrightness => painted.over_base(lights_max(method)),
        ShadowMethod::Stable => {
            let lights = tracker.update(&painted.radiance, &painted.distance_m);
            DomePlan {
                lights: lights.iter().map(|l| of_key_light(l, bounds)).collect(),
                unshaded: Vec3::ZERO,
            }
        }
        _ => DomePlan {
            lights: painted
                .cells(lights_max(method))
                .into_iter()
                .map(|cell| cell.light)
                .collect(),
            unshaded: Vec3::ZERO,
        },
    }
}

/// A tracker for [`ShadowMethod::Stable`]: light comes from above.
pub(super) fn stable_tracker() -> LightTracker {
    let mut open = Cube::filled(32, false);
    for index in 0..open.texels().len() {
        open.texels_mut()[index] = open.direction(index).z > 0.0;
    }
    LightTracker::new(LightMethod::Stable, &open, LightCounts { dome: 48, bright: 16 })
}

fn of_key_light(light: &KeyLight, bounds: Sphere) -> DomeLight {
    let distance_m = light.distance_m.min(FAR_RADII * bounds.radius_m);
    DomeLight {
        position_m: bounds.center_m + light.direction * distance_m,
        intensity: light.irradiance * distance_m * distance_m,
        angular_radius_rad: light.angular_radius_rad,
    }
}

/// The light as a cube around the middle of the scene.
struct Painted {
    radiance: Cube<Vec3>,
    distance_m: Cube<f32>,
    bounds: Sphere,
}

/// One cell of a dome.
struct Cell {
    light: DomeLight,
    /// Irradiance that a surface facing it gets.
    irradiance: Vec3,
    solid_angle_sr: f32,
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

    /// A light in a direction, farther away than everything or at `distance_m`.
    fn light(&self, direction: Vec3, irradiance: Vec3, (distance_m, angular_radius_rad): (f32, f32)) -> DomeLight {
        let distance_m = distance_m.min(self.far_m());
        DomeLight {
            position_m: self.bounds.center_m + direction * distance_m,
            intensity: irradiance * distance_m * distance_m,
            angular_radius_rad,
        }
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

    /// `n` cells over the hemisphere, each light in the middle of its cell and far away.
    fn cells(&self, n: u32) -> Vec<Cell> {
        let directions = hemisphere(n);
        let mut sums = vec![(Vec3::ZERO, 0.0f32); directions.len()];
        for (index, cell) in self.assigned(&directions) {
            let area = self.radiance.solid_angle(index);
            sums[cell].0 += self.radiance.texels()[index] * area;
            sums[cell].1 += area;
        }
        let radius_rad = (1.0 - 1.0 / n as f32).acos();
        let cell = |(direction, (irradiance, solid_angle_sr)): (&Vec3, (Vec3, f32))| Cell {
            light: self.light(*direction, irradiance, (f32::INFINITY, radius_rad)),
            irradiance,
            solid_angle_sr,
        };
        directions.iter().zip(sums).map(cell).collect()
    }

    /// Texels above the horizon with the index of their cell.
    fn assigned(&self, directions: &[Vec3]) -> Vec<(usize, usize)> {
        let upper: Vec<usize> = (0..self.radiance.texels().len())
            .filter(|&i| self.radiance.direction(i).z > 0.0)
            .collect();
        let cells = stratified_cells(directions, upper.iter().map(|&i| self.radiance.direction(i)));
        upper.into_iter().zip(cells).collect()
    }

    /// The seeds' wishes for the dome (Supan 2006, outlook): each light at the brightest spot of its cell and as large as
    /// what shines there, and none that is too dim to see.
    fn improved(&self, n: u32) -> Vec<DomeLight> {
        let directions = hemisphere(n);
        let assigned = self.assigned(&directions);
        let mut lights = Vec::with_capacity(directions.len());
        for cell in 0..directions.len() {
            let texels: Vec<usize> = assigned.iter().filter(|(_, c)| *c == cell).map(|(i, _)| *i).collect();
            let brightness = |i: usize| luminance(self.radiance.texels()[i]);
            let Some(brightest) = texels
                .iter()
                .copied()
                .max_by(|&a, &b| brightness(a).total_cmp(&brightness(b)))
            else {
                continue;
            };
            // What shines like the brightest spot stands for the cell's place; the rest of the cell goes with it.
            let (mut place, mut irradiance, mut area, mut distance_m) = (Vec3::ZERO, Vec3::ZERO, 0.0, f32::INFINITY);
            for &i in &texels {
                let texel_sr = self.radiance.solid_angle(i);
                irradiance += self.radiance.texels()[i] * texel_sr;
                if brightness(i) > 0.5 * brightness(brightest) {
                    place += self.radiance.direction(i) * texel_sr;
                    area += texel_sr;
                    distance_m = distance_m.min(self.distance_m.texels()[i]);
                }
            }
            let radius_rad = (1.0 - area / (2.0 * PI)).clamp(-1.0, 1.0).acos();
            lights.push(self.light(
                place.normalize_or(directions[cell]),
                irradiance,
                (distance_m, radius_rad),
            ));
        }
        let share =
            |light: &DomeLight| luminance(light.intensity) / (light.position_m - self.bounds.center_m).length_squared();
        let total: f32 = lights.iter().map(share).sum();
        lights.retain(|light| share(light) > DIM_SHARE * total);
        lights
    }

    /// As much light as there is on a surface that faces up, from everywhere alike.
    fn even(&self, n: u32) -> Vec<DomeLight> {
        let cells = self.cells(n);
        let upward: Vec3 = hemisphere(n)
            .iter()
            .zip(&cells)
            .map(|(d, cell)| cell.irradiance * d.z)
            .sum();
        let radius_rad = (1.0 - 1.0 / n as f32).acos();
        let each = upward / PI * (2.0 * PI / n as f32);
        hemisphere(n)
            .into_iter()
            .map(|direction| self.light(direction, each, (f32::INFINITY, radius_rad)))
            .collect()
    }

    /// Only what is brighter than the scene's base brightness casts shadows, so that their strength follows it.
    fn over_base(&self, n: u32) -> DomePlan {
        let cells = self.cells(n);
        let mut radiances: Vec<Vec3> = cells
            .iter()
            .map(|c| c.irradiance / c.solid_angle_sr.max(1e-6))
            .collect();
        radiances.sort_by(|a, b| luminance(*a).total_cmp(&luminance(*b)));
        let base = radiances
            .get((BASE_QUANTILE * n as f32) as usize)
            .copied()
            .unwrap_or(Vec3::ZERO);
        let lights = cells
            .into_iter()
            .map(|cell| {
                let excess = (cell.irradiance - base * cell.solid_angle_sr).max(Vec3::ZERO);
                let scale = excess / cell.irradiance.max(Vec3::splat(1e-9));
                DomeLight {
                    intensity: cell.light.intensity * scale,
                    ..cell.light
                }
            })
            .collect();
        DomePlan {
            lights,
            unshaded: PI * base,
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
            assert!(plan.lights.len() <= lights_max(method) as usize, "{method:?}");
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
