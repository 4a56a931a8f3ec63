//! The readings as equations, and their solution.

use glam::Vec3;

use super::super::clipped::Price;
use super::MissingLight;
use super::least_squares::{Solution, Unknowns};
use super::shapes::{PatternKind, RegionShape, Sample};
use super::spots::Reflectance;

/// Relative standard deviation expected of a reading off paper: paper, noise, gathering.
const PAPER_SIGMA: f32 = 0.03;
/// Least relative standard deviation of a patch.
const PATCH_SIGMA: f32 = 0.05;
/// Neighbouring patches share the grain of their material, so each counts for less than it would alone.
const SHARED_GRAIN: f32 = 1.0;
/// Parts whose patches scatter more than this tell nothing.
const MAX_SCATTER: f32 = 0.5;
/// Standard deviation of a window's band relative to the even light: ground below a horizon is a tenth as bright as the sky.
const BAND_SIGMA: f32 = 0.7;
/// Standard deviation of a region's radiance from that of its measured surroundings, relative to the latter.
///
/// Small, since papers err alike: sixty readings that are each good to 3 % do not average to 0.4 %.
const BEYOND_SIGMA: f32 = 0.05;
/// Standard deviation of a ramp, and of the even light then, relative to the region's even light.
const RAMP_SIGMA: f32 = 0.5;

/// One reading: leaving · u = known + Σ response · unknown, where u is 1 / reflectance.
pub(super) struct Row {
    /// Place relative to the probe, metres.
    pub(super) position_m: Vec3,
    pub(super) normal: Vec3,
    pub(super) reflectance: Reflectance,
    /// π times its radiance.
    pub(super) leaving: Vec3,
    /// Irradiance from everything but the strong regions.
    pub(super) known: Vec3,
    /// Per region and sample: whether it is seen past the phantoms.
    pub(super) visible: Vec<Vec<bool>>,
}

impl Row {
    /// Irradiance per unit of radiance that a sample gives, the region being at `distance_m`.
    fn response(&self, sample: &Sample, distance_m: f32) -> f32 {
        let to_light = sample.direction * distance_m - self.position_m;
        let squared = to_light.length_squared().max(1e-6);
        let cosine = (self.normal.dot(to_light) / squared.sqrt()).max(0.0);
        sample.area_sr * cosine * distance_m * distance_m / squared
    }
}

/// What the patches of a part are good for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// Diffuse reflectance per channel, roughly.
    reflectance: Vec3,
    /// Relative standard deviation of a patch.
    sigma: f32,
}

/// The parts of the phantoms; `None` for those that tell nothing.
pub(super) type Parts = Vec<Option<Part>>;

/// All readings with the regions that they are asked about.
pub(super) struct Rows {
    rows: Vec<Row>,
    shapes: Vec<RegionShape>,
    n_parts: usize,
    /// First unknown of every region, and the number of them all.
    firsts: Vec<usize>,
    n_patterns: usize,
}

/// What the regions give to every reading at given distances.
struct Responses {
    /// Per row: irradiance that the regions are known to give.
    known: Vec<Vec3>,
    /// Per row: irradiance per unit of every pattern.
    patterns: Vec<Vec<f32>>,
}

impl Rows {
    pub(super) fn new(rows: Vec<Row>, shapes: Vec<RegionShape>, n_parts: usize) -> Self {
        let mut firsts = Vec::with_capacity(shapes.len());
        let mut n_patterns = 0;
        for shape in &shapes {
            firsts.push(n_patterns);
            n_patterns += shape.patterns.len();
        }
        Self {
            rows,
            shapes,
            n_parts,
            firsts,
            n_patterns,
        }
    }

    pub(super) fn n_papers(&self) -> usize {
        self.rows.iter().filter(|row| is_paper(row)).count()
    }

    pub(super) fn n_patches(&self) -> usize {
        self.rows.len() - self.n_papers()
    }

    /// Whether the surroundings of a region are about as bright as it.
    pub(super) fn goes_on(&self, region: usize) -> bool {
        self.shapes[region].expected.is_some()
    }

    /// Share of every region in the light on the papers.
    pub(super) fn shares(&self, distances_m: &[f32]) -> Vec<f32> {
        let responses = self.responses(distances_m);
        let values = self.solve(1, &responses, &vec![None; self.n_parts]).1.values;
        let total: f32 = self
            .rows
            .iter()
            .filter(|row| is_paper(row))
            .map(|row| row.leaving.y)
            .sum();
        (0..self.shapes.len())
            .map(|region| {
                let of_row = |(k, row): (usize, &Row)| {
                    let Reflectance::Known(reflectance) = row.reflectance else {
                        return 0.0;
                    };
                    let unknown: f32 = self
                        .unknowns_of(region)
                        .map(|i| responses.patterns[k][i] * values[i])
                        .sum();
                    reflectance * (self.known_of(row, region, distances_m[region]).y + unknown)
                };
                self.rows.iter().enumerate().map(of_row).sum::<f32>() / total.max(f32::MIN_POSITIVE)
            })
            .collect()
    }

