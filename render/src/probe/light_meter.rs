//! The paper around the markers as a light meter: what the probe's clipped pixels lost, and how far away the room is.
//!
//! An 8-bit picture of a lamp says only "at least this bright". White paper of known reflectance ρ beside it says how much
//! light there is in all: a Lambertian surface of radiance L receives E = π L / ρ. Every marker has a rim of such paper, at
//! its own place and tilt. For each reading the part of E that comes from unclipped directions is gathered by casting
//! rays through phantoms into the radiance cube; what is missing belongs to the clipped regions, each weighted by its
//! cosine, its distance and what phantoms leave of it. The unknown radiances (never negative; per channel and region one
//! for even light, and for wide regions ramps towards four sides) follow by least squares with Huber weights. Where several
//! regions would explain the readings alike, those lose that fade into their surroundings: a bright ceiling clips gently, a
//! lamp has an edge. The room's distance is the one of a few candidates that explains the differences between the readings
//! best, with a weak preference for the configured one.
//!
//! The weights of preferences below (`RAMP_SIGMA`, `DISTANCE_PRIOR`) were chosen on four path-traced sequences; the
//! light's direction changes by 0.2° when the first is tripled and not at all when the second is five times as large
//! (BENCHMARKS.md).

use std::f32::consts::PI;

use glam::{DVec3, Mat3, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::{Camera, Marker, Rig};
use rayon::prelude::*;

use super::clipped::{ClippedRegion, Price};
use super::least_squares::Unknowns;
use super::surroundings::NOTHING_M;
use crate::scene::occluders::Occluders;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::Picture;

/// Rays per reading that gather the unclipped light.
const RAYS: usize = 256;
/// Most texels of a region that stand for it.
const REGION_SAMPLES: usize = 48;
/// Half width from which on a region's light may rise towards a side, radians.
const RAMP_RAD: f32 = 0.15;
/// Standard deviation of such a rise, and of the even light then, relative to the region's even light.
const RAMP_SIGMA: f32 = 0.5;
/// Relative standard deviation expected of a reading: paper, noise, gathering.
const READING_SIGMA: f32 = 0.03;
/// Regions beyond this number, by size, are left as the camera saw them.
const MAX_REGIONS: usize = 6;
/// Candidates for the room's distance, as multiples of the configured one: a third to twice and a half, 12 % apart.
const DISTANCE_FACTORS: [f32; 18] = [
    0.35, 0.39, 0.44, 0.49, 0.55, 0.62, 0.69, 0.78, 0.87, 0.98, 1.09, 1.23, 1.37, 1.54, 1.72, 1.93, 2.16, 2.42,
];
/// Penalty for a room twice or half as far as configured, in squared standard deviations.
const DISTANCE_PRIOR: f32 = 6.0;

/// White paper at one place.
#[derive(Debug, Clone)]
struct Paper {
    position_m: Vec3,
    normal: Vec3,
    along: Vec3,
    reflectance: f32,
    /// Width of the white rim, metres.
    rim_m: f32,
    /// Directions, cosine-distributed about the normal, and what they meet.
    rays: Vec<(Vec3, f32)>,
}

/// Irradiance read off one paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    paper: usize,
    /// Linear RGB.
    pub irradiance: Vec3,
}

/// What the papers say about the light.
#[derive(Debug, Clone, PartialEq)]
pub struct MeterFit {
    /// Radiance to be added to texels of the clipped regions, pattern by pattern: texels with their brightness, and the
    /// radiance of brightness 1; zero where a channel is not clipped.
    pub missing: Vec<(Vec<(usize, f32)>, Vec3)>,
    /// Distance of the room from the probe, metres.
    pub room_m: f32,
    /// Median of |measured - explained| / measured over readings and channels.
    pub residual: f32,
    /// Number of readings.
    pub readings: usize,
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
}

