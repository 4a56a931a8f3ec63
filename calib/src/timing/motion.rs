//! Offset and drift between two cameras' clocks from a marker that moves, or that they move past together.
//!
//! As long as the cameras do not move against each other, where B sees the marker is a smooth function of where, and how
//! large, A sees it. That function (a quadratic polynomial, whose coefficients are solved with the offset) and the offset
//! are those that predict B's places best from A's path: no lens or pose need be known.

use nalgebra::{DMatrix, DVector};

use super::{ClockOffset, MIN_PICTURES, TimingError, median};

/// Terms of the polynomial: 1, u, v, s, and their products.
const TERMS: usize = 10;
/// Step of the first search, seconds.
const STEP_S: f64 = 5e-3;
/// Neighbouring pictures further apart than this many intervals are not joined.
const MAX_GAP: f64 = 2.5;
/// Least standard deviation of the marker's place, pixels.
const MIN_SPREAD_PX: f64 = 5.0;
/// Another offset whose mean squared error is at most this many times the best one's is as good.
const AS_GOOD: f64 = 3.0;
/// Share of the motion's variance that must be explained.
const MIN_EXPLAINED: f64 = 0.9;
/// Least standard deviation of the offset, seconds: the polynomial is not quite what relates the two pictures. Simulated cameras at
/// 37° to each other scatter by this much.
const MODEL_SIGMA_S: f64 = 1e-4;
/// Iterations of the refinement.
const ITERATIONS: usize = 20;

/// A marker in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Middle of the exposure on the camera's clock, seconds.
    pub middle_s: f64,
    /// Middle of the marker, pixels.
    pub place_px: [f64; 2],
    /// Mean side of the marker, pixels.
    pub side_px: f64,
}

/// Finds the offset of clock B against clock A within ± `max_offset_s` from what both saw of one marker, in order of time.
///
/// # Errors
/// [`TimingError`] when they do not tell.
pub fn clock_offset(a: &[Sighting], b: &[Sighting], max_offset_s: f64) -> Result<ClockOffset, TimingError> {
    for (camera, path) in [("A", a), ("B", b)] {
        if path.len() < MIN_PICTURES {
            return Err(TimingError::TooFewPictures { n: path.len() });
        }
        let spread_px = spread_px(path);
        if spread_px < MIN_SPREAD_PX {
            return Err(TimingError::NothingMoves {
                camera: camera.to_owned(),
                spread_px,
            });
        }
    }
    let problem = Problem::new(a, b);
    let n = (max_offset_s / STEP_S).ceil() as i32;
    let tried: Vec<(f64, f64)> = (-n..=n)
        .filter_map(|step| {
            let offset_s = f64::from(step) * STEP_S;
            Some((offset_s, problem.fit(offset_s, 0.0)?.mean_square()))
        })
        .collect();
    let &(coarse_s, _) = tried
        .iter()
        .min_by(|x, y| x.1.total_cmp(&y.1))
        .ok_or(TimingError::TooFewPictures { n: 0 })?;
    let found = problem.refine(coarse_s)?;
    let least = found.1;
    let is_dip = |window: &[(f64, f64)]| window[1].1 < window[0].1 && window[1].1 < window[2].1;
    let other = tried.windows(3).filter(|window| is_dip(window)).map(|window| window[1]);
    let other = other
        .filter(|(offset_s, _)| (offset_s - coarse_s).abs() > 4.0 * STEP_S)
        .filter_map(|(offset_s, _)| problem.refine(offset_s).ok())
        .map(|(other, square)| (other.offset_s, square))
        .find(|(offset_s, square)| *square < AS_GOOD * least && (offset_s - found.0.offset_s).abs() > 4.0 * STEP_S);
    if let Some((other_s, _)) = other {
        return Err(TimingError::Ambiguous {
            offset_s: found.0.offset_s,
            other_s,
        });
    }
    Ok(found.0)
}

fn spread_px(path: &[Sighting]) -> f64 {
    let n = path.len() as f64;
    let mean = |axis: usize| path.iter().map(|s| s.place_px[axis]).sum::<f64>() / n;
    let variance = |axis: usize| {
        path.iter()
            .map(|s| (s.place_px[axis] - mean(axis)).powi(2))
            .sum::<f64>()
            / n
    };
    (variance(0) + variance(1)).sqrt()
}

