//! Real surfaces as light meters: what the probe's clipped pixels lost, and where the strong lights stand.
//!
//! An 8-bit picture of a lamp says only "at least this bright". White paper of known reflectance ρ beside it says how much
//! light there is in all: a Lambertian surface of radiance L receives E = π L / ρ. Every marker has a rim of such paper, at
//! its own place and tilt. Patches of the phantoms say it up to one factor per part, its unknown reflectance, which is
//! solved for along with the light: their differences are shading, shadows and the fall-off of lamps that stand near.
//!
//! For each reading the part of E that comes from elsewhere is gathered by casting rays through phantoms into the radiance
//! cube; the rest belongs to the strong regions, each weighted by its cosine, its distance and what phantoms leave of it.
//! The unknown radiances (never negative; per channel and clipped region one for even light, and for wide regions ramps
//! towards four sides) follow by least squares with Huber weights. Where several regions would explain the readings alike,
//! those lose that fade into their surroundings: a bright ceiling clips gently, a lamp has an edge.
//!
//! A region's distance is the one of a few candidates that explains the differences between the readings best: E falls with
//! the square of the distance, the cosine and the shadows follow the direction, and both change from place to place. A weak
//! preference for the room's distance decides where the readings cannot tell.
//!
//! The weights of preferences below (`RAMP_SIGMA`, `DISTANCE_PRIOR`, `PATCH_SIGMA`) were chosen on path-traced sequences
//! (BENCHMARKS.md).

mod least_squares;
mod shapes;
mod sight;
mod solve;
mod spots;

use std::f32::consts::PI;

use glam::{DVec3, Vec3};
use mirrorball_calib::probe::View;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::rig::Rig;
use rayon::prelude::*;

use super::clipped::StrongRegion;
use super::surroundings::NOTHING_M;
use crate::gpu::types::MAX_STRONG;
use crate::scene::occluders::Occluders;
use shapes::RegionShape;
use sight::Sight;
use solve::{Parts, Row, Rows};
use spots::{RAYS, Reflectance, Spot};

/// Regions beyond this number, by size, are left as the camera saw them.
pub const MAX_REGIONS: usize = MAX_STRONG;
/// Candidates for a distance, as multiples of the configured one: a third to twice and a half, 12 % apart.
const DISTANCE_FACTORS: [f32; 18] = [
    0.35, 0.39, 0.44, 0.49, 0.55, 0.62, 0.69, 0.78, 0.87, 0.98, 1.09, 1.23, 1.37, 1.54, 1.72, 1.93, 2.16, 2.42,
];
/// Candidates for a distance that is about known, as multiples of it.
const NEAR_FACTORS: [f32; 5] = [0.89, 0.945, 1.0, 1.06, 1.12];
/// Penalty for a region twice or half as far as the room, in squared standard deviations.
const DISTANCE_PRIOR: f32 = 6.0;
/// Regions that give less than this share of the light on the papers stand at the room's distance.
const NEAR_SHARE: f32 = 0.04;

/// Half angle from which on a light is wide, radians: its penumbrae show what it is made of.
const WIDE_RAD: f32 = 0.12;
/// Change of a wide light's direction or size after which its penumbrae are looked for anew, radians.
const REFOCUS_RAD: f32 = 0.06;
/// Places on a wide light that tell where its penumbrae are.
const PENUMBRA_PLACES: usize = 16;
/// Patches in penumbrae at most.
const MAX_PENUMBRA: usize = 200;

/// Radiance read off one spot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    spot: usize,
    /// Linear RGB.
    pub radiance: Vec3,
}

/// Where a strong light stands.
#[derive(Debug, Clone, PartialEq)]
pub struct StrongLight {
    /// Its texels in the cube.
    pub texels: Vec<usize>,
    /// Distance from the probe, metres.
    pub distance_m: f32,
    /// Standard deviation of the distance's logarithm; large where the readings cannot tell.
    pub distance_sigma: f32,
}

/// Radiance that clipping hid, in one pattern.
#[derive(Debug, Clone, PartialEq)]
pub struct MissingLight {
    /// Texels of the cube with their brightness in the pattern.
    pub texels: Vec<(usize, f32)>,
    /// Radiance of brightness 1, linear RGB; zero where a channel is not clipped.
    pub radiance: Vec3,
}

/// What the readings say about the light.
#[derive(Debug, Clone, PartialEq)]
pub struct MeterFit {
    /// Radiance to be added to the clipped regions, pattern by pattern.
    pub missing: Vec<MissingLight>,
    /// The strong regions, in the order they were given.
    pub lights: Vec<StrongLight>,
    /// Median of |measured - explained| / measured over the papers' readings and channels.
    pub residual: f32,
    /// Number of readings off papers.
    pub papers: usize,
    /// Number of readings off patches of phantoms.
    pub patches: usize,
}