impl KnownLight<'_> {
    /// Radiance that arrives at `point` from `direction`, which meets a phantom at `hit_m` or the room at `room_m`.
    fn arriving(&self, point: Vec3, direction: Vec3, hit_m: f32, room_m: f32) -> Vec3 {
        let from_probe = point - self.probe_m;
        if hit_m < NOTHING_M {
            return self.radiance.nearest(from_probe + direction * hit_m);
        }
        self.far
            .nearest(from_probe + direction * to_sphere(from_probe, direction, room_m))
    }
}

/// Distance along unit `direction` from `point` to the sphere of `radius` around the origin; `point` is taken as inside.
fn to_sphere(point: Vec3, direction: Vec3, radius: f32) -> f32 {
    let b = point.dot(direction);
    -b + (b * b + (radius * radius - point.length_squared()).max(1e-4)).sqrt()
}

/// All papers of a rig.
#[derive(Debug, Clone, Default)]
pub struct LightMeter {
    papers: Vec<Paper>,
}

impl LightMeter {
    /// Finds the papers and what their surroundings look like; once, as markers and phantoms stand still.
    #[must_use]
    pub fn new(rig: &Rig, occluders: &Occluders) -> Self {
        let places: Vec<Paper> = rig.markers.iter().flat_map(papers_of).collect();
        let papers = places
            .into_par_iter()
            .map(|mut paper| {
                let origin = paper.position_m + paper.normal * 1e-3;
                paper.rays = cosine_directions(paper.normal)
                    .map(|d| (d, occluders.distance_m(origin, d, 1e-3).unwrap_or(NOTHING_M)))
                    .collect();
                paper
            })
            .collect();
        Self { papers }
    }

    /// Reads every paper that the picture shows large enough, unclipped and not hidden by a phantom.
    #[must_use]
    pub fn read(
        &self,
        picture: &Picture<'_>,
        camera: &Camera,
        camera_from_world: &Pose,
        occluders: &Occluders,
    ) -> Vec<Reading> {
        const OFFSETS: [f32; 3] = [-0.2, 0.0, 0.2];
        const MIN_RIM_PX: f64 = 3.0;
        let eye = camera_from_world.inverse().translation.as_vec3();
        let pixel_of = |point: Vec3| {
            camera
                .intrinsics
                .project(camera_from_world.transform_point(DVec3::from(point)))
        };
        let read_one = |paper: &Paper| -> Option<Vec3> {
            let across = paper.normal.cross(paper.along);
            let edge = |side: f32| pixel_of(paper.position_m + across * (side * 0.5 * paper.rim_m));
            if (edge(1.0)? - edge(-1.0)?).length() < MIN_RIM_PX
                || occluders.blocks(eye, paper.position_m + paper.normal * 1e-3)
            {
                return None;
            }
            let mut sum = Vec3::ZERO;
            for offset in OFFSETS {
                let sample = picture.sample(pixel_of(paper.position_m + paper.along * (offset * paper.rim_m))?)?;
                if sample.clipped != 0 {
                    return None;
                }
                sum += sample.radiance;
            }
            Some(sum * (PI / (OFFSETS.len() as f32 * paper.reflectance)))
        };
        self.papers
            .iter()
            .enumerate()
            .filter_map(|(paper, place)| {
                Some(Reading {
                    paper,
                    irradiance: read_one(place)?,
                })
            })
            .filter(|reading| reading.irradiance.min_element() > 0.0)
            .collect()
    }

    /// Sets up the question what the readings say about `regions`, given the rest of the light.
    #[must_use]
    pub fn question<'a>(
        &'a self,
        readings: &'a [Reading],
        light: KnownLight<'a>,
        regions: &[ClippedRegion],
        occluders: &Occluders,
    ) -> Question<'a> {
        let shapes: Vec<Shape> = regions
            .iter()
            .take(MAX_REGIONS)
            .enumerate()
            .flat_map(|(index, region)| shapes_of(index, region, light.far))
            .collect();
        let visible = readings
            .par_iter()
            .map(|reading| {
                let paper = &self.papers[reading.paper];
                let from = paper.position_m + paper.normal * 1e-3;
                let sees = |&(d, _): &(Vec3, f32)| !occluders.blocks(from, light.probe_m + d * SHADOW_DISTANCE_M);
                shapes
                    .iter()
                    .map(|shape| shape.samples.iter().map(sees).collect())
                    .collect()
            })
            .collect();
        Question {
            meter: self,
            readings,
            light,
            n_regions: regions.len().min(MAX_REGIONS),
            shapes,
            visible,
        }
    }
}