struct Problem<'a> {
    a: &'a [Sighting],
    b: &'a [Sighting],
    at_s: f64,
    gap_s: f64,
    /// Middle and scale of A's u, v, s.
    scale: [[f64; 2]; 3],
    variance: f64,
}

/// What a fit leaves.
struct Fit {
    /// Both coordinates of each picture, one after the other; robustly weighted.
    residuals: DVector<f64>,
    features: DMatrix<f64>,
    times_s: Vec<f64>,
}

impl Fit {
    /// Robust mean squared error of a coordinate.
    fn mean_square(&self) -> f64 {
        (1.4826 * median(self.residuals.iter().map(|r| r.abs()).collect())).powi(2)
    }
}

impl<'a> Problem<'a> {
    fn new(a: &'a [Sighting], b: &'a [Sighting]) -> Self {
        let value = |s: &Sighting, axis: usize| [s.place_px[0], s.place_px[1], s.side_px][axis];
        let scale = std::array::from_fn(|axis| {
            let n = a.len() as f64;
            let mean = a.iter().map(|s| value(s, axis)).sum::<f64>() / n;
            let deviation = (a.iter().map(|s| (value(s, axis) - mean).powi(2)).sum::<f64>() / n).sqrt();
            [mean, deviation.max(1.0)]
        });
        Self {
            a,
            b,
            at_s: 0.5 * (a[0].middle_s + a[a.len() - 1].middle_s),
            gap_s: MAX_GAP * median(a.windows(2).map(|pair| pair[1].middle_s - pair[0].middle_s).collect()),
            scale,
            variance: 0.5 * spread_px(b).powi(2),
        }
    }

    /// A's u, v, s at a time by a cubic through four pictures (Hermite, tangents from neighbours); `None` in gaps.
    fn path(&self, time_s: f64) -> Option<[f64; 3]> {
        let after = self.a.partition_point(|s| s.middle_s <= time_s);
        let four = self.a.get(after.checked_sub(2)?..after + 2)?;
        if four
            .windows(2)
            .any(|pair| pair[1].middle_s - pair[0].middle_s > self.gap_s)
        {
            return None;
        }
        let t: [f64; 4] = std::array::from_fn(|i| four[i].middle_s);
        let width = t[2] - t[1];
        let x = (time_s - t[1]) / width;
        Some(std::array::from_fn(|axis| {
            let v: [f64; 4] =
                std::array::from_fn(|i| [four[i].place_px[0], four[i].place_px[1], four[i].side_px][axis]);
            // The slope of the parabola through three neighbours.
            let slope = |i: usize| {
                let (before, behind) = (t[i] - t[i - 1], t[i + 1] - t[i]);
                let (first, second) = ((v[i] - v[i - 1]) / before, (v[i + 1] - v[i]) / behind);
                (first * behind + second * before) / (before + behind)
            };
            let (m1, m2) = (slope(1) * width, slope(2) * width);
            let (x2, x3) = (x * x, x * x * x);
            (2.0 * x3 - 3.0 * x2 + 1.0) * v[1]
                + (x3 - 2.0 * x2 + x) * m1
                + (3.0 * x2 - 2.0 * x3) * v[2]
                + (x3 - x2) * m2
        }))
    }

    fn features(&self, uvs: [f64; 3]) -> [f64; TERMS] {
        let [u, v, s]: [f64; 3] = std::array::from_fn(|axis| (uvs[axis] - self.scale[axis][0]) / self.scale[axis][1]);
        [1.0, u, v, s, u * u, u * v, v * v, u * s, v * s, s * s]
    }

