//! The smooth, rising curve that explains the exposure ratios.

use nalgebra::{DMatrix, DVector};

use super::{FitError, FlatPatches, patches, ratios::linear_at};
use crate::response::ResponseCurve;

const CODES: usize = 256;

/// Patches that two pictures must have in common.
const MIN_PATCHES: usize = 100;

/// Patches within a code that make a quantile good.
const MIN_NEAR: usize = 8;

/// Largest ratio of two exposures that are compared: of more, too few codes are well exposed in both.
const MAX_LOG_RATIO: f64 = 3.5;

/// Codes above the floor from which on a code says something.
const MIN_ABOVE_FLOOR: f64 = 4.0;

/// The brightest code used: clipping starts before 255.
const HIGHEST_CODE: f64 = 252.0;

/// Where the coordinate of smoothness would end: far enough above 255 that codes near the top are still distinct.
const TOP: f64 = 280.0;

/// Change of slope that is expected over one unit of that coordinate, which has about six from end to end: smaller makes
/// stiffer curves. Chosen by eye: on brackets of a camera and of film, 1 gives staircases, which fit the ratios better and are
/// wrong; 0.3 bends the channels of one camera differently; 0.1 does neither and brings known curves with a soft shoulder back.
const BEND: f64 = 0.1;

/// Exponent of the curve that sets the noise of a code beforehand; cameras lie between 1 and 3.
const USUAL_EXPONENT: f64 = 2.2;

/// Error of a log ratio that no number of patches removes.
const MODEL_ERROR: f64 = 0.004;

/// Weight of what is fixed by definition.
const FIXED: f64 = 1e8;

/// Scale of the Cauchy weights in standard deviations.
const OUTLIER_SIGMAS: f64 = 3.0;

/// Log ratio that counts as an outlier before there is a curve.
const FIRST_OUTLIER: f64 = 0.3;

/// Log ratio by which a patch may contradict the first curve: far beyond noise, so that leaving it out bends nothing.
const MAX_CONTRADICTION: f64 = 0.3;

/// Most rounds of robust weighting. Where one curve suits all pictures, 8 settle it to a thousandth; where it does not, none
/// do.
const ROUNDS: usize = 24;

/// Change of g in a round below which it has settled.
const SETTLED: f64 = 1e-5;

/// The code at which g is held while solving.
const ANCHOR: usize = 128;

/// What solving yields.
pub(super) struct Solution {
    pub(super) curve: ResponseCurve,
    pub(super) known_codes: [u8; 2],
}

/// The same light in two pictures.
struct Match {
    codes: [f64; 2],
    /// Logarithm of the ratio of their exposures.
    log_ratio: f64,
    /// Number of patches behind it.
    patches: f64,
}

/// Solves for one curve of the given channels: twice, the second time without the patches in which something has moved.
///
/// `log_exposures` are those of red, green and blue, one per picture.
pub(super) fn solve(
    patches: &FlatPatches,
    channels: &[usize],
    log_exposures: &[Vec<f64>; 3],
) -> Result<Solution, FitError> {
    let first = solve_once(patches, channels, log_exposures, |_, _| true)?;
    let is_still = |log_ratio: f64, codes: [f32; 2]| {
        let [signal_a, signal_b] = codes.map(|code| linear_at(&first.curve, code));
        let error = (signal_a / signal_b).ln() - log_ratio;
        error.abs() < MAX_CONTRADICTION
    };
    solve_once(patches, channels, log_exposures, is_still)
}

fn solve_once(
    patches: &FlatPatches,
    channels: &[usize],
    log_exposures: &[Vec<f64>; 3],
    is_still: impl Fn(f64, [f32; 2]) -> bool,
) -> Result<Solution, FitError> {
    let (mut matches, mut most) = (Vec::new(), 0);
    let floor = channels
        .iter()
        .map(|&channel| patches.floor(channel))
        .fold(0.0, f64::max);
    for &channel in channels {
        let logs = &log_exposures[channel];
        let exposures: Vec<f64> = logs.iter().map(|log| log.exp()).collect();
        for pictures in patches::ordered_pairs(&exposures) {
            let log_ratio = logs[pictures[0]] - logs[pictures[1]];
            if log_ratio > MAX_LOG_RATIO {
                continue;
            }
            let low = floor + MIN_ABOVE_FLOOR;
            let pairs: Vec<[f32; 2]> = patches
                .pairs(pictures, channel, [low as f32, HIGHEST_CODE as f32])
                .filter(|&codes| is_still(log_ratio, codes))
                .collect();
            most = most.max(pairs.len());
            add_matches(&pairs, log_ratio, low, &mut matches);
        }
    }
    if matches.is_empty() {
        return Err(FitError::NothingInCommon {
            found: most,
            needed: MIN_PATCHES,
        });
    }
    // Whether the floor is the base of a film or merely the darkest thing in sight is for the pictures to say.
    let mut floors = vec![0.0, 0.5 * floor, (floor - 1.0).max(0.0)];
    floors.dedup();
    let best = floors
        .into_iter()
        .map(|floor| Problem::new(&matches, floor).solve())
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
        .expect("there is at least one floor to try");
    let codes = || matches.iter().flat_map(|found| found.codes);
    Ok(Solution {
        curve: curve(&best.log_signal, floor),
        known_codes: [
            codes().fold(255.0, f64::min) as u8,
            codes().fold(0.0, f64::max).ceil() as u8,
        ],
    })
}

