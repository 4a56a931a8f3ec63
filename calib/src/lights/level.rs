//! What is bright: how much of a texel's light belongs to a light of its own, and how much to the soft light of the dome.

use super::{Map, counted};
use crate::probe::radiance::luminance;

/// Up to this many times the median a texel is all dome, ...
const DIM_RATIO: f32 = 4.0;
/// ... and from this many times on, all light; between them the share rises smoothly, so that noise does not switch.
const BRIGHT_RATIO: f32 = 8.0;
/// Where lamps are clipped nothing is that bright: then these shares of the maximum count, ...
const DIM_OF_MAX: f32 = 0.5;
const BRIGHT_OF_MAX: f32 = 0.75;
/// ... but what is hardly brighter than the median never is a lamp.
const MIN_DIM_RATIO: f32 = 1.5;
const MIN_BRIGHT_RATIO: f32 = 2.0;
/// The median counts as at least this share of the mean: half of a map may be black.
const MIN_OF_MEAN: f32 = 1.0 / 16.0;

/// Bins per octave: bits of a float's mantissa that the histogram tells apart.
const MANTISSA_BITS: u32 = 3;
const SHIFT: u32 = f32::MANTISSA_DIGITS - 1 - MANTISSA_BITS;
const BINS: usize = 1 << (8 + MANTISSA_BITS);

/// The levels between which a texel changes from dome to light.
#[derive(Debug, Clone, Copy)]
pub(super) struct BrightLevel {
    dim: f32,
    bright: f32,
}

/// Finds the level of a map; keeps its histogram.
#[derive(Debug)]
pub(super) struct LevelMeter {
    area_sr: Box<[f32; BINS]>,
}

impl LevelMeter {
    pub(super) fn new() -> Self {
        Self {
            area_sr: Box::new([0.0; BINS]),
        }
    }

    /// The level of a map: by the median luminance over the open solid angle, which no lamp moves, and the maximum.
    pub(super) fn level(&mut self, map: &Map<'_>) -> BrightLevel {
        self.area_sr.fill(0.0);
        let (mut power, mut total_sr, mut max) = (0.0, 0.0, 0.0f32);
        for index in map.directions.open() {
            let luminance = luminance(counted(map.radiance.texels()[index]));
            let area_sr = map.directions.solid_angle_sr[index];
            // Bits of floats that are not negative are in the order of the floats.
            self.area_sr[(luminance.to_bits() >> SHIFT) as usize] += area_sr;
            power += luminance * area_sr;
            total_sr += area_sr;
            max = max.max(luminance);
        }
        let mean = power / total_sr.max(f32::MIN_POSITIVE);
        let median = self.median(0.5 * total_sr).max(MIN_OF_MEAN * mean);
        BrightLevel {
            dim: (DIM_OF_MAX * max).clamp(MIN_DIM_RATIO * median, DIM_RATIO * median),
            bright: (BRIGHT_OF_MAX * max).clamp(MIN_BRIGHT_RATIO * median, BRIGHT_RATIO * median),
        }
    }

    /// The luminance below which `half_sr` lies, linear within its bin.
    fn median(&self, half_sr: f32) -> f32 {
        let edge = |bin: usize| f32::from_bits((bin as u32) << SHIFT);
        let mut below_sr = 0.0;
        for (bin, &area_sr) in self.area_sr.iter().enumerate() {
            if area_sr > 0.0 && below_sr + area_sr >= half_sr {
                let (low, high) = (edge(bin), edge(bin + 1));
                let share = ((half_sr - below_sr) / area_sr).clamp(0.0, 1.0);
                return if high.is_finite() {
                    low + share * (high - low)
                } else {
                    low
                };
            }
            below_sr += area_sr;
        }
        0.0
    }
}

impl BrightLevel {
    /// Share of a texel's light that belongs to a light of its own, 0 to 1.
    pub(super) fn share(self, luminance: f32) -> f32 {
        if luminance <= self.dim {
            return 0.0;
        }
        let t = ((luminance - self.dim) / (self.bright - self.dim)).min(1.0);
        t * t * (3.0 - 2.0 * t)
    }
}
