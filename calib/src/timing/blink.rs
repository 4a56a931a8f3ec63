//! When a light went on and off, from the light that exposures have gathered.

use super::{MIN_EDGES, Sample, TimingError, median};

/// Contrast over noise that a light must have.
const MIN_CONTRAST: f64 = 8.0;
/// Least noise, in parts of the contrast: codes are rounded.
const LEAST_NOISE: f64 = 0.002;
/// How far from dark or lit, in standard deviations, a frame must be to have caught the change.
const SETTLED_SIGMAS: f64 = 4.0;
/// And in parts of the contrast.
const SETTLED: f64 = 0.02;
/// Gaps longer than this many frame intervals tell nothing: the light may have changed twice.
const MAX_GAP: f64 = 3.5;
/// Linear light below which nothing counts as a change: a tenth of a code near black.
const LEAST_CHANGE: f64 = 3e-4;
/// Side of the blocks that a blinking region is made of, pixels.
pub const BLOCK_PX: usize = 8;
/// Share of clipped pixels, in any frame, beyond which a block is saturated.
pub const MAX_CLIPPED: f32 = 0.02;

/// A change of the light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// The earliest and latest instant that it can have happened, seconds; the same where a frame was exposed meanwhile.
    pub between_s: [f64; 2],
    /// Standard deviation of these, seconds.
    pub sigma_s: f64,
    /// Whether the light went on.
    pub is_rising: bool,
}

impl Edge {
    /// The middle of what is possible, seconds.
    #[must_use]
    pub fn middle_s(&self) -> f64 {
        0.5 * (self.between_s[0] + self.between_s[1])
    }

    /// How long the span of what is possible is, seconds.
    #[must_use]
    pub fn width_s(&self) -> f64 {
        self.between_s[1] - self.between_s[0]
    }
}

/// The light's two levels and their noise.
#[derive(Debug, Clone, Copy)]
struct Levels {
    dark: f64,
    lit: f64,
    /// In parts of the contrast.
    noise: f64,
}

/// Finds the changes of a light that is either on or off. `camera` is for messages.
///
/// A frame exposed for T while the light went on after a part `1 - f` of it shows the fraction f of the contrast: the instant is
/// `start + (1 - f) T`, or `start + f T` where it went off.
///
/// # Errors
/// [`TimingError::NothingBlinks`], [`TimingError::TooFewEdges`].
pub fn edges(samples: &[Sample], camera: &str) -> Result<Vec<Edge>, TimingError> {
    let levels = levels(samples).ok_or_else(|| TimingError::NothingBlinks {
        camera: camera.to_owned(),
        contrast_sigmas: 0.0,
    })?;
    if levels.noise * MIN_CONTRAST > 1.0 {
        return Err(TimingError::NothingBlinks {
            camera: camera.to_owned(),
            contrast_sigmas: 1.0 / levels.noise,
        });
    }
    let interval_s = median(
        samples
            .windows(2)
            .map(|pair| pair[1].start_s - pair[0].start_s)
            .collect(),
    );
    let fraction = |sample: &Sample| (sample.value - levels.dark) / (levels.lit - levels.dark);
    let margin = SETTLED.max(SETTLED_SIGMAS * levels.noise).min(0.4);
    let state = |sample: &Sample| match fraction(sample) {
        f if f < margin => Some(false),
        f if f > 1.0 - margin => Some(true),
        _ => None,
    };
    let mut edges = Vec::new();
    let mut settled: Option<(usize, bool)> = None;
    for (index, sample) in samples.iter().enumerate() {
        let Some(is_lit) = state(sample) else { continue };
        if let Some((before, was_lit)) = settled
            && was_lit != is_lit
            && sample.start_s - samples[before].start_s < MAX_GAP * interval_s
        {
            let first = &samples[before];
            edges.extend(match index - before {
                // A change within the margin of an exposure does not show.
                1 => Some(Edge {
                    between_s: [
                        first.start_s + first.exposure_s * (1.0 - margin),
                        sample.start_s + sample.exposure_s * margin,
                    ],
                    sigma_s: levels.noise * first.exposure_s,
                    is_rising: is_lit,
                }),
                2 => Some(caught(
                    &samples[before + 1],
                    fraction(&samples[before + 1]),
                    is_lit,
                    levels.noise,
                )),
                _ => None,
            });
        }
        settled = Some((index, is_lit));
    }
    if edges.len() < MIN_EDGES {
        return Err(TimingError::TooFewEdges {
            camera: camera.to_owned(),
            n_edges: edges.len(),
        });
    }
    Ok(edges)
}

