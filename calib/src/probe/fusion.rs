//! Light remembered texel by texel: exposures of a bracket, views of several cameras and pictures over time become one cube.
//!
//! A texel holds an estimate with its variance. A new sample that agrees with it (χ² test of [`crate::merge`]) is
//! merged by maximum likelihood, a clipped one as the lower bound that it is: so the short exposure of a bracket measures the
//! lamp, the long one the dark corner, and every exposure refreshes both. Old estimates fade, so that the average is about
//! [`Fusion::new`]'s number of pictures long.
//!
//! A sample that contradicts is new light, or a view that does not fit (parallax, a stretched rim). Which of the two is
//! decided region by region (Gallo et al. 2009, "Artifact-free high dynamic range imaging"): where many texels of a tile
//! contradict, the light has changed and the new picture rules in the whole tile. A lonely contradiction from a view that is
//! trusted less than the one remembered must come twice in a row. So light that is switched shows in the next picture, or
//! the one after it.

use glam::{Vec3, Vec4};
use mirrorball_capture::frame::Exposure;
use rayon::prelude::*;

use super::cube::{Cube, FACES};
use super::radiance::luminance;
use super::radiance_map::Seen;
use crate::merge::noise::VarianceTable;
use crate::merge::{Clipping, Consistency, Sample, State, merge};
use crate::photometry::Photometry;

/// Edge of a tile in texels.
const TILE: usize = 8;
/// Share of a tile's comparable texels that must contradict for the whole tile to be new.
const CHANGED_SHARE: f32 = 0.3;
/// Standard deviations of noise that a sample may be off.
const SIGMAS: f32 = 5.0;
/// Relative standard deviation of a sample from resampling and calibration, beside its noise.
const RESAMPLING: f32 = 0.015;
/// A view of at least this share of the remembered quality is believed at once.
const EQUAL_QUALITY: f32 = 0.5;
/// Pictures after which the confidence in what nobody has seen since is halved.
const HALF_LIFE: f32 = 60.0;

/// What a view says in numbers: how its radiance is uncertain.
#[derive(Debug, Clone)]
pub struct ViewNoise {
    table: VarianceTable,
    /// Signal per unit of the radiance that is told, per channel: exposure and the ball's reflectance.
    signal_per_radiance: Vec3,
    /// Reflectance between the light and the camera.
    reflectance: Vec3,
}

impl ViewNoise {
    /// Noise of a frame with this exposure, which sees the light in a mirror of this reflectance (1 for none).
    #[must_use]
    pub fn new(photometry: &Photometry, exposure: &Exposure, reflectance: Vec3) -> Self {
        let signal = photometry.signal_per_radiance(exposure).map(|signal| signal as f32);
        Self {
            table: VarianceTable::new(photometry, exposure),
            signal_per_radiance: Vec3::from_array(signal) * reflectance,
            reflectance,
        }
    }

    /// Whether a radiance is below what one step of the picture's codes can show, or its noise in the dark.
    #[must_use]
    pub fn is_black(&self, radiance: Vec3) -> bool {
        /// Signal of one step of an 8-bit picture in the dark.
        const STEP: f32 = 5e-4;
        /// Standard deviations of the noise.
        const SIGMAS: f32 = 3.0;
        (0..3).all(|channel| {
            let dark = self.table.channels()[channel].sample_of_signal(0.0, Clipping::None, 1.0);
            let noise = SIGMAS * dark.floor.sqrt() / self.reflectance[channel];
            radiance[channel] < noise.max(STEP / self.signal_per_radiance[channel])
        })
    }

    /// What a texel of a view says, as samples of red, green and blue, and how far it is trusted.
    fn samples(&self, seen: &Seen) -> [Sample; 3] {
        let signal = seen.radiance * self.signal_per_radiance;
        std::array::from_fn(|channel| {
            let clipping = if seen.clipped >> channel & 1 == 1 {
                Clipping::Above
            } else {
                Clipping::None
            };
            let sample = self.table.channels()[channel].sample_of_signal(signal[channel], clipping, 1.0);
            let reflectance = self.reflectance[channel];
            let radiance = seen.radiance[channel];
            let resampling = RESAMPLING * radiance;
            // A view that is trusted half as much counts as half a sample.
            let share = seen.quality.max(0.02);
            Sample {
                radiance,
                shot: sample.shot / (reflectance * share),
                floor: (sample.floor / (reflectance * reflectance) + resampling * resampling) / share,
                clipping,
            }
        })
    }
}

