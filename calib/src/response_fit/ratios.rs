//! How well a response explains the exposure times: the exposure-ratio error.

use super::{FlatPatches, patches};
use crate::response::ResponseCurve;

/// Codes between which a patch counts as well exposed: an eighth and seven eighths of the scale.
const WELL_EXPOSED: [f32; 2] = [32.0, 224.0];

/// Patches that two pictures must have in common in a channel to be compared.
const MIN_PATCHES: usize = 100;

/// Exposure-ratio errors of a set of pictures.
///
/// For a flat patch that is well exposed (mean code 32 to 224) in two pictures, the error is
/// `(signal in one / signal in the other) / (ratio of the exposure times) − 1`.
#[derive(Debug, Clone, PartialEq)]
pub struct RatioErrors {
    /// Median over all patches, pairs of pictures and channels of the error's size; it holds noise and misalignment.
    pub patch_median: f64,
    /// Median over pairs of pictures and channels of the size of [`PairError::error`].
    pub pair_median: f64,
    /// The pair and channel with the largest error.
    pub worst: PairError,
    /// Number of pairs of pictures and channels.
    pub pairs: usize,
    /// Number of patches, each counted in every pair and channel.
    pub patches: usize,
}

/// Exposure-ratio error of one channel of two pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairError {
    /// Indices of the pictures, the longer exposure first.
    pub pictures: [usize; 2],
    /// 0 red, 1 green, 2 blue.
    pub channel: usize,
    /// Median of the errors of the patches.
    pub error: f64,
    /// Standard deviation of the median, from the scatter of the patches.
    pub sigma: f64,
    /// Number of patches.
    pub patches: usize,
}

/// Measures how well `curves` explain exposures of `exposures_s`, per picture those of red, green and blue; `None` when no two pictures have 100 well
/// exposed patches in common.
#[must_use]
pub fn ratio_errors(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    exposures_s: &[[f64; 3]],
) -> Option<RatioErrors> {
    let mut sizes = Vec::new();
    let pairs = measured_pairs(patches, curves, exposures_s, |errors| {
        sizes.extend(errors.iter().map(|error| error.abs()));
    });
    let worst = *pairs.iter().max_by(|a, b| a.error.abs().total_cmp(&b.error.abs()))?;
    Some(RatioErrors {
        patches: sizes.len(),
        patch_median: median(sizes),
        pair_median: median(pairs.iter().map(|pair| pair.error.abs()).collect()),
        worst,
        pairs: pairs.len(),
    })
}

/// The error of every pair of pictures and channel that has enough patches.
pub(crate) fn pair_errors(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    exposures_s: &[[f64; 3]],
) -> Vec<PairError> {
    measured_pairs(patches, curves, exposures_s, |_| ())
}

/// The same; `each` gets the errors of a pair's patches.
fn measured_pairs(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    exposures_s: &[[f64; 3]],
    mut each: impl FnMut(&[f64]),
) -> Vec<PairError> {
    let mut pairs = Vec::new();
    for (channel, curve) in curves.iter().enumerate() {
        let of_channel: Vec<f64> = exposures_s.iter().map(|times| times[channel]).collect();
        for [a, b] in patches::ordered_pairs(&of_channel) {
            let ratio = of_channel[a] / of_channel[b];
            let errors: Vec<f64> = patches
                .pairs([a, b], channel, WELL_EXPOSED)
                .map(|[code_a, code_b]| linear_at(curve, code_a) / linear_at(curve, code_b) / ratio - 1.0)
                .collect();
            if errors.len() >= MIN_PATCHES {
                each(&errors);
                let patches = errors.len();
                let error = median(errors.clone());
                let spread = median(errors.iter().map(|other| (other - error).abs()).collect());
                pairs.push(PairError {
                    pictures: [a, b],
                    channel,
                    // Normal errors: σ is 1.4826 times the median deviation, and the median's own √(π/2) σ / √n.
                    sigma: 1.4826 * spread * (0.5 * std::f64::consts::PI / patches as f64).sqrt(),
                    patches,
                    error,
                });
            }
        }
    }
    pairs
}

/// The signal between two codes: linear, as far as a mean of codes goes.
pub(super) fn linear_at(curve: &ResponseCurve, code: f32) -> f64 {
    let below = code.floor().clamp(0.0, 254.0) as u8;
    let (y0, y1) = (curve.linear_from_code(below), curve.linear_from_code(below + 1));
    y0 + (y1 - y0) * (f64::from(code) - f64::from(below))
}

/// The middle of the values, which are not empty.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