/// The light known so far, with the places it comes from.
#[derive(Debug, Clone, Copy)]
pub struct KnownLight<'a> {
    /// The probe's place, world, metres.
    pub probe_m: Vec3,
    /// Light from afar in every direction.
    pub far: &'a Cube<Vec3>,
    /// What arrives at the probe, phantoms included.
    pub radiance: &'a Cube<Vec3>,
    /// Distance of the room from the probe, metres.
    pub room_m: f32,
}

impl KnownLight<'_> {
    /// Radiance that arrives at `point` from `direction`, which meets a phantom at `hit_m` or the room; nothing from the
    /// strong regions, which are `masked`.
    fn arriving(&self, point: Vec3, (direction, hit_m): (Vec3, f32), masked: &[bool]) -> Vec3 {
        let from_probe = point - self.probe_m;
        if hit_m < NOTHING_M {
            return self.radiance.nearest(from_probe + direction * hit_m);
        }
        let index = self
            .far
            .index_of(from_probe + direction * to_sphere(from_probe, direction, self.room_m));
        if masked[index] {
            Vec3::ZERO
        } else {
            self.far.texels()[index]
        }
    }
}

/// Distance along unit `direction` from `point` to the sphere of `radius` around the origin; `point` is taken as inside.
fn to_sphere(point: Vec3, direction: Vec3, radius: f32) -> f32 {
    let b = point.dot(direction);
    -b + (b * b + (radius * radius - point.length_squared()).max(1e-4)).sqrt()
}

/// All spots of a rig.
#[derive(Debug, Default)]
pub struct LightMeter {
    /// Spots that are read: those that always are first, then those chosen for the light as it is.
    spots: Vec<Spot>,
    n_always: usize,
    pool: Vec<Spot>,
    n_parts: usize,
    sights: Vec<Sight>,
    /// Direction and half angle of the wide light that the last spots were chosen for.
    focus: Option<(Vec3, f32)>,
}

impl LightMeter {
    /// Finds the spots and what their surroundings look like; once, as markers and phantoms stand still.
    ///
    /// `interest` are the points that light is wanted for, `mirrors` spheres (centre and radius, metres) that are no
    /// diffuse surfaces.
    #[must_use]
    pub fn new(rig: &Rig, occluders: &Occluders, interest: &[Vec3], mirrors: &[(Vec3, f32)]) -> Self {
        let spots = spots::find(rig, occluders, interest, mirrors);
        Self {
            sights: spots.always.iter().map(|_| Sight::default()).collect(),
            n_always: spots.always.len(),
            spots: spots.always,
            pool: spots.pool,
            n_parts: spots.n_parts,
            focus: None,
        }
    }

    /// Chooses patches in the penumbrae of the widest clipped light: what a phantom leaves of a window tells how bright its
    /// parts are. Nothing changes while that light stands still.
    pub fn focus_on(&mut self, regions: &[StrongRegion], light: KnownLight<'_>, occluders: &Occluders) {
        let wide = regions.iter().filter(|region| !region.core.is_empty());
        let widest = wide
            .map(|region| extent_of(region, light.far))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((direction, half_angle)) = widest.filter(|&(_, half_angle)| half_angle > WIDE_RAD) else {
            return;
        };
        let is_same = |&(before, angle): &(Vec3, f32)| {
            before.angle_between(direction) < REFOCUS_RAD && (angle - half_angle).abs() < REFOCUS_RAD
        };
        if self.focus.as_ref().is_some_and(is_same) {
            return;
        }
        self.focus = Some((direction, half_angle));
        let places = places_on(light.probe_m, (direction, half_angle), light.room_m);
        let is_penumbra = |spot: &&Spot| {
            let sees = |&&place: &&Vec3| {
                spot.normal.dot(place - spot.position_m) > 0.0 && !occluders.blocks(spot.origin_m(), place)
            };
            let open = places.iter().filter(sees).count();
            (2..=PENUMBRA_PLACES - 2).contains(&open)
        };
        let chosen: Vec<Spot> = self.pool.par_iter().filter(is_penumbra).cloned().collect();
        let stride = chosen.len().div_ceil(MAX_PENUMBRA).max(1);
        let mut chosen: Vec<Spot> = chosen.into_iter().step_by(stride).collect();
        chosen.par_iter_mut().for_each(|spot| spot.gather(occluders));
        self.spots.truncate(self.n_always);
        self.spots.extend(chosen);
        self.sights.truncate(self.n_always);
        self.sights.resize(self.spots.len(), Sight::default());
    }