    /// What the parts are good for, channel by channel, with the regions at about these distances.
    pub(super) fn all_parts(&self, distances_m: &[f32]) -> [Parts; 3] {
        let responses = self.responses(distances_m);
        [0, 1, 2].map(|channel| self.parts(&responses, channel))
    }

    /// Cost of the best explanation by even light with the regions at these distances, in squared standard deviations.
    pub(super) fn cost(&self, distances_m: &[f32], parts: &[Parts; 3]) -> f32 {
        let responses = self.responses(distances_m);
        let of_channel = |(channel, parts): (usize, &Parts)| {
            let offsets = self.offsets(channel, &responses, parts);
            self.unknowns(channel, &responses, parts, None).solve(&offsets).cost
        };
        parts.iter().enumerate().map(of_channel).sum()
    }

    /// Missing radiance of every pattern, and the papers' median relative residual.
    pub(super) fn explain(&self, distances_m: &[f32]) -> (Vec<MissingLight>, f32) {
        let responses = self.responses(distances_m);
        let mut missing = vec![Vec3::ZERO; self.n_patterns];
        let mut residuals = Vec::new();
        for channel in 0..3 {
            let parts = self.parts(&responses, channel);
            let (_, solution) = self.solve(channel, &responses, &parts);
            for (missing, &value) in missing.iter_mut().zip(&solution.values) {
                missing[channel] = value;
            }
            let papers = self
                .rows
                .iter()
                .zip(&solution.deviations)
                .filter(|(row, _)| is_paper(row));
            residuals.extend(papers.map(|(_, off)| off.abs() * PAPER_SIGMA));
        }
        residuals.sort_by(f32::total_cmp);
        let patterns = self.shapes.iter().flat_map(|shape| &shape.patterns);
        let missing = patterns
            .zip(missing)
            .map(|(pattern, radiance)| MissingLight {
                texels: pattern.texels.clone(),
                radiance,
            })
            .collect();
        (missing, residuals.get(residuals.len() / 2).copied().unwrap_or(0.0))
    }

    fn unknowns_of(&self, region: usize) -> std::ops::Range<usize> {
        self.firsts[region]..self.firsts[region] + self.shapes[region].patterns.len()
    }

    /// Irradiance that a region is known to give to a reading.
    fn known_of(&self, row: &Row, region: usize, distance_m: f32) -> Vec3 {
        let samples = self.shapes[region].samples.iter().zip(&row.visible[region]);
        samples
            .filter(|(_, seen)| **seen)
            .map(|(sample, _)| sample.radiance * row.response(sample, distance_m))
            .sum()
    }

    fn responses(&self, distances_m: &[f32]) -> Responses {
        let mut known = Vec::with_capacity(self.rows.len());
        let mut patterns = Vec::with_capacity(self.rows.len());
        for row in &self.rows {
            let mut sum = row.known;
            let mut of_patterns = vec![0.0; self.n_patterns];
            for (region, shape) in self.shapes.iter().enumerate() {
                for (sample, _) in shape
                    .samples
                    .iter()
                    .zip(&row.visible[region])
                    .filter(|(_, seen)| **seen)
                {
                    let response = row.response(sample, distances_m[region]);
                    sum += sample.radiance * response;
                    for (value, brightness) in of_patterns[self.unknowns_of(region)].iter_mut().zip(sample.brightness) {
                        *value += brightness * response;
                    }
                }
            }
            known.push(sum);
            patterns.push(of_patterns);
        }
        Responses { known, patterns }
    }

    /// Reflectance and scatter of every part, from the light that the papers alone tell of.
    fn parts(&self, responses: &Responses, channel: usize) -> Parts {
        let papers = self.solve(channel, responses, &vec![None; self.n_parts]).1;
        let mut logs: Vec<Vec<f32>> = vec![Vec::new(); self.n_parts];
        for (k, row) in self.rows.iter().enumerate() {
            if let Reflectance::OfPart(part) = row.reflectance {
                let unknown: f32 = responses.patterns[k]
                    .iter()
                    .zip(&papers.values)
                    .map(|(a, x)| a * x)
                    .sum();
                let received = responses.known[k][channel] + unknown;
                if received > 0.0 {
                    logs[part].push((row.leaving[channel] / received).ln());
                }
            }
        }
        logs.into_iter()
            .map(|mut logs| {
                const FEWEST: usize = 6;
                if logs.len() < FEWEST {
                    return None;
                }
                let middle = median(&mut logs);
                let mut off: Vec<f32> = logs.iter().map(|log| (log - middle).abs()).collect();
                // A normal distribution's standard deviation over its median absolute deviation.
                let scatter = 1.4826 * median(&mut off);
                (scatter < MAX_SCATTER).then(|| Part {
                    reflectance: Vec3::splat(middle.exp()),
                    sigma: SHARED_GRAIN * scatter.max(PATCH_SIGMA),
                })
            })
            .collect()
    }