    /// The best polynomial at an offset; `None` where too few pictures can be compared.
    fn fit(&self, offset_s: f64, drift: f64) -> Option<Fit> {
        let rows: Vec<(f64, [f64; TERMS], [f64; 2])> = self
            .b
            .iter()
            .filter_map(|s| {
                let time_s = s.middle_s - offset_s - drift * (s.middle_s - offset_s - self.at_s);
                Some((time_s, self.features(self.path(time_s)?), s.place_px))
            })
            .collect();
        if rows.len() < MIN_PICTURES.max(self.b.len() / 3) {
            return None;
        }
        let features = DMatrix::from_fn(rows.len(), TERMS, |i, j| rows[i].1[j]);
        let places = DMatrix::from_fn(rows.len(), 2, |i, axis| rows[i].2[axis]);
        let left = project_out(&features, &places)?;
        Some(Fit {
            residuals: DVector::from_iterator(2 * rows.len(), left.iter().copied()),
            features,
            times_s: rows.iter().map(|row| row.0).collect(),
        })
    }

    /// Gauss and Newton's method on offset and drift, the polynomial solved within (Golub and Pereyra 1973), derivatives by
    /// differences. Returns the mean squared error too.
    fn refine(&self, start_s: f64) -> Result<(ClockOffset, f64), TimingError> {
        const NUDGE_S: f64 = 5e-4;
        /// Expected drift, as prior.
        const DRIFT_SIGMA: f64 = 2e-4;
        let (mut offset_s, mut drift) = (start_s, 0.0);
        let none = TimingError::NoAgreement { share: 0.0 };
        for iteration in 0..ITERATIONS {
            let here = self.fit(offset_s, drift).ok_or(none.clone())?;
            let ahead = self.fit(offset_s + NUDGE_S, drift).ok_or(none.clone())?;
            let behind = self.fit(offset_s - NUDGE_S, drift).ok_or(none.clone())?;
            if ahead.times_s.len() != here.times_s.len() || behind.times_s.len() != here.times_s.len() {
                // A picture at the brink of a gap: away from there.
                offset_s += 0.37 * NUDGE_S;
                continue;
            }
            let n = here.times_s.len();
            let by_offset = (&ahead.residuals - &behind.residuals) / (2.0 * NUDGE_S);
            let by_drift = DMatrix::from_fn(n, 2, |i, axis| by_offset[axis * n + i] * (here.times_s[i] - self.at_s));
            let by_drift = project_out(&here.features, &by_drift).ok_or(none.clone())?;
            let square = here.mean_square().max(1e-8);
            let (mut normal, mut gradient) = (nalgebra::Matrix2::zeros(), nalgebra::Vector2::zeros());
            for i in 0..2 * n {
                let row = nalgebra::Vector2::new(by_offset[i], by_drift[i]);
                let residual = here.residuals[i];
                let deviation = residual.abs() / square.sqrt();
                let (_, weight) = crate::least_squares::loss::Loss::Huber.cost_and_weight(deviation);
                normal += row * row.transpose() * (weight / square);
                gradient += row * (residual * weight / square);
            }
            normal[(1, 1)] += DRIFT_SIGMA.powi(-2);
            gradient[1] += drift * DRIFT_SIGMA.powi(-2);
            let covariance = normal.try_inverse().ok_or(none.clone())?;
            let step = covariance * gradient;
            offset_s -= step[0].clamp(-0.02, 0.02);
            drift -= step[1];
            // Pictures at the brink of a gap come and go and may keep steps from becoming short.
            if (step[0].abs() < 1e-7 && step[1].abs() < 1e-8) || iteration + 1 == ITERATIONS {
                let explained = 1.0 - square / self.variance;
                if explained < MIN_EXPLAINED {
                    return Err(TimingError::NoAgreement {
                        share: explained.max(0.0),
                    });
                }
                let result = ClockOffset {
                    offset_s,
                    offset_sigma_s: covariance[(0, 0)].sqrt().hypot(MODEL_SIGMA_S),
                    drift,
                    drift_sigma: covariance[(1, 1)].sqrt(),
                    at_s: self.at_s,
                    n_used: n,
                    agreeing: explained,
                };
                return Ok((result, square));
            }
        }
        Err(TimingError::NotConverged)
    }
}

/// What features do not explain of columns.
fn project_out(features: &DMatrix<f64>, columns: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // A little damping: a motion along a line leaves terms open.
    let normal = features.transpose() * features + DMatrix::identity(TERMS, TERMS) * (1e-6 * features.nrows() as f64);
    let coefficients = normal.cholesky()?.solve(&(features.transpose() * columns));
    Some(columns - features * coefficients)
}