/// What is remembered of a texel.
#[derive(Debug, Clone, Copy, Default)]
struct Texel {
    radiance: Vec3,
    variance: Vec3,
    /// Channels that clip anywhere in the texel (bits 0 to 2) and everywhere in it (3 to 5) in all that was seen.
    clipped: u8,
    /// Quality of the best view that went in, 0 when never seen.
    quality: f32,
    /// Pictures since a sample last agreed.
    age: u16,
    /// Contradictions in a row.
    doubts: u8,
}

/// What a texel of a picture says.
#[derive(Debug, Clone, Copy)]
struct Told {
    samples: [Sample; 3],
    seen: Seen,
}

impl Told {
    /// Whether every channel is so bright that black, which is never below 0, does not raise its mean.
    fn is_clear_of_noise(&self) -> bool {
        /// Standard deviations of noise above 0.
        const CLEAR: f32 = 5.0;
        (0..3).all(|channel| {
            let radiance = self.seen.radiance[channel];
            radiance * radiance > CLEAR * CLEAR * self.samples[channel].variance_at(radiance)
        })
    }

    /// Whether it could take the place of what is remembered: measured in every channel, and not far less certain.
    ///
    /// A dark exposure of a dim wall, or one that clips, agrees with everything; it says nothing against what is known.
    fn says_as_much_as(&self, texel: &Texel) -> bool {
        /// Ratio of variances that is let pass: a third of the certainty.
        const LEAST: f32 = 10.0;
        (0..3).all(|channel| {
            let sample = &self.samples[channel];
            let is_worse = sample.variance_at(sample.radiance) > LEAST * texel.variance[channel];
            texel.clipped >> channel & 1 == 1 || (sample.clipping == Clipping::None && !is_worse)
        })
    }
}

/// What a new sample is to a texel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// Nothing was told or nothing remembered.
    New,
    Agrees,
    Contradicts,
}

/// The cube that is remembered.
#[derive(Debug)]
pub struct Fusion {
    size: u32,
    texels: Vec<Texel>,
    consistency: Consistency,
    /// Factor by which variances grow from picture to picture.
    fading: f32,
    told: Vec<Option<Told>>,
    verdicts: Vec<Verdict>,
}

impl Fusion {
    /// Nothing remembered yet; faces of `size` texels, a multiple of 8, the edge of a tile. Light that differs by `tolerance` (a share) and
    /// the noise is new; standing light is averaged over about `average_frames` pictures, 1 or more.
    #[must_use]
    pub fn new(size: u32, tolerance: f32, average_frames: u32) -> Self {
        let n = FACES * (size * size) as usize;
        Self {
            size,
            texels: vec![Texel::default(); n],
            consistency: Consistency::new(SIGMAS, tolerance / SIGMAS),
            fading: average_frames as f32 / (average_frames as f32 - 1.0).max(0.01),
            told: vec![None; n],
            verdicts: vec![Verdict::New; n],
        }
    }

    /// Takes in what several views of one moment show, texels packed as [`Seen::pack`] does, each with its noise.
    pub fn take(&mut self, views: &[(&[Vec4], &ViewNoise)]) {
        let consistency = &self.consistency;
        self.told.par_iter_mut().enumerate().for_each(|(index, told)| {
            *told = views
                .iter()
                .filter_map(|(texels, noise)| {
                    let seen = Seen::unpack(texels[index]).filter(|seen| seen.radiance.is_finite())?;
                    Some(Told {
                        samples: noise.samples(&seen),
                        seen,
                    })
                })
                .reduce(|a, b| together(a, b, consistency));
        });
        self.judge();
        let changed = self.changed_tiles();
        self.learn(&changed);
    }

    /// Asks `elsewhere` for the texels that no view showed in the picture just taken in; what it says counts as a view.
    pub fn take_elsewhere(&mut self, noise: &ViewNoise, elsewhere: impl Fn(usize) -> Option<Seen> + Sync) {
        let (consistency, fading) = (&self.consistency, self.fading);
        let texels = self.texels.par_iter_mut().zip(&self.told).enumerate();
        texels.for_each(|(index, (texel, told))| {
            if told.is_some() {
                return;
            }
            if let Some(seen) = elsewhere(index).filter(|seen| seen.radiance.is_finite()) {
                let told = Told {
                    samples: noise.samples(&seen),
                    seen,
                };
                let verdict = verdict(texel, Some(&told), consistency);
                learn(texel, Some(&told), verdict, (consistency, fading));
            }
        });
    }

