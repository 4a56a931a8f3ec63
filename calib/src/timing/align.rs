//! Offset and drift between two cameras' clocks from the edges of one blinking light.

use super::{ClockOffset, MIN_EDGES, TimingError, blink::Edge};

/// Expected drift of two quartz clocks against each other.
const DRIFT_SIGMA: f64 = 2e-4;
/// Least standard deviation of an edge, seconds: lights take time to change.
const LEAST_SIGMA_S: f64 = 3e-5;
/// Share of pairs that are expected to be wrong.
const WRONG: f64 = 0.02;
/// Step of the first search, seconds.
const STEP_S: f64 = 1e-3;
/// Share of edges that must fit.
const MIN_AGREEING: f64 = 0.6;
/// Another offset that fits this share of what the best one fits is as good.
const AS_GOOD: f64 = 0.85;
/// Grid of the posterior in either direction, and how often it is narrowed.
const GRID: (i32, usize) = (12, 7);

/// Two edges that may be one event.
struct Pair<'a> {
    a: &'a Edge,
    b: &'a Edge,
}

/// Finds the offset of clock B against clock A, looked for within ± `max_offset_s`.
///
/// An edge that both cameras have only seen to lie in a gap still says that the offset is not smaller than one difference of the gaps'
/// ends and not larger than the other; its likelihood is the length of their overlap. The posterior of offset and drift is
/// summed over a grid, which is narrowed around its mean; so its standard deviation is right for spans as for instants.
///
/// # Errors
/// [`TimingError::NoAgreement`], [`TimingError::Ambiguous`], [`TimingError::TooFewEdges`].
pub fn clock_offset(a: &[Edge], b: &[Edge], max_offset_s: f64) -> Result<ClockOffset, TimingError> {
    let (coarse_s, share) = coarse(a, b, [-max_offset_s, max_offset_s])?;
    let reach_s = typical_width(a) + typical_width(b);
    let pairs: Vec<Pair<'_>> = a
        .iter()
        .filter_map(|edge| {
            let other = partner(edge, b, coarse_s)?;
            ((other.middle_s() - edge.middle_s() - coarse_s).abs() <= reach_s + 0.01)
                .then_some(Pair { a: edge, b: other })
        })
        .collect();
    if pairs.len() < MIN_EDGES {
        return Err(TimingError::NoAgreement { share });
    }
    let at_s = 0.5 * (pairs[0].a.middle_s() + pairs[pairs.len() - 1].a.middle_s());
    let posterior = Posterior {
        pairs,
        at_s,
        wrong: WRONG / (2.0 * max_offset_s),
    };
    let [mean, sigma] = posterior.moments(coarse_s, 0.5 * reach_s + 5.0 * STEP_S);
    Ok(ClockOffset {
        offset_s: mean[0],
        offset_sigma_s: sigma[0],
        drift: mean[1],
        drift_sigma: sigma[1],
        at_s,
        n_used: posterior.pairs.len(),
        agreeing: share,
    })
}

/// The offset on which most edges agree, within a range, and their share.
pub(super) fn coarse(a: &[Edge], b: &[Edge], range_s: [f64; 2]) -> Result<(f64, f64), TimingError> {
    let n = ((range_s[1] - range_s[0]) / STEP_S).ceil() as usize;
    let tried: Vec<(f64, f64, f64)> = (0..=n)
        .map(|step| {
            let offset_s = range_s[0] + step as f64 * STEP_S;
            let (share, score) = agreement(a, b, offset_s);
            (offset_s, share, score)
        })
        .collect();
    let &(best_s, share, _) = tried
        .iter()
        .max_by(|x, y| x.2.total_cmp(&y.2))
        .ok_or(TimingError::NoAgreement { share: 0.0 })?;
    if share < MIN_AGREEING {
        return Err(TimingError::NoAgreement { share });
    }
    let beside_s = typical_width(a) + typical_width(b) + 0.02;
    let others = tried
        .iter()
        .filter(|(offset_s, ..)| (offset_s - best_s).abs() > beside_s);
    if let Some(&(other_s, other_share, _)) = others.max_by(|x, y| x.2.total_cmp(&y.2))
        && other_share > AS_GOOD * share
    {
        return Err(TimingError::Ambiguous {
            offset_s: best_s,
            other_s,
        });
    }
    Ok((best_s, share))
}

/// The 90th percentile of the spans' widths, seconds.
fn typical_width(edges: &[Edge]) -> f64 {
    let mut widths: Vec<f64> = edges.iter().map(Edge::width_s).collect();
    widths.sort_by(f64::total_cmp);
    widths[(0.9 * (widths.len() - 1) as f64) as usize]
}