    /// Reads every spot that the picture shows large enough, unclipped and not hidden by a phantom.
    #[must_use]
    pub fn read(&self, view: &View<'_>, occluders: &Occluders) -> Vec<Reading> {
        let eye = view.camera_from_world.inverse().translation.as_vec3();
        self.spots
            .par_iter()
            .enumerate()
            .filter_map(|(index, spot)| {
                let radiance = read_spot(spot, view, occluders, eye)?;
                (radiance.min_element() > 0.0).then_some(Reading { spot: index, radiance })
            })
            .collect()
    }

    /// Sets up the question what the readings say about `regions`, given the rest of the light.
    #[must_use]
    pub fn question(
        &mut self,
        readings: &[Reading],
        light: KnownLight<'_>,
        regions: &[StrongRegion],
        occluders: &Occluders,
    ) -> Question {
        let regions = &regions[..regions.len().min(MAX_REGIONS)];
        let mut masked = vec![false; light.far.texels().len()];
        for &texel in regions.iter().flat_map(|region| &region.texels) {
            masked[texel] = true;
        }
        let shapes: Vec<RegionShape> = regions
            .iter()
            .map(|region| RegionShape::new(region, light.far))
            .collect();
        let mut is_read = vec![None; self.spots.len()];
        for (k, reading) in readings.iter().enumerate() {
            is_read[reading.spot] = Some(k);
        }
        let mut rows: Vec<(usize, Row)> = self
            .spots
            .par_iter()
            .zip(&mut self.sights)
            .zip(&is_read)
            .filter_map(|((spot, sight), reading)| {
                let reading = (*reading)?;
                let gathered: Vec3 = spot
                    .rays
                    .iter()
                    .map(|&ray| light.arriving(spot.position_m, ray, &masked))
                    .sum();
                let visible = shapes
                    .iter()
                    .map(|shape| sight.of_region(shape, spot, light, occluders))
                    .collect();
                Some((
                    reading,
                    Row {
                        position_m: spot.position_m - light.probe_m,
                        normal: spot.normal,
                        reflectance: spot.reflectance,
                        leaving: readings[reading].radiance * PI,
                        known: gathered * (PI / RAYS as f32),
                        visible,
                    },
                ))
            })
            .collect();
        rows.sort_by_key(|&(reading, _)| reading);
        Question {
            texels: regions.iter().map(|region| region.texels.clone()).collect(),
            rows: Rows::new(rows.into_iter().map(|(_, row)| row).collect(), shapes, self.n_parts),
        }
    }
}

/// Middle of a region and the angle from there to its farthest texel.
fn extent_of(region: &StrongRegion, far: &Cube<Vec3>) -> (Vec3, f32) {
    let directions = || region.core.iter().map(|&i| far.direction(i));
    let middle = directions().sum::<Vec3>().normalize_or(Vec3::Z);
    (
        middle,
        directions().map(|d| d.angle_between(middle)).fold(0.0, f32::max),
    )
}

/// Places spread over a round light at `distance_m` from the probe (Vogel's spiral).
fn places_on(probe_m: Vec3, (direction, half_angle): (Vec3, f32), distance_m: f32) -> Vec<Vec3> {
    let golden_angle = PI * (3.0 - 5.0f32.sqrt());
    let across = direction.any_orthonormal_vector();
    let up = direction.cross(across);
    (0..PENUMBRA_PLACES)
        .map(|k| {
            let (sin, cos) = (k as f32 * golden_angle).sin_cos();
            let off = half_angle * ((k as f32 + 0.5) / PENUMBRA_PLACES as f32).sqrt();
            probe_m + (direction + (across * cos + up * sin) * off) * distance_m
        })
        .collect()
}

/// Mean radiance over a spot; `None` if it is too small in the picture, hidden or clipped.
fn read_spot(spot: &Spot, view: &View<'_>, occluders: &Occluders, eye: Vec3) -> Option<Vec3> {
    /// A narrower spot is mixed with what lies beside it.
    const MIN_WIDTH_PX: f64 = 3.0;
    /// Cosine of the flattest view of a surface; flatter ones mirror (Fresnel) and blur.
    const MIN_COSINE: f32 = 0.25;
    let pixel_of = |point: Vec3| {
        view.camera
            .intrinsics
            .project(view.camera_from_world.transform_point(DVec3::from(point)))
    };
    let is_patch = matches!(spot.reflectance, Reflectance::OfPart(_));
    if is_patch && (eye - spot.position_m).normalize().dot(spot.normal) < MIN_COSINE {
        return None;
    }
    if (pixel_of(spot.ends_m[1])? - pixel_of(spot.ends_m[0])?).length() < MIN_WIDTH_PX
        || occluders.blocks(eye, spot.origin_m())
    {
        return None;
    }
    let mut sum = Vec3::ZERO;
    for &place in &spot.places_m {
        let sample = view.picture.sample(pixel_of(place)?)?;
        if sample.clipped != 0 {
            return None;
        }
        sum += sample.radiance;
    }
    Some(sum / spot.places_m.len() as f32)
}