/// Adds the equal quantiles of the patches that two pictures have in common, one per code of the first.
fn add_matches(pairs: &[[f32; 2]], log_ratio: f64, low: f64, matches: &mut Vec<Match>) {
    if pairs.len() < MIN_PATCHES {
        return;
    }
    let [mut a, mut b]: [Vec<f32>; 2] = [0, 1].map(|side| pairs.iter().map(|pair| pair[side]).collect());
    a.sort_by(f32::total_cmp);
    b.sort_by(f32::total_cmp);
    let rank = |code: f64| a.partition_point(|&mean| f64::from(mean) < code);
    for code in low.ceil() as u16..=HIGHEST_CODE as u16 {
        let ranks = rank(f64::from(code) - 1.0)..rank(f64::from(code) + 1.0);
        // At the ends of the common range, noise decides which patches are in it.
        let is_inside = ranks.start >= 2 * MIN_NEAR && ranks.end + 2 * MIN_NEAR <= a.len();
        if !is_inside || ranks.len() < MIN_NEAR {
            continue;
        }
        // The same ranks in both: right even where a scene has a few shades only.
        let mean = |sorted: &[f32]| sorted[ranks.clone()].iter().map(|&code| f64::from(code)).sum::<f64>();
        let n = ranks.len() as f64;
        matches.push(Match {
            codes: [mean(&a) / n, mean(&b) / n],
            log_ratio,
            patches: n,
        });
    }
}

/// One row per match: `g(a) − g(b) = ln(t(a) / t(b))`, g linear between codes.
struct Problem {
    rows: Vec<Row>,
    /// Second differences of g.
    bend: DMatrix<f64>,
    start: DVector<f64>,
}

struct Row {
    terms: [(usize, f64); 4],
    log_ratio: f64,
    sigma: f64,
}

impl Row {
    fn residual(&self, x: &DVector<f64>) -> f64 {
        self.terms.iter().map(|&(at, factor)| factor * x[at]).sum::<f64>() - self.log_ratio
    }
}

struct Fit {
    log_signal: Vec<f64>,
    cost: f64,
}

impl Problem {
    fn new(matches: &[Match], floor: f64) -> Self {
        let light: Vec<f64> = (0..CODES).map(|code| above_floor(code as f64, floor)).collect();
        let start = DVector::from_fn(CODES, |code, _| USUAL_EXPONENT * (light[code] / light[CODES - 1]).ln());
        let rows = matches.iter().map(|found| row(found, &start)).collect();
        let u: Vec<f64> = (0..CODES)
            .map(|code| light[code].ln() - (TOP - code as f64).ln())
            .collect();
        let mut bend = DMatrix::zeros(CODES - 2, CODES);
        for code in 1..CODES - 1 {
            let (before, after) = (u[code] - u[code - 1], u[code + 1] - u[code]);
            let scale = 1.0 / (BEND * (0.5 * (before + after)).sqrt());
            bend[(code - 1, code - 1)] = scale / before;
            bend[(code - 1, code)] = -scale * (1.0 / before + 1.0 / after);
            bend[(code - 1, code + 1)] = scale / after;
        }
        Self { rows, bend, start }
    }