/// Share of A's edges that have an edge of B at an offset, and their mean log-likelihood, smoothed by a few steps. Edges that B
/// could not see count neither way.
fn agreement(a: &[Edge], b: &[Edge], offset_s: f64) -> (f64, f64) {
    const SOFT_S: f64 = 4.0 * STEP_S;
    let (Some(first), Some(last)) = (b.first(), b.last()) else {
        return (0.0, f64::NEG_INFINITY);
    };
    let (mut n, mut n_fit, mut score) = (0, 0, 0.0);
    for edge in a {
        let expected = edge.middle_s() + offset_s;
        if expected < first.between_s[0] || expected > last.between_s[1] {
            continue;
        }
        n += 1;
        let likelihood = partner(edge, b, offset_s).map_or(0.0, |other| likelihood(edge, other, offset_s, SOFT_S));
        let allowed = 0.02 / (edge.width_s() + SOFT_S);
        n_fit += usize::from(likelihood > allowed);
        score += (likelihood + 0.1).ln();
    }
    // Two recordings that hardly overlap prove nothing.
    if 3 * n < a.len().min(b.len()) || n < MIN_EDGES {
        return (0.0, f64::NEG_INFINITY);
    }
    (
        f64::from(n_fit as u32) / f64::from(n as u32),
        score / f64::from(n as u32),
    )
}

/// B's edge of the same kind that is nearest to one of A's.
pub(super) fn partner<'a>(edge: &Edge, b: &'a [Edge], offset_s: f64) -> Option<&'a Edge> {
    let expected = edge.middle_s() + offset_s;
    let after = b.partition_point(|other| other.middle_s() < expected);
    let near = &b[after.saturating_sub(2)..(after + 2).min(b.len())];
    near.iter()
        .filter(|other| other.is_rising == edge.is_rising)
        .min_by(|x, y| {
            (x.middle_s() - expected)
                .abs()
                .total_cmp(&(y.middle_s() - expected).abs())
        })
}

/// Probability density of a difference of two edges, each evenly distributed over its span and blurred: a trapezium with soft
/// corners, by differences of the second integral of the normal density.
fn likelihood(a: &Edge, b: &Edge, offset_s: f64, soft_s: f64) -> f64 {
    /// Spans shorter than this part of the blur are instants.
    const INSTANT: f64 = 0.5;
    let sigma = a.sigma_s.hypot(b.sigma_s).hypot(soft_s).max(LEAST_SIGMA_S);
    let width = |edge: &Edge| edge.width_s().max(INSTANT * sigma);
    let (wide, narrow) = (width(a).max(width(b)), width(a).min(width(b)));
    let off = offset_s - (b.middle_s() - a.middle_s());
    let ramp = |x: f64| {
        let z = x / sigma;
        x * normal_below(z) + sigma * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()
    };
    let (far, near) = (0.5 * (wide + narrow), 0.5 * (wide - narrow));
    ((ramp(off + far) - ramp(off + near) - ramp(off - near) + ramp(off - far)) / (wide * narrow)).max(0.0)
}

/// The normal distribution function, to 1e-7 (Abramowitz and Stegun 1964, 26.2.17).
fn normal_below(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series = [
        1.330_274_429,
        -1.821_255_978,
        1.781_477_937,
        -0.356_563_782,
        0.319_381_530,
    ];
    let tail = series.iter().fold(0.0, |sum, c| sum * t + c) * t;
    let tail = tail * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    if z > 0.0 { 1.0 - tail } else { tail }
}

struct Posterior<'a> {
    pairs: Vec<Pair<'a>>,
    at_s: f64,
    /// Density of wrong pairs, 1/seconds.
    wrong: f64,
}

impl Posterior<'_> {
    fn log(&self, offset_s: f64, drift: f64) -> f64 {
        let pairs = self.pairs.iter().map(|pair| {
            let offset_s = offset_s + drift * (pair.a.middle_s() - self.at_s);
            ((1.0 - WRONG) * likelihood(pair.a, pair.b, offset_s, 0.0) + self.wrong).ln()
        });
        pairs.sum::<f64>() - 0.5 * (drift / DRIFT_SIGMA).powi(2)
    }

    /// Means and standard deviations of offset and drift.
    fn moments(&self, start_s: f64, reach_s: f64) -> [[f64; 2]; 2] {
        let (mut mean, mut sigma) = ([start_s, 0.0], [reach_s / 5.0, DRIFT_SIGMA]);
        let (half, rounds) = GRID;
        for _ in 0..rounds {
            // Five standard deviations either way; the first rounds may have found nothing but the start.
            let at = |axis: usize, i: i32| mean[axis] + 5.0 * sigma[axis] * f64::from(i) / f64::from(half);
            let places = (-half..=half).flat_map(|i| (-half..=half).map(move |j| (i, j)));
            let logs: Vec<([f64; 2], f64)> = places
                .map(|(i, j)| ([at(0, i), at(1, j)], self.log(at(0, i), at(1, j))))
                .collect();
            let most = logs.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
            let total: f64 = logs.iter().map(|(_, log)| (log - most).exp()).sum();
            let expect = |of: &dyn Fn(&[f64; 2]) -> f64| {
                logs.iter()
                    .map(|(place, log)| (log - most).exp() * of(place))
                    .sum::<f64>()
                    / total
            };
            let next: [f64; 2] = std::array::from_fn(|axis| expect(&|place| place[axis]));
            let spread: [f64; 2] =
                std::array::from_fn(|axis| expect(&|place| (place[axis] - next[axis]).powi(2)).sqrt());
            // Not below the grid's own step, which a narrower peak hides in.
            let steps = sigma.map(|s| 0.6 * 5.0 * s / f64::from(half));
            mean = next;
            sigma = [spread[0].max(steps[0]), spread[1].max(steps[1])];
        }
        [mean, sigma]
    }
}