    fn judge(&mut self) {
        let consistency = &self.consistency;
        let texels = self.texels.par_iter().zip(&self.told);
        texels
            .zip(&mut self.verdicts)
            .for_each(|((texel, told), out)| *out = verdict(texel, told.as_ref(), consistency));
    }

    /// Tiles, face after face and row after row, in which the light has changed.
    fn changed_tiles(&self) -> Vec<bool> {
        let size = self.size as usize;
        let per_row = size / TILE;
        let mut tiles = vec![Tile::default(); FACES * per_row * per_row];
        for (index, verdict) in self.verdicts.iter().enumerate() {
            let tile = &mut tiles[tile_of(index, size)];
            tile.comparable += f32::from(u8::from(*verdict != Verdict::New));
            tile.contradicting += f32::from(u8::from(*verdict == Verdict::Contradicts));
            let Some(told) = &self.told[index] else { continue };
            tile.clipped |= told.seen.clipped != 0;
            let remembered = &self.texels[index];
            if *verdict == Verdict::Agrees && remembered.clipped == 0 && told.is_clear_of_noise() {
                let old = luminance(remembered.radiance).max(f32::MIN_POSITIVE);
                let change = luminance(told.seen.radiance) / old - 1.0;
                tile.compared += 1.0;
                tile.change += change;
                tile.squared_change += change * change;
            }
        }
        tiles.iter().map(Tile::has_changed).collect()
    }

    fn learn(&mut self, changed: &[bool]) {
        let (size, consistency, fading) = (self.size as usize, &self.consistency, self.fading);
        let told = self.told.par_iter().zip(&self.verdicts);
        self.texels
            .par_iter_mut()
            .zip(told)
            .enumerate()
            .for_each(|(index, (texel, (told, &verdict)))| {
                let is_new = changed[tile_of(index, size)]
                    && told
                        .as_ref()
                        .is_some_and(|told| verdict != Verdict::Agrees || told.says_as_much_as(texel));
                let verdict = if is_new { Verdict::New } else { verdict };
                learn(texel, told.as_ref(), verdict, (consistency, fading));
            });
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.texels.fill(Texel::default());
    }

    /// Radiance of a texel, linear RGB; 0 where nothing was ever seen.
    #[must_use]
    pub fn radiance(&self, index: usize) -> Vec3 {
        self.texels[index].radiance
    }

    /// What is known of a texel, as one picture would say it; `None` where nothing was ever seen.
    #[must_use]
    pub fn seen(&self, index: usize) -> Option<Seen> {
        let texel = &self.texels[index];
        (texel.quality > 0.0).then_some(Seen {
            radiance: texel.radiance,
            clipped: texel.clipped & 7,
            clipped_everywhere: texel.clipped >> 3,
            quality: texel.quality,
        })
    }

    /// Channels clipped anywhere in the texel in all that was seen (bits 0 to 2), everywhere in it (bits 3 to 5).
    #[must_use]
    pub fn clipped(&self) -> Cube<u8> {
        let texels = self.texels.iter().map(|texel| texel.clipped).collect();
        Cube::from_texels(self.size, texels).unwrap_or_else(|| Cube::filled(self.size, 0))
    }

    /// How far a texel is to be believed, 0 (never seen) to 1: quality of the view, less the longer ago it was.
    #[must_use]
    pub fn confidence(&self, index: usize) -> f32 {
        let texel = &self.texels[index];
        texel.quality * 0.5f32.powf(f32::from(texel.age) / HALF_LIFE)
    }

    /// Pictures since a texel was last seen and agreed.
    #[must_use]
    pub fn age(&self, index: usize) -> u16 {
        self.texels[index].age
    }
}

/// What the texels of a tile say together.
#[derive(Debug, Clone, Copy, Default)]
struct Tile {
    comparable: f32,
    contradicting: f32,
    /// Whether a texel of it clips in the new picture.
    clipped: bool,
    /// Texels that agree and are measured, with sums of their relative changes.
    compared: f32,
    change: f32,
    squared_change: f32,
}

impl Tile {
    /// Whether many texels contradict, or all drift the same way: light that changes slowly agrees texel by texel.
    fn has_changed(&self) -> bool {
        /// Drift that is let in as noise.
        const DRIFT: f32 = 0.01;
        /// Standard errors from which on a drift is one.
        const SURE: f32 = 4.0;
        /// Texels that a drift is told from at least.
        const FEWEST: f32 = 8.0;
        if self.contradicting > CHANGED_SHARE * self.comparable {
            return true;
        }
        // Which texels of a tile are left unclipped is chance where it clips, and those are dimmer than the rest.
        if self.compared < FEWEST || self.clipped {
            return false;
        }
        let mean = self.change / self.compared;
        let variance = (self.squared_change / self.compared - mean * mean).max(0.0);
        mean.abs() > DRIFT && mean.abs() > SURE * (variance / self.compared).sqrt()
    }
}