/// Readings, the light that is known, and the regions of which something is not.
pub struct Question {
    texels: Vec<Vec<usize>>,
    rows: Rows,
}

impl Question {
    /// Whether any paper was read: without one the scale of the light is unknown.
    #[must_use]
    pub fn can_tell(&self) -> bool {
        self.rows.n_papers() > 0
    }

    /// Distances of the regions, metres, with the standard deviation of their logarithms.
    ///
    /// Regions that are a part of something bright that goes on around them stand where the room does: their edges are the
    /// picture's, not a lamp's. Searched among all candidates around `room_m` where `expected_m` knows nothing (`None`), near the expected distance
    /// otherwise.
    #[must_use]
    pub fn distances_m(&self, room_m: f32, expected_m: &[Option<f32>]) -> Vec<(f32, f32)> {
        let mut distances: Vec<f32> = expected_m.iter().map(|e| e.unwrap_or(room_m)).collect();
        let mut sigmas = vec![f32::INFINITY; distances.len()];
        if !self.can_tell() {
            return distances.into_iter().zip(sigmas).collect();
        }
        let shares = self.rows.shares(&distances);
        let parts = self.rows.all_parts(&distances);
        // Twice, as the regions share the readings between them.
        for round in 0..2 {
            for region in 0..distances.len() {
                if shares[region] < NEAR_SHARE || self.rows.goes_on(region) {
                    distances[region] = room_m;
                    continue;
                }
                let is_known = round > 0 || expected_m[region].is_some();
                let near = is_known.then(|| {
                    let around = NEAR_FACTORS.map(|factor| distances[region] * factor);
                    self.best_distance((&distances, region), room_m, &around, &parts)
                });
                // A best distance at the end of those near by may be beyond it.
                (distances[region], sigmas[region]) = near.filter(|best| best.1.is_finite()).unwrap_or_else(|| {
                    let all = DISTANCE_FACTORS.map(|factor| room_m * factor);
                    self.best_distance((&distances, region), room_m, &all, &parts)
                });
            }
        }
        distances.into_iter().zip(sigmas).collect()
    }

    /// The best of the candidates for one region, the others held, with the standard deviation of its logarithm.
    fn best_distance(
        &self,
        (distances, region): (&[f32], usize),
        room_m: f32,
        candidates: &[f32],
        parts: &[Parts; 3],
    ) -> (f32, f32) {
        let costs: Vec<f32> = candidates
            .par_iter()
            .map(|&candidate| {
                let mut distances = distances.to_vec();
                distances[region] = candidate;
                self.rows.cost(&distances, parts) + DISTANCE_PRIOR * (candidate / room_m).log2().powi(2)
            })
            .collect();
        lowest(candidates, &costs)
    }

    /// The radiance that the regions lack when they stand at `distances_m` (with standard deviations).
    #[must_use]
    pub fn explain(&self, distances_m: &[(f32, f32)]) -> MeterFit {
        let distances: Vec<f32> = distances_m.iter().map(|d| d.0).collect();
        let (missing, residual) = self.rows.explain(&distances);
        MeterFit {
            missing,
            lights: self
                .texels
                .iter()
                .zip(distances_m)
                .map(|(texels, &(distance_m, distance_sigma))| StrongLight {
                    texels: texels.clone(),
                    distance_m,
                    distance_sigma,
                })
                .collect(),
            residual,
            papers: self.rows.n_papers(),
            patches: self.rows.n_patches(),
        }
    }
}

/// Where the costs are lowest, by a parabola over the logarithm of the three around the least, and the standard deviation
/// that its curvature stands for.
fn lowest(candidates: &[f32], costs: &[f32]) -> (f32, f32) {
    let least = (0..costs.len())
        .min_by(|&a, &b| costs[a].total_cmp(&costs[b]))
        .unwrap_or(0);
    if least == 0 || least + 1 >= costs.len() {
        return (candidates[least], f32::INFINITY);
    }
    let x = [least - 1, least, least + 1].map(|i| candidates[i].ln());
    let y = [least - 1, least, least + 1].map(|i| costs[i]);
    let slopes = [
        (y[1] - y[0]) / (x[1] - x[0]).max(1e-6),
        (y[2] - y[1]) / (x[2] - x[1]).max(1e-6),
    ];
    let curvature = 2.0 * (slopes[1] - slopes[0]) / (x[2] - x[0]).max(1e-6);
    if curvature <= 0.0 {
        return (candidates[least], f32::INFINITY);
    }
    // The slope is zero this far from the middle of the first interval.
    let at = 0.5 * (x[0] + x[1]) - slopes[0] / curvature;
    (at.clamp(x[0], x[2]).exp(), (2.0 / curvature).sqrt())
}

#[cfg(test)]
mod tests;