/// A change during an exposure of which the fraction `lit` was lit.
fn caught(sample: &Sample, lit: f64, is_rising: bool, noise: f64) -> Edge {
    let before = if is_rising { 1.0 - lit } else { lit };
    let instant = sample.start_s + sample.exposure_s * before;
    Edge {
        between_s: [instant; 2],
        sigma_s: noise * sample.exposure_s,
        is_rising,
    }
}

/// Two means (Lloyd 1982), then the medians of what is near them, so that frames in between do not pull.
fn levels(samples: &[Sample]) -> Option<Levels> {
    let values = || samples.iter().map(|sample| sample.value);
    let (mut dark, mut lit) = (
        values().fold(f64::INFINITY, f64::min),
        values().fold(f64::NEG_INFINITY, f64::max),
    );
    let mut noise = f64::INFINITY;
    for _ in 0..10 {
        let contrast = lit - dark;
        if !(contrast > 0.0 && contrast.is_finite()) {
            return None;
        }
        let near = |level: f64| {
            values()
                .filter(move |v| (v - level).abs() < 0.2 * contrast)
                .collect::<Vec<f64>>()
        };
        let (low, high) = (near(dark), near(lit));
        if low.len() < 3 || high.len() < 3 {
            return None;
        }
        (dark, lit) = (median(low.clone()), median(high.clone()));
        let spread = |values: &[f64], level: f64| 1.4826 * median(values.iter().map(|v| (v - level).abs()).collect());
        noise = spread(&low, dark).max(spread(&high, lit)) / (lit - dark);
    }
    Some(Levels {
        dark,
        lit,
        noise: noise.max(LEAST_NOISE),
    })
}

/// The blocks that blink: those that change at least half as much as the one that changes most, saturated ones aside.
///
/// `frames` holds the mean linear light of every block for each frame; `clipped` the largest share of clipped pixels that
/// each block had.
///
/// # Errors
/// [`TimingError::NothingBlinks`], [`TimingError::Saturated`].
pub fn blinking_blocks(frames: &[Vec<f32>], clipped: &[f32], camera: &str) -> Result<Vec<usize>, TimingError> {
    // Light and dark as they are most of the time: the tenth smallest and largest of a hundred.
    let range = |block: usize| {
        let mut values: Vec<f32> = frames.iter().map(|frame| frame[block]).collect();
        values.sort_by(f32::total_cmp);
        let at = |share: f64| values[(share * (values.len() - 1) as f64).round() as usize];
        at(0.9) - at(0.1)
    };
    let nothing = |contrast_sigmas| TimingError::NothingBlinks {
        camera: camera.to_owned(),
        contrast_sigmas,
    };
    if frames.is_empty() || clipped.is_empty() {
        return Err(nothing(0.0));
    }
    let ranges: Vec<f32> = (0..clipped.len()).map(range).collect();
    let is_clipped = |block: &usize| clipped[*block] > MAX_CLIPPED;
    let all = 0..ranges.len();
    let most = all
        .clone()
        .filter(|b| !is_clipped(b))
        .map(|b| ranges[b])
        .fold(0.0, f32::max);
    let most_clipped = all.clone().filter(is_clipped).map(|b| ranges[b]).fold(0.0, f32::max);
    let contrast = |most: f32| {
        let block = ranges.iter().position(|range| *range == most).unwrap_or(0);
        // What changes from frame to frame most of the time is noise.
        let steps = frames
            .windows(2)
            .map(|pair| f64::from((pair[1][block] - pair[0][block]).abs()));
        f64::from(most) / (1.4826 * median(steps.collect()) / std::f64::consts::SQRT_2).max(LEAST_CHANGE)
    };
    let contrast_clipped = contrast(most_clipped);
    let contrast = contrast(most);
    if contrast < MIN_CONTRAST {
        return Err(if contrast_clipped >= MIN_CONTRAST {
            TimingError::Saturated {
                camera: camera.to_owned(),
            }
        } else {
            nothing(contrast)
        });
    }
    Ok(all
        .filter(|block| !is_clipped(block) && ranges[*block] >= 0.5 * most)
        .collect())
}
