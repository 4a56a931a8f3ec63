//! Median and percentiles of few samples.

use serde::Serialize;

/// Middle and upper end of a set of errors, all in the unit of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The median.
    pub median: f64,
    /// The 95th percentile by nearest rank: a value of the set that at least 95 % of the samples do not exceed.
    pub p95: f64,
    /// The largest sample.
    pub worst: f64,
}

impl Spread {
    /// Summarises the samples; `None` when there are none.
    pub fn of(mut samples: Vec<f64>) -> Option<Self> {
        samples.sort_by(f64::total_cmp);
        let worst = *samples.last()?;
        let rank = (samples.len() * 95).div_ceil(100);
        Some(Self {
            median: sorted_median(&samples),
            p95: samples[rank - 1],
            worst,
        })
    }
}

/// Returns the median, of an even number of samples the mean of the middle two; `None` when there are none.
pub fn median(mut samples: Vec<f64>) -> Option<f64> {
    samples.sort_by(f64::total_cmp);
    (!samples.is_empty()).then(|| sorted_median(&samples))
}

/// Returns the median of sorted samples, of which there is at least one.
fn sorted_median(samples: &[f64]) -> f64 {
    let middle = samples.len() / 2;
    if samples.len() % 2 == 1 {
        samples[middle]
    } else {
        0.5 * (samples[middle - 1] + samples[middle])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentile_is_a_sample_that_95_of_100_do_not_exceed() {
        let spread = Spread::of((1..=100).rev().map(f64::from).collect()).unwrap();
        assert_eq!(
            spread,
            Spread {
                median: 50.5,
                p95: 95.0,
                worst: 100.0
            }
        );
        assert_eq!(
            Spread::of(vec![3.0]).unwrap(),
            Spread {
                median: 3.0,
                p95: 3.0,
                worst: 3.0
            }
        );
        assert_eq!(Spread::of(vec![]), None);
        assert_eq!(median(vec![2.0, 9.0, 1.0]), Some(2.0));
    }
}