    fn solve(&self) -> Fit {
        let mut smoothness = self.bend.tr_mul(&self.bend);
        smoothness[(ANCHOR, ANCHOR)] += FIXED;
        let mut x = self.start.clone();
        for round in 0..ROUNDS {
            let mut normal = smoothness.clone();
            let mut right = DVector::zeros(x.len());
            right[ANCHOR] = FIXED * self.start[ANCHOR];
            for row in &self.rows {
                let residual = row.residual(&x);
                // The first curve is only a guess: what is far from it may still be right.
                let scale = if round == 0 {
                    FIRST_OUTLIER
                } else {
                    OUTLIER_SIGMAS * row.sigma
                };
                let weight = row.sigma.powi(-2) / (1.0 + (residual / scale).powi(2));
                for &(i, factor_i) in &row.terms {
                    right[i] += weight * factor_i * row.log_ratio;
                    for &(j, factor_j) in &row.terms {
                        normal[(i, j)] += weight * factor_i * factor_j;
                    }
                }
            }
            let Some(cholesky) = normal.cholesky() else { break };
            let before = x;
            x = cholesky.solve(&right);
            pool_adjacent_violators(x.as_mut_slice());
            if round > 0 && (&x - before).amax() < SETTLED {
                break;
            }
        }
        let misfit: f64 = self
            .rows
            .iter()
            .map(|row| OUTLIER_SIGMAS.powi(2) * (row.residual(&x) / (OUTLIER_SIGMAS * row.sigma)).powi(2).ln_1p())
            .sum();
        Fit {
            cost: misfit + (&self.bend * &x).norm_squared(),
            log_signal: x.as_slice().to_vec(),
        }
    }
}

fn row(found: &Match, start: &DVector<f64>) -> Row {
    let mut terms = [(0, 0.0); 4];
    let mut variance = 0.0;
    for (side, (code, sign)) in found.codes.into_iter().zip([1.0, -1.0]).enumerate() {
        let below = (code as usize).min(CODES - 2);
        let part = code - below as f64;
        terms[2 * side] = (below, sign * (1.0 - part));
        terms[2 * side + 1] = (below + 1, sign * part);
        // A patch is uncertain by about a code.
        variance += (start[below + 1] - start[below]).powi(2);
    }
    Row {
        terms,
        log_ratio: found.log_ratio,
        sigma: (variance / found.patches + MODEL_ERROR.powi(2)).sqrt(),
    }
}

/// Code above the floor; below two codes it falls off exponentially instead of reaching 0.
fn above_floor(code: f64, floor: f64) -> f64 {
    let above = code - floor;
    if above >= 2.0 {
        above
    } else {
        2.0 * (0.5 * (above - 2.0)).exp()
    }
}

/// Makes values rise, changing them as little as possible (Ayer et al. 1955).
pub(crate) fn pool_adjacent_violators(values: &mut [f64]) {
    let mut blocks: Vec<(f64, usize)> = Vec::with_capacity(values.len());
    for &value in values.iter() {
        let mut block = (value, 1);
        while let Some(&(mean, n)) = blocks.last()
            && mean > block.0
        {
            block = (
                (mean * n as f64 + block.0 * block.1 as f64) / (n + block.1) as f64,
                n + block.1,
            );
            blocks.pop();
        }
        blocks.push(block);
    }
    let pooled = blocks.iter().flat_map(|&(mean, n)| std::iter::repeat_n(mean, n));
    for (value, pooled) in values.iter_mut().zip(pooled) {
        *value = pooled;
    }
}

/// The curve of log signals: 1 at the top, 0 at code 0, and up to the floor where there is one to speak of.
fn curve(log_signal: &[f64], floor: f64) -> ResponseCurve {
    let top = log_signal[CODES - 1];
    let black = if floor < MIN_ABOVE_FLOOR { 0.0 } else { floor };
    let values: Vec<f64> = (0..CODES)
        .map(|code| {
            if code as f64 <= black {
                0.0
            } else {
                (log_signal[code] - top).exp().clamp(0.0, 1.0)
            }
        })
        .collect();
    ResponseCurve::from_table(&values).expect("pooled values rise from 0 to 1")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn pooling_keeps_what_rises_and_averages_what_falls() {
        let mut values = [1.0, 3.0, 2.0, 1.0, 5.0];
        pool_adjacent_violators(&mut values);
        assert_eq!(values, [1.0, 2.0, 2.0, 2.0, 5.0]);
    }

    proptest! {
        #[test]
        fn pooled_values_rise_and_keep_their_sum(mut values in prop::collection::vec(-5.0f64..5.0, 1..40)) {
            let sum: f64 = values.iter().sum();
            pool_adjacent_violators(&mut values);
            prop_assert!(values.windows(2).all(|pair| pair[0] <= pair[1]));
            prop_assert!((values.iter().sum::<f64>() - sum).abs() < 1e-9);
        }
    }
}