/// Tile of a texel, face after face and row after row.
fn tile_of(index: usize, size: usize) -> usize {
    let (face, y, x) = (index / (size * size), index / size % size, index % size);
    let per_row = size / TILE;
    (face * per_row + y / TILE) * per_row + x / TILE
}

/// Two views of one moment: merged where they agree, else the better one.
fn together(a: Told, b: Told, consistency: &Consistency) -> Told {
    let (worse, better) = if a.seen.quality <= b.seen.quality {
        (a, b)
    } else {
        (b, a)
    };
    let mut told = better;
    for channel in 0..3 {
        let samples = [worse.samples[channel], better.samples[channel]];
        let Some(estimate) = merge(&samples, consistency).filter(|estimate| estimate.trusted == 2) else {
            return better;
        };
        let is_bound = estimate.state == State::AtLeast;
        told.seen.radiance[channel] = estimate.radiance;
        told.samples[channel] = Sample {
            radiance: estimate.radiance,
            shot: 0.0,
            floor: estimate.variance,
            clipping: if is_bound { Clipping::Above } else { Clipping::None },
        };
        if !is_bound {
            told.seen.clipped &= !(1 << channel);
            told.seen.clipped_everywhere &= !(1 << channel);
        }
    }
    told
}

fn verdict(texel: &Texel, told: Option<&Told>, consistency: &Consistency) -> Verdict {
    let Some(told) = told.filter(|_| texel.quality > 0.0) else {
        return Verdict::New;
    };
    let agrees = |channel: usize| {
        let samples = [remembered(texel, channel), told.samples[channel]];
        merge(&samples, consistency).is_some_and(|estimate| estimate.trusted == 2)
    };
    if (0..3).all(agrees) {
        Verdict::Agrees
    } else {
        Verdict::Contradicts
    }
}

/// A channel of what is remembered, as a sample.
fn remembered(texel: &Texel, channel: usize) -> Sample {
    Sample {
        radiance: texel.radiance[channel],
        shot: 0.0,
        floor: texel.variance[channel],
        clipping: if texel.clipped >> channel & 1 == 1 {
            Clipping::Above
        } else {
            Clipping::None
        },
    }
}

fn learn(texel: &mut Texel, told: Option<&Told>, verdict: Verdict, (consistency, fading): (&Consistency, f32)) {
    let Some(told) = told else {
        texel.age = texel.age.saturating_add(1);
        return;
    };
    match verdict {
        Verdict::New => replace(texel, told),
        Verdict::Agrees => {
            let clipped_everywhere = told.seen.clipped_everywhere & texel.clipped >> 3;
            let mut clipped = 0;
            for channel in 0..3 {
                let mut old = remembered(texel, channel);
                old.floor *= fading;
                let Some(estimate) = merge(&[old, told.samples[channel]], consistency) else {
                    continue;
                };
                texel.radiance[channel] = estimate.radiance;
                texel.variance[channel] = estimate.variance;
                if estimate.state == State::AtLeast {
                    clipped |= (1 | (clipped_everywhere >> channel & 1) << 3) << channel;
                }
            }
            texel.clipped = clipped;
            texel.quality = told.seen.quality.max(texel.quality / fading);
            texel.age = 0;
            texel.doubts = 0;
        }
        Verdict::Contradicts => {
            texel.doubts += 1;
            if texel.doubts > 1 || told.seen.quality >= EQUAL_QUALITY * texel.quality {
                replace(texel, told);
            } else {
                texel.age = texel.age.saturating_add(1);
            }
        }
    }
}

fn replace(texel: &mut Texel, told: &Told) {
    *texel = Texel {
        radiance: told.seen.radiance,
        variance: Vec3::from_array(std::array::from_fn(|channel| {
            told.samples[channel].variance_at(told.seen.radiance[channel])
        })),
        clipped: told.seen.clipped | told.seen.clipped_everywhere << 3,
        quality: told.seen.quality.max(1.0 / 255.0),
        age: 0,
        doubts: 0,
    };
}

#[cfg(test)]
mod tests;
