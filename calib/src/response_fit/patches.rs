//! Small patches in which nothing happens: their mean codes are the same light in every picture, nearly without noise.

use super::{FitError, Shot};

/// Edge of a patch in pixels.
const PATCH_PX: usize = 4;

/// Patches with more deviation than this many codes, plus a share of their mean, show an edge.
const MAX_DEVIATION_CODES: f32 = 2.0;

/// The share: grain and shot noise grow with the light.
const MAX_DEVIATION_SHARE: f32 = 0.04;

/// Share of the patches that may be darker than the floor.
const FLOOR_SHARE: f64 = 0.005;

/// Smallest ratio of two exposure times that count as different.
const MIN_RATIO: f64 = 1.05;

/// Mean codes of the patches of several pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatPatches {
    exposures_s: Vec<f64>,
    /// Per picture and patch: mean code of red, green and blue; NaN where the patch is not flat, holds a hole, or a pixel at
    /// an end of the scale.
    means: Vec<Vec<[f32; 3]>>,
    /// The darkest code of red, green and blue that a picture shows.
    floors: [f32; 3],
}

impl FlatPatches {
    /// Finds the patches of pictures of `size_px` (width, height).
    ///
    /// # Errors
    /// When there are fewer than two pictures, sizes differ, or exposure times are none or equal.
    pub fn new(shots: &[Shot<'_>], size_px: [usize; 2]) -> Result<Self, FitError> {
        check(shots, size_px)?;
        let mut floors = [f32::INFINITY; 3];
        let means = shots
            .iter()
            .map(|shot| {
                let patches = all_patches(shot, size_px);
                for (channel, floor) in floors.iter_mut().enumerate() {
                    let mut seen: Vec<f32> = patches.iter().flatten().map(|patch| patch.mean[channel]).collect();
                    seen.sort_by(f32::total_cmp);
                    let darkest = seen.get((FLOOR_SHARE * seen.len() as f64) as usize);
                    *floor = floor.min(darkest.copied().unwrap_or(f32::INFINITY));
                }
                let flat = |patch: Option<Patch>| patch.map_or([f32::NAN; 3], |patch| patch.flat_means());
                patches.into_iter().map(flat).collect()
            })
            .collect();
        Ok(Self {
            exposures_s: shots.iter().map(|shot| shot.exposure_s).collect(),
            means,
            floors: floors.map(|floor| if floor.is_finite() { floor } else { 0.0 }),
        })
    }

    /// Exposure times of the pictures in seconds.
    #[must_use]
    pub fn exposures_s(&self) -> &[f64] {
        &self.exposures_s
    }

    /// The same for red, green and blue of each picture.
    #[must_use]
    pub fn channel_exposures_s(&self) -> Vec<[f64; 3]> {
        self.exposures_s.iter().map(|&time| [time; 3]).collect()
    }

    /// The darkest code of a channel that a picture shows: film has a base that is not black, cameras have 0 or a little more.
    pub(super) fn floor(&self, channel: usize) -> f64 {
        f64::from(self.floors[channel])
    }

    /// Exposure times of two pictures of which the longer is the darker one, if that is so of most pairs of pictures.
    pub(super) fn reversed(&self) -> Option<[f64; 2]> {
        let (mut pairs, mut darker) = (0, Vec::new());
        for pictures in ordered_pairs(&self.exposures_s) {
            let rises = self
                .pairs(pictures, 1, [0.0, 255.0])
                .map(|[longer, shorter]| longer - shorter);
            let mut rises: Vec<f32> = rises.collect();
            if rises.is_empty() {
                continue;
            }
            let middle = rises.len() / 2;
            pairs += 1;
            // A code's worth of noise says nothing.
            if *rises.select_nth_unstable_by(middle, f32::total_cmp).1 < -1.0 {
                darker.push(pictures.map(|picture| self.exposures_s[picture]));
            }
        }
        (2 * darker.len() > pairs).then(|| darker[0])
    }

    /// Mean codes, in two pictures, of the patches that are flat in a channel of both and between `low` and `high`.
    pub(super) fn pairs(
        &self,
        [a, b]: [usize; 2],
        channel: usize,
        [low, high]: [f32; 2],
    ) -> impl Iterator<Item = [f32; 2]> {
        let range = low..=high;
        self.means[a]
            .iter()
            .zip(&self.means[b])
            .map(move |(a, b)| [a[channel], b[channel]])
            .filter(move |pair| range.contains(&pair[0]) && range.contains(&pair[1]))
    }
}

fn check(shots: &[Shot<'_>], size_px: [usize; 2]) -> Result<(), FitError> {
    if shots.len() < 2 {
        return Err(FitError::Count { found: shots.len() });
    }
    let n_pixels = size_px[0] * size_px[1];
    for (picture, shot) in shots.iter().enumerate() {
        let holes = shot.holes.map_or(n_pixels, <[bool]>::len);
        for (found, expected) in [(shot.codes.len(), 3 * n_pixels), (holes, n_pixels)] {
            if found != expected {
                return Err(FitError::Size {
                    picture,
                    found,
                    expected,
                });
            }
        }
        if !(shot.exposure_s > 0.0 && shot.exposure_s.is_finite()) {
            return Err(FitError::Exposure {
                picture,
                found: shot.exposure_s,
            });
        }
    }
    let times = || shots.iter().map(|shot| shot.exposure_s);
    let (shortest, longest) = (times().fold(f64::MAX, f64::min), times().fold(0.0, f64::max));
    if longest < MIN_RATIO * shortest {
        return Err(FitError::EqualExposures { found: shortest });
    }
    Ok(())
}

struct Patch {
    mean: [f32; 3],
    deviation: [f32; 3],
    low: [u8; 3],
    high: [u8; 3],
}

impl Patch {
    fn flat_means(&self) -> [f32; 3] {
        std::array::from_fn(|channel| {
            let mean = self.mean[channel];
            let is_flat = self.deviation[channel] <= MAX_DEVIATION_CODES + MAX_DEVIATION_SHARE * mean;
            let is_inside = self.low[channel] > 0 && self.high[channel] < 255;
            if is_flat && is_inside { mean } else { f32::NAN }
        })
    }
}

/// All patches of a picture; `None` where one holds a hole.
fn all_patches(shot: &Shot<'_>, size_px: [usize; 2]) -> Vec<Option<Patch>> {
    let [columns, rows] = size_px.map(|side| side / PATCH_PX);
    (0..columns * rows)
        .map(|index| {
            patch(
                shot,
                size_px[0],
                [index % columns * PATCH_PX, index / columns * PATCH_PX],
            )
        })
        .collect()
}

fn patch(shot: &Shot<'_>, width_px: usize, corner: [usize; 2]) -> Option<Patch> {
    let (mut sum, mut squares) = ([0.0f32; 3], [0.0f32; 3]);
    let (mut low, mut high) = ([255; 3], [0; 3]);
    for y in corner[1]..corner[1] + PATCH_PX {
        for x in corner[0]..corner[0] + PATCH_PX {
            let pixel = y * width_px + x;
            if shot.holes.is_some_and(|holes| holes[pixel]) {
                return None;
            }
            for channel in 0..3 {
                let code = shot.codes[3 * pixel + channel];
                sum[channel] += f32::from(code);
                squares[channel] += f32::from(code).powi(2);
                low[channel] = code.min(low[channel]);
                high[channel] = code.max(high[channel]);
            }
        }
    }
    let n = (PATCH_PX * PATCH_PX) as f32;
    let mean = sum.map(|sum| sum / n);
    let deviation = std::array::from_fn(|channel| (squares[channel] / n - mean[channel].powi(2)).max(0.0).sqrt());
    Some(Patch {
        mean,
        deviation,
        low,
        high,
    })
}

/// Indices of the pictures, two by two, that differ in exposure; the longer one first.
pub(super) fn ordered_pairs(exposures_s: &[f64]) -> Vec<[usize; 2]> {
    let n = exposures_s.len();
    let all = (0..n).flat_map(move |a| (0..n).map(move |b| [a, b]));
    all.filter(|&[a, b]| exposures_s[a] >= MIN_RATIO * exposures_s[b])
        .collect()
}