    /// The regions' light and the parts' reflectances of one channel: first the even pattern of each region, then ramps.
    fn solve(&self, channel: usize, responses: &Responses, parts: &[Option<Part>]) -> (Solution, Solution) {
        let even = self.unknowns(channel, responses, parts, None);
        let offsets = self.offsets(channel, responses, parts);
        let first = even.solve(&offsets);
        let all = self.unknowns(channel, responses, parts, Some(&first.values));
        let second = all.solve(&offsets);
        (first, second)
    }

    /// What one standard deviation of a reading is in irradiance; infinite for a reading that is left out.
    fn scale(&self, row: &Row, channel: usize, parts: &[Option<Part>]) -> f32 {
        match row.reflectance {
            Reflectance::Known(reflectance) => PAPER_SIGMA * row.leaving[channel] / reflectance,
            Reflectance::OfPart(part) => parts[part].map_or(f32::INFINITY, |part| {
                part.sigma * row.leaving[channel] / part.reflectance[channel]
            }),
        }
    }

    fn offsets(&self, channel: usize, responses: &Responses, parts: &[Option<Part>]) -> Vec<f32> {
        let of_row = |(row, known): (&Row, &Vec3)| {
            let received = match row.reflectance {
                Reflectance::Known(reflectance) => row.leaving[channel] / reflectance,
                Reflectance::OfPart(_) => 0.0,
            };
            (received - known[channel]) / self.scale(row, channel, parts)
        };
        self.rows.iter().zip(&responses.known).map(of_row).collect()
    }

    /// Patterns first, then 1 / reflectance of every part. Without `even` ramps are left out; with it they are expected
    /// within [`RAMP_SIGMA`] of the region's even light.
    fn unknowns(
        &self,
        channel: usize,
        responses: &Responses,
        parts: &[Option<Part>],
        even: Option<&[f32]>,
    ) -> Unknowns {
        let n = self.n_patterns + self.n_parts;
        let mut unknowns = Unknowns {
            rows: Vec::with_capacity(self.rows.len()),
            prices: vec![Price::NONE; n],
            priors: vec![(0.0, 0.0); n],
        };
        let mut is_used = vec![false; self.n_patterns];
        for (region, shape) in self.shapes.iter().enumerate() {
            let has_bands = shape.patterns.iter().any(|pattern| pattern.kind == PatternKind::Band);
            for (i, pattern) in self.unknowns_of(region).zip(&shape.patterns) {
                unknowns.prices[i] = shape.price;
                let is_asked = match (even, pattern.kind) {
                    (None, kind) => kind == PatternKind::Even,
                    (Some(_), PatternKind::Even) => !has_bands,
                    (Some(_), PatternKind::Band | PatternKind::Ramp) => true,
                };
                is_used[i] = is_asked && shape.channels[channel];
                // What the surroundings tell holds for both steps.
                if let (PatternKind::Even, Some(expected)) = (pattern.kind, shape.expected) {
                    let expected = expected[channel];
                    let sigma = BEYOND_SIGMA * (expected + shape.price.level);
                    unknowns.prices[i] = Price::NONE;
                    unknowns.priors[i] = (expected, 1.0 / (sigma * sigma).max(1e-12));
                } else if let Some(even) = even {
                    let level = even[self.firsts[region]];
                    let (expected, sigma) = match pattern.kind {
                        PatternKind::Even => (level, RAMP_SIGMA),
                        PatternKind::Band => (level, BAND_SIGMA),
                        PatternKind::Ramp => (0.0, RAMP_SIGMA),
                    };
                    // What is not asked stays nothing.
                    let expected = if is_used[i] { expected } else { 0.0 };
                    unknowns.priors[i] = (expected, 1.0 / (sigma * level).max(1e-6).powi(2));
                }
            }
        }
        for (row, patterns) in self.rows.iter().zip(&responses.patterns) {
            let scale = self.scale(row, channel, parts);
            let mut slopes = vec![0.0; n];
            for ((slope, response), _) in slopes.iter_mut().zip(patterns).zip(&is_used).filter(|(_, used)| **used) {
                *slope = response / scale;
            }
            if let Reflectance::OfPart(part) = row.reflectance {
                slopes[self.n_patterns + part] = -row.leaving[channel] / scale;
            }
            unknowns.rows.push(slopes);
        }
        unknowns
    }
}

fn is_paper(row: &Row) -> bool {
    matches!(row.reflectance, Reflectance::Known(_))
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
