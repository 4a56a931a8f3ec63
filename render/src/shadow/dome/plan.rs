//! Which lights each dome method draws.

use std::f32::consts::PI;

use glam::Vec3;
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;

use super::gather::Unshaded;
use super::lights::{DomeLight, hemisphere, stratified_cells};
use super::sight::RayMode;
use crate::shadow::ShadowMethod;

/// A light that gives less than this share of all light is too dim for its shadow to be seen (D13).
const DIM_SHARE: f32 = 0.002;
/// Part of the dome's cells that are darker than what counts as the scene's base brightness (D14).
const BASE_QUANTILE: f32 = 0.25;

/// The light around a scene.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a> {
    /// Radiance from every direction, linear RGB, world frame.
    pub radiance: &'a Cube<Vec3>,
    /// How far away it stands, metres; infinite where nothing is known.
    pub distance_m: &'a Cube<f32>,
    /// Where it is seen from.
    pub center_m: Vec3,
    /// Distance of what stands infinitely far away, metres.
    pub far_m: f32,
    /// The same light as a fixed dome and lights that follow the bright regions.
    pub stable: &'a [KeyLight],
    /// One light alone, and irradiance of all the rest.
    pub hand: (DomeLight, Vec3),
}

/// What a dome method draws.
#[derive(Debug, Clone, PartialEq)]
pub struct DomePlan {
    /// The lights.
    pub lights: Vec<DomeLight>,
    /// Irradiance that nothing shades.
    pub unshaded: Vec3,
}

impl ShadowMethod {
    /// Most lights that a dome method uses beside those of [`ShadowMethod::Stable`].
    #[must_use]
    pub fn dome_lights(self) -> u32 {
        match self {
            Self::Dome16 => 16,
            Self::Dome256 => 256,
            Self::Hand => 1,
            _ => 64,
        }
    }

    /// How a dome method's rays look for what is in the way.
    #[must_use]
    pub fn ray_mode(self) -> RayMode {
        match self {
            Self::AmbientOcclusion | Self::DomeImproved | Self::Stable => RayMode::Soft,
            _ => RayMode::Hard,
        }
    }

    /// Where a dome method's unshaded light comes from.
    #[must_use]
    pub fn unshaded_from(self) -> Unshaded {
        match self {
            Self::BaseBrightness => Unshaded::Above,
            _ => Unshaded::Everywhere,
        }
    }
}

/// The lights of a dome method.
#[must_use]
pub fn plan(method: ShadowMethod, around: &Surroundings<'_>) -> DomePlan {
    let n = method.dome_lights();
    let of = |lights| DomePlan {
        lights,
        unshaded: Vec3::ZERO,
    };
    match method {
        ShadowMethod::Hand => DomePlan {
            lights: vec![around.hand.0],
            unshaded: around.hand.1,
        },
        ShadowMethod::AmbientOcclusion => of(around.even(n)),
        ShadowMethod::DomeImproved => of(around.improved(n)),
        ShadowMethod::BaseBrightness => around.over_base(n),
        ShadowMethod::Stable => of(around.stable.iter().map(|l| around.of_key_light(l)).collect()),
        _ => of(around.cells(n).into_iter().map(|cell| cell.light).collect()),
    }
}

/// One cell of a dome.
struct Cell {
    light: DomeLight,
    /// Irradiance that a surface facing it gets.
    irradiance: Vec3,
    solid_angle_sr: f32,
}

impl Surroundings<'_> {
    fn of_key_light(&self, light: &KeyLight) -> DomeLight {
        self.light(
            light.direction,
            light.irradiance,
            (light.distance_m, light.angular_radius_rad),
        )
    }

    /// A light in a direction at `distance_m`, no farther than everything else.
    fn light(&self, direction: Vec3, irradiance: Vec3, (distance_m, angular_radius_rad): (f32, f32)) -> DomeLight {
        let distance_m = distance_m.min(self.far_m);
        DomeLight {
            position_m: self.center_m + direction * distance_m,
            intensity: irradiance * distance_m * distance_m,
            angular_radius_rad,
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
        let radius_rad = cell_radius_rad(n);
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
        let mut texels_of = vec![Vec::new(); directions.len()];
        for (index, cell) in self.assigned(&directions) {
            texels_of[cell].push(index);
        }
        let brightness = |i: usize| luminance(self.radiance.texels()[i]);
        let mut lights = Vec::with_capacity(directions.len());
        for (texels, &direction) in texels_of.iter().zip(&directions) {
            let brightest = texels.iter().map(|&i| brightness(i)).fold(0.0, f32::max);
            // What shines like the brightest spot stands for the cell's place; the rest of the cell goes with it.
            let (mut place, mut irradiance, mut area, mut distance_m) = (Vec3::ZERO, Vec3::ZERO, 0.0, f32::INFINITY);
            for &i in texels {
                let texel_sr = self.radiance.solid_angle(i);
                irradiance += self.radiance.texels()[i] * texel_sr;
                if brightness(i) > 0.5 * brightest {
                    place += self.radiance.direction(i) * texel_sr;
                    area += texel_sr;
                    distance_m = distance_m.min(self.distance_m.texels()[i]);
                }
            }
            let radius_rad = (1.0 - area / (2.0 * PI)).clamp(-1.0, 1.0).acos();
            lights.push(self.light(place.normalize_or(direction), irradiance, (distance_m, radius_rad)));
        }
        let share =
            |light: &DomeLight| luminance(light.intensity) / (light.position_m - self.center_m).length_squared();
        let total: f32 = lights.iter().map(share).sum();
        lights.retain(|light| share(light) > DIM_SHARE * total);
        lights
    }

    /// As much light as there is on a surface that faces up, from everywhere alike.
    fn even(&self, n: u32) -> Vec<DomeLight> {
        let directions = hemisphere(n);
        let upward: Vec3 = directions
            .iter()
            .zip(self.cells(n))
            .map(|(direction, cell)| cell.irradiance * direction.z)
            .sum();
        let each = upward / PI * (2.0 * PI / n as f32);
        directions
            .into_iter()
            .map(|direction| self.light(direction, each, (f32::INFINITY, cell_radius_rad(n))))
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

/// Half the angle that one of `n` cells of the hemisphere fills, radians.
fn cell_radius_rad(n: u32) -> f32 {
    (1.0 - 1.0 / n as f32).acos()
}