/// Distance at which lamps are looked for behind phantoms; the direction matters, the distance hardly.
const SHADOW_DISTANCE_M: f32 = 1.5;

/// Readings, the light that is known, and the regions whose radiance is not.
pub struct Question<'a> {
    meter: &'a LightMeter,
    readings: &'a [Reading],
    light: KnownLight<'a>,
    n_regions: usize,
    shapes: Vec<Shape>,
    /// Per reading, shape and sample of the shape: whether the paper sees it past the phantoms.
    visible: Vec<Vec<Vec<bool>>>,
}

impl Question<'_> {
    /// Distance of the room, metres, that explains the readings best; `room_m` without readings.
    #[must_use]
    pub fn room_m(&self, room_m: f32) -> f32 {
        if self.readings.is_empty() {
            return room_m;
        }
        let cost = |factor: f32| {
            solve(&self.rows(room_m * factor), &self.shapes, self.n_regions).0 + DISTANCE_PRIOR * factor.log2().powi(2)
        };
        DISTANCE_FACTORS
            .into_iter()
            .map(|factor| (factor, cost(factor)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(room_m, |(factor, _)| room_m * factor)
    }

    /// The radiance that the regions lack when the room is at `room_m`; none without readings.
    #[must_use]
    pub fn explain(&self, room_m: f32) -> MeterFit {
        let (_, missing, residual) = solve(&self.rows(room_m), &self.shapes, self.n_regions);
        let texels = self.shapes.iter().zip(&missing);
        MeterFit {
            missing: texels
                .map(|(shape, &radiance)| (shape.texels.clone(), radiance))
                .collect(),
            room_m,
            residual,
            readings: self.readings.len(),
        }
    }

    fn rows(&self, room_m: f32) -> Vec<Row> {
        self.readings
            .par_iter()
            .zip(&self.visible)
            .map(|(reading, visible)| self.row(reading, visible, room_m))
            .collect()
    }

    fn row(&self, reading: &Reading, visible: &[Vec<bool>], room_m: f32) -> Row {
        let paper = &self.meter.papers[reading.paper];
        let gathered: Vec3 = paper
            .rays
            .iter()
            .map(|&(d, hit_m)| self.light.arriving(paper.position_m, d, hit_m, room_m))
            .sum();
        let from_sample = |d: Vec3, area_sr: f32| {
            let to_light = self.light.probe_m + d * room_m - paper.position_m;
            let distance = to_light.length();
            area_sr * (paper.normal.dot(to_light) / distance).max(0.0) * (room_m / distance).powi(2)
        };
        let response = self
            .shapes
            .iter()
            .zip(visible)
            .map(|(shape, visible)| {
                let seen = shape.samples.iter().zip(visible).filter(|(_, seen)| **seen);
                seen.map(|((d, area_sr), _)| from_sample(*d, *area_sr)).sum()
            })
            .collect();
        Row {
            measured: reading.irradiance,
            known: gathered * (PI / RAYS as f32),
            response,
        }
    }
}

/// Four strips of the white rim of a marker, three papers each, one cell outside the black square.
fn papers_of(marker: &Marker) -> Vec<Paper> {
    let pose = crate::scene::affine(&marker.world_from_marker);
    let side = marker.side_m as f32;
    // A tag36h11 is eight cells wide inside one white cell all round (AprilRobotics' layout).
    let rim_m = side / 8.0;
    let outwards = 0.5 * side + 0.5 * rim_m;
    let mut papers = Vec::with_capacity(12);
    for (out, along) in [
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
        (Vec3::Y, Vec3::X),
        (Vec3::NEG_Y, Vec3::X),
    ] {
        for place in [-0.35, 0.0, 0.35] {
            papers.push(Paper {
                position_m: pose.transform_point3(out * outwards + along * (place * side)),
                normal: pose.transform_vector3(Vec3::Z),
                along: pose.transform_vector3(along),
                reflectance: marker.white_reflectance as f32,
                rim_m,
                rays: Vec::new(),
            });
        }
    }
    papers
}

/// Directions about `normal` whose density is proportional to the cosine (Malley's method over a Fibonacci spiral).
fn cosine_directions(normal: Vec3) -> impl Iterator<Item = Vec3> {
    let tangent = normal.any_orthonormal_vector();
    let world_from_surface = Mat3::from_cols(tangent, normal.cross(tangent), normal);
    let golden_angle = PI * (3.0 - 5.0f32.sqrt());
    (0..RAYS).map(move |i| {
        let r2 = (i as f32 + 0.5) / RAYS as f32;
        let (sin, cos) = (golden_angle * i as f32).sin_cos();
        world_from_surface * Vec3::new(r2.sqrt() * cos, r2.sqrt() * sin, (1.0 - r2).sqrt())
    })
}

/// A pattern of light over a region: one unknown per channel.
struct Shape {
    /// The region that it belongs to.
    region: usize,
    /// Whether it is the region's own even pattern, or a ramp added to it.
    is_even: bool,
    /// All its texels with their brightness in the pattern.
    texels: Vec<(usize, f32)>,
    /// Directions from the probe of some of them; the solid angle each stands for, times its brightness.
    samples: Vec<(Vec3, f32)>,
    channels: [bool; 3],
    price: Price,
}

/// What is expected of a large clipped region, up to scale: a window shows the CIE standard overcast sky, 1 + 2 sin of the
/// elevation (Moon and Spencer 1942); higher than 45° it is a ceiling or a roof light, as bright everywhere.
fn overcast_sky(direction: Vec3) -> f32 {
    1.0 + 2.0 * direction.z.clamp(0.0, std::f32::consts::FRAC_1_SQRT_2)
}

/// Patterns that a region's light may be made of: the sky's, and for wide regions ramps towards four sides.
fn shapes_of(index: usize, region: &ClippedRegion, cube: &Cube<Vec3>) -> Vec<Shape> {
    let shape = |is_even: bool, brightness: &dyn Fn(Vec3) -> f32| {
        let texels: Vec<(usize, f32)> = region
            .texels
            .iter()
            .map(|&i| (i, brightness(cube.direction(i))))
            .collect();
        Shape::new((index, is_even), texels, region, cube)
    };
    let mut shapes = vec![shape(true, &overcast_sky)];
    let middle = region
        .texels
        .iter()
        .map(|&i| cube.direction(i))
        .sum::<Vec3>()
        .normalize_or(Vec3::Z);
    let first = middle.any_orthonormal_vector();
    for side in [first, -first, middle.cross(first), middle.cross(-first)] {
        let reach = |&i: &usize| cube.direction(i).dot(side).abs();
        let widest = region.texels.iter().map(reach).fold(0.0, f32::max);
        if widest > RAMP_RAD {
            shapes.push(shape(false, &|direction| {
                overcast_sky(direction) * (1.0 + direction.dot(side) / widest)
            }));
        }
    }
    shapes
}

impl Shape {
    fn new(
        (region_index, is_even): (usize, bool),
        mut texels: Vec<(usize, f32)>,
        region: &ClippedRegion,
        cube: &Cube<Vec3>,
    ) -> Self {
        let area = |texels: &[(usize, f32)]| texels.iter().map(|&(i, _)| cube.solid_angle(i)).sum::<f32>();
        let lit = |texels: &[(usize, f32)]| texels.iter().map(|&(i, b)| b * cube.solid_angle(i)).sum::<f32>();
        // Mean brightness 1, so that the unknowns of a region mean the same.
        let mean = lit(&texels) / area(&texels).max(f32::MIN_POSITIVE);
        for (_, brightness) in &mut texels {
            *brightness /= mean.max(f32::MIN_POSITIVE);
        }
        let stride = texels.len().div_ceil(REGION_SAMPLES).max(1);
        let picked: Vec<(usize, f32)> = texels.iter().copied().step_by(stride).collect();
        let scale = lit(&texels) / lit(&picked).max(f32::MIN_POSITIVE);
        Self {
            region: region_index,
            is_even,
            samples: picked
                .iter()
                .map(|&(i, b)| (cube.direction(i), b * cube.solid_angle(i) * scale))
                .collect(),
            texels,
            channels: region.channels,
            price: region.price,
        }
    }
}

/// One equation: measured = known + Σ response · unknown.
struct Row {
    measured: Vec3,
    known: Vec3,
    response: Vec<f32>,
}

/// Solves for the missing radiance of every shape, each channel by itself: first the even pattern of each region, then
/// ramps of about [`RAMP_SIGMA`] of it. Returns the cost in squared deviations, the radiances,
/// and the median relative residual.
fn solve(rows: &[Row], shapes: &[Shape], n_regions: usize) -> (f32, Vec<Vec3>, f32) {
    let mut missing = vec![Vec3::ZERO; shapes.len()];
    let mut cost = 0.0;
    let mut residuals = Vec::with_capacity(3 * rows.len());
    for channel in 0..3 {
        let whole = Unknowns::of_regions(rows, shapes, n_regions, channel);
        let regions = whole.solve(unexplained(rows, channel));
        let split = Unknowns::of_shapes(rows, shapes, &regions.values, channel);
        let solution = split.solve(unexplained(rows, channel));
        cost += solution.cost;
        residuals.extend(solution.deviations.iter().map(|off| off.abs() * READING_SIGMA));
        for (radiance, value) in missing.iter_mut().zip(&solution.values) {
            radiance[channel] = *value;
        }
    }
    residuals.sort_by(f32::total_cmp);
    (
        cost,
        missing,
        residuals.get(residuals.len() / 2).copied().unwrap_or(0.0),
    )
}

/// What the known light leaves of every reading, in standard deviations.
fn unexplained(rows: &[Row], channel: usize) -> Vec<f32> {
    let of_row = |row: &Row| (row.measured[channel] - row.known[channel]) / (READING_SIGMA * row.measured[channel]);
    rows.iter().map(of_row).collect()
}

impl Unknowns {
    fn of_regions(rows: &[Row], shapes: &[Shape], n_regions: usize, channel: usize) -> Self {
        let mut slopes = vec![vec![0.0; rows.len()]; n_regions];
        let mut prices = vec![Price::NONE; n_regions];
        for (k, shape) in shapes
            .iter()
            .enumerate()
            .filter(|(_, shape)| shape.is_even && shape.channels[channel])
        {
            prices[shape.region] = shape.price;
            for (slope, row) in slopes[shape.region].iter_mut().zip(rows) {
                *slope += row.response[k] / (READING_SIGMA * row.measured[channel]);
            }
        }
        Self {
            slopes,
            prices,
            priors: vec![(0.0, 0.0); n_regions],
        }
    }

    fn of_shapes(rows: &[Row], shapes: &[Shape], regions: &[f32], channel: usize) -> Self {
        let slope = |k: usize, shape: &Shape, row: &Row| {
            if shape.channels[channel] {
                row.response[k] / (READING_SIGMA * row.measured[channel])
            } else {
                0.0
            }
        };
        Self {
            slopes: shapes
                .iter()
                .enumerate()
                .map(|(k, shape)| rows.iter().map(|row| slope(k, shape, row)).collect())
                .collect(),
            prices: shapes.iter().map(|shape| shape.price).collect(),
            priors: shapes
                .iter()
                .map(|shape| {
                    let even = regions[shape.region];
                    let expected = if shape.is_even { even } else { 0.0 };
                    (expected, 1.0 / (RAMP_SIGMA * even).max(1e-6).powi(2))
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Papers facing up and tilted, around the origin, under a lamp at a known place.
    fn readings_under_lamp(lamp_m: Vec3, intensity: f32, ambient: f32) -> (LightMeter, Vec<Reading>) {
        let mut papers = Vec::new();
        for x in [-0.25f32, -0.1, 0.1, 0.25] {
            for normal in [Vec3::Z, Vec3::new(0.0, 0.6, 0.8), Vec3::new(0.5, 0.0, 0.866)] {
                papers.push(Paper {
                    position_m: Vec3::new(x, 0.5 * x, 0.0),
                    normal,
                    along: Vec3::X,
                    reflectance: 0.8,
                    rim_m: 0.005,
                    rays: cosine_directions(normal).map(|d| (d, NOTHING_M)).collect(),
                });
            }
        }
        let readings = papers
            .iter()
            .enumerate()
            .map(|(paper, p)| {
                let to_lamp = lamp_m - p.position_m;
                let e = intensity * p.normal.dot(to_lamp).max(0.0) / to_lamp.length().powi(3) + PI * ambient;
                Reading {
                    paper,
                    irradiance: Vec3::splat(e),
                }
            })
            .collect();
        (LightMeter { papers }, readings)
    }

    #[test]
    fn a_clipped_lamp_gets_its_energy_and_its_distance_back() {
        let (probe_m, distance) = (Vec3::new(0.2, 0.1, 0.05), 1.1f32);
        let direction = Vec3::new(-0.5, 0.4, 0.77).normalize();
        let (meter, readings) = readings_under_lamp(probe_m + direction * distance, 3.0, 0.3);
        let mut far = Cube::filled(64, Vec3::splat(0.3));
        let texels: Vec<usize> = (0..far.texels().len())
            .filter(|&i| far.direction(i).dot(direction) > 2f32.to_radians().cos())
            .collect();
        for &i in &texels {
            far.texels_mut()[i] = Vec3::ONE;
        }
        let area_sr: f32 = texels.iter().map(|&i| far.solid_angle(i)).sum();
        let regions = [ClippedRegion {
            texels,
            channels: [true; 3],
            price: Price::NONE,
        }];
        let light = KnownLight {
            probe_m,
            far: &far,
            radiance: &far,
        };
        let nothing = Occluders::default();
        let question = meter.question(&readings, light, &regions, &nothing);
        let fit = question.explain(question.room_m(2.0));
        let missing: f32 = fit
            .missing
            .iter()
            .flat_map(|(t, l)| t.iter().map(|&(i, b)| b * l.x * far.solid_angle(i)))
            .sum();
        let energy = missing + area_sr;
        let expected = 3.0 / (distance * distance);
        assert!((fit.room_m / distance - 1.0).abs() < 0.15, "{fit:?}");
        assert!((energy / expected - 1.0).abs() < 0.1, "{energy} {expected} {fit:?}");
        assert!(fit.residual < 0.02, "{fit:?}");
    }

    #[test]
    fn without_papers_nothing_is_missing() {
        let far = Cube::filled(16, Vec3::ONE);
        let light = KnownLight {
            probe_m: Vec3::ZERO,
            far: &far,
            radiance: &far,
        };
        let regions = [ClippedRegion {
            texels: vec![0, 1],
            channels: [true; 3],
            price: Price::NONE,
        }];
        let (meter, nothing) = (LightMeter::default(), Occluders::default());
        let question = meter.question(&[], light, &regions, &nothing);
        let fit = question.explain(question.room_m(2.0));
        assert!(fit.missing.iter().all(|(_, radiance)| *radiance == Vec3::ZERO));
        assert_eq!((fit.room_m, fit.readings), (2.0, 0));
    }
}
