//! High dynamic range: several exposures of one place become one radiance.
//!
//! [`noise`] says what one 8-bit sample knows, [`fn@merge`] joins samples of one place, [`motion`] tells regions in which
//! something has moved between two exposures, [`stack`] merges aligned pictures.
//!
//! The radiance is the one of maximum likelihood: the mean of the unclipped samples weighted by the inverse of their
//! variances, where each variance is the one that the *merged* radiance would cause, found by iteration (Granados et al.
//! 2010, "Optimal HDR reconstruction with linear digital cameras"; Robertson et al. 2003 for inverse-variance
//! weights from the response). A sample's own value must not set its weight: low outliers would count for more.
//!
//! A clipped sample says "at least", a black one "at most". Samples that contradict each other show that something has
//! changed; then the newest are believed.

pub mod exposure_list;
pub mod motion;
pub mod noise;
#[cfg(test)]
pub(crate) mod simulate;
pub mod stack;

/// Rounds of weighting by the merged radiance: eight more change it by less than 0.05 % (simulated, 5 standard deviations of
/// read noise and up).
const ROUNDS: usize = 2;

/// The same where only contradictions are looked for.
const ROUNDS_TO_COMPARE: usize = 1;

/// Degrees of freedom for which limits are tabulated.
const MAX_FREEDOM: usize = 32;

/// Where on the camera's scale a sample lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Clipping {
    /// Between the ends: the radiance is measured.
    #[default]
    None,
    /// At the bright end: the radiance is at least this.
    Above,
    /// At the dark end: the radiance is at most about the noise.
    Below,
}

/// What one exposure says about one place, in one channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Radiance, or the bound of it.
    pub radiance: f32,
    /// Shot noise: variance of the radiance per unit of radiance; 0 or more.
    pub shot: f32,
    /// Variance of the radiance in the dark: read noise and rounding; above 0.
    pub floor: f32,
    /// What the radiance means.
    pub clipping: Clipping,
}

impl Sample {
    /// Variance that the sample would have if `radiance` arrived.
    #[inline]
    #[must_use]
    pub fn variance_at(&self, radiance: f32) -> f32 {
        self.shot * radiance.max(0.0) + self.floor
    }
}

/// What is known of a merged radiance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// At least one exposure measured it.
    Measured,
    /// All exposures clipped: the radiance is at least this.
    AtLeast,
    /// All exposures were black: the radiance is at most about two standard deviations above this.
    AtMost,
}

/// One radiance out of several exposures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Radiance, or the bound of it.
    pub radiance: f32,
    /// Its variance.
    pub variance: f32,
    /// What the radiance means.
    pub state: State,
    /// Number of newest samples that went in. The others contradict them: something has changed.
    pub trusted: usize,
}

/// When samples contradict each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Consistency {
    tolerance: f32,
    limits: [f32; MAX_FREEDOM + 1],
}

impl Consistency {
    /// Samples agree while the sum of their squared normalised residuals is as likely as a normal deviation of up to `sigmas`
    /// standard deviations, when each sample may also be off by `tolerance` times the radiance (response, exposure times and
    /// alignment are not exact).
    ///
    /// Both are 0 or more; `sigmas` 4 to 6 and a `tolerance` of 0.02 to 0.1 are usual.
    #[must_use]
    pub fn new(sigmas: f32, tolerance: f32) -> Self {
        Self {
            tolerance,
            limits: std::array::from_fn(|freedom| chi_square_limit(freedom, sigmas)),
        }
    }

    /// Variance of the difference between `sample` and a merged radiance.
    fn variance(&self, sample: &Sample, radiance: f32) -> f32 {
        sample.variance_at(radiance) + (self.tolerance * radiance).powi(2)
    }

    /// Whether the samples agree with each other.
    fn holds<'a>(&self, samples: impl Iterator<Item = &'a Sample> + Clone) -> bool {
        let variance = |sample: &Sample, radiance: f32| self.variance(sample, radiance);
        let Some((mean, _)) = weighted_mean(&samples, variance, ROUNDS_TO_COMPARE) else {
            // Bounds of one kind only.
            return true;
        };
        let (mut chi_square, mut freedom) = (0.0, 0);
        for sample in samples {
            let residual = mean - sample.radiance;
            let counts = match sample.clipping {
                Clipping::None | Clipping::Below => true,
                Clipping::Above => residual < 0.0,
            };
            if counts {
                chi_square += residual * residual / self.variance(sample, mean);
                freedom += 1;
            }
        }
        // The mean took one degree of freedom.
        freedom < 2 || chi_square <= self.limits[(freedom - 1).min(MAX_FREEDOM)]
    }
}

impl Default for Consistency {
    /// 5 standard deviations, 3 %.
    fn default() -> Self {
        Self::new(5.0, 0.03)
    }
}

/// The value of χ² that is exceeded as rarely as `sigmas` standard deviations of a normal variable on one side (Wilson and
/// Hilferty 1931).
fn chi_square_limit(freedom: usize, sigmas: f32) -> f32 {
    let d = freedom.max(1) as f32;
    let spread = 2.0 / (9.0 * d);
    d * (1.0 - spread + sigmas * spread.sqrt()).powi(3)
}

/// Merges samples of one place, oldest first.
///
/// When they contradict each other, the longest run of newest samples that agree is merged; the estimate says how many. `None`
/// when there is no sample.
#[must_use]
pub fn merge(samples: &[Sample], consistency: &Consistency) -> Option<Estimate> {
    let trusted = trusted(samples, |sample| sample, consistency);
    estimate(&samples[samples.len() - trusted..].iter(), trusted)
}

/// Merges samples of one place in three channels, oldest first; all channels come from the same samples.
///
/// `None` when there is no sample.
#[must_use]
pub fn merge_rgb(samples: &[[Sample; 3]], consistency: &Consistency) -> Option<[Estimate; 3]> {
    let trusted = (0..3)
        .map(|channel| trusted(samples, |rgb| &rgb[channel], consistency))
        .min()
        .unwrap_or(0);
    let newest = &samples[samples.len() - trusted..];
    let of = |channel: usize| estimate(&newest.iter().map(move |rgb| &rgb[channel]), trusted);
    Some([of(0)?, of(1)?, of(2)?])
}

/// How many of the newest places' samples agree with each other.
fn trusted<T>(places: &[T], sample: impl Fn(&T) -> &Sample + Copy, consistency: &Consistency) -> usize {
    let newest_hold = |n: usize| consistency.holds(places[places.len() - n..].iter().map(sample));
    if newest_hold(places.len()) {
        return places.len();
    }
    (1..places.len()).take_while(|&n| newest_hold(n)).last().unwrap_or(0)
}

/// The radiance of maximum likelihood of samples that are trusted.
fn estimate<'a>(samples: &(impl Iterator<Item = &'a Sample> + Clone), trusted: usize) -> Option<Estimate> {
    let measured = samples.clone().any(|sample| sample.clipping == Clipping::None);
    let bound = samples
        .clone()
        .filter(|sample| sample.clipping == Clipping::Above)
        .max_by(|a, b| a.radiance.total_cmp(&b.radiance));
    let (radiance, variance, state) = match bound {
        Some(bound) if !measured => (bound.radiance, bound.variance_at(bound.radiance), State::AtLeast),
        Some(_) | None => {
            let (radiance, variance) = weighted_mean(samples, Sample::variance_at, ROUNDS)?;
            let state = if measured { State::Measured } else { State::AtMost };
            (radiance, variance, state)
        }
    };
    Some(Estimate {
        radiance,
        variance,
        state,
        trusted,
    })
}

/// Mean of the samples that are not clipped above, weighted by the inverse of `variance` at that mean, and its variance.
///
/// Black samples count as the measurement 0 that they are: leaving them out would brighten the dark.
fn weighted_mean<'a>(
    samples: &(impl Iterator<Item = &'a Sample> + Clone),
    variance: impl Fn(&Sample, f32) -> f32,
    rounds: usize,
) -> Option<(f32, f32)> {
    let mean_at = |merged: Option<f32>| {
        let (mut weights, mut sum) = (0.0, 0.0);
        for sample in samples.clone() {
            if sample.clipping != Clipping::Above {
                let weight = 1.0 / variance(sample, merged.unwrap_or(sample.radiance));
                weights += weight;
                sum += weight * sample.radiance;
            }
        }
        (sum / weights, 1.0 / weights)
    };
    let (mut mean, mut mean_variance) = mean_at(None);
    for _ in 0..rounds {
        (mean, mean_variance) = mean_at(Some(mean));
    }
    mean.is_finite().then_some((mean, mean_variance))
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use mirrorball_capture::frame::Exposure;
    use proptest::prelude::*;

    use super::{
        noise::VarianceTable,
        simulate::{Random, knee},
        *,
    };
    use crate::{photometry::Photometry, response::ResponseCurve};

    /// A camera and the tables of a bracket of exposures.
    struct Bracket {
        photometry: Photometry,
        exposures: Vec<Exposure>,
        tables: Vec<VarianceTable>,
    }

    impl Bracket {
        /// `n` exposures, each 4 times as long as the one before.
        fn new(response: ResponseCurve, n: i32) -> Self {
            let photometry = Photometry {
                sensitivity: 40.0,
                vignetting: [0.0, 0.0],
                full_well_e: 12_000.0,
                read_noise_e: 6.0,
                response,
                color: DMat3::IDENTITY,
            };
            let exposures: Vec<Exposure> = (0..n)
                .map(|step| Exposure {
                    time_s: 1e-4 * 4f64.powi(step),
                    gain: 1.0,
                    white_balance: [1.0, 1.0, 1.0],
                })
                .collect();
            let tables = exposures
                .iter()
                .map(|exposure| VarianceTable::new(&photometry, exposure))
                .collect();
            Self {
                photometry,
                exposures,
                tables,
            }
        }

        fn shoot(&self, step: usize, radiance: f64, random: &mut Random) -> Sample {
            let noise = self.photometry.channel_noise(&self.exposures[step])[1];
            let code = random.code(&self.photometry.response, &noise, radiance);
            self.tables[step].channels()[1].sample(code, 1.0)
        }

        fn all(&self, radiance: f64, random: &mut Random) -> Vec<Sample> {
            (0..self.tables.len())
                .map(|step| self.shoot(step, radiance, random))
                .collect()
        }
    }

    /// Mean and variance of merged radiances, and the mean of the variances that they claim.
    fn statistics(bracket: &Bracket, radiance: f64) -> [f64; 3] {
        let mut random = Random::new(11);
        let n = 20_000;
        let merged: Vec<Estimate> = (0..n)
            .map(|_| merge(&bracket.all(radiance, &mut random), &Consistency::default()).unwrap())
            .collect();
        let mean = |of: &dyn Fn(&Estimate) -> f64| merged.iter().map(of).sum::<f64>() / f64::from(n);
        let radiance = mean(&|e| f64::from(e.radiance));
        [
            radiance,
            mean(&|e| (f64::from(e.radiance) - radiance).powi(2)),
            mean(&|e| f64::from(e.variance)),
        ]
    }

    #[test]
    fn merged_radiance_is_unbiased_and_as_uncertain_as_it_says() {
        for response in [ResponseCurve::srgb(), knee()] {
            for n in 2..=5 {
                let bracket = Bracket::new(response.clone(), n);
                // Full scale is at 250 in the shortest exposure.
                for radiance in [3.0, 12.0, 40.0, 90.0, 170.0] {
                    let [mean, variance, claimed] = statistics(&bracket, radiance);
                    let case = format!("{n} exposures, radiance {radiance}: {mean}");
                    assert!((mean / radiance - 1.0).abs() < 0.005, "{case}");
                    let ratio = variance / claimed;
                    assert!(
                        (0.9..1.1).contains(&ratio),
                        "{case}, variance {ratio} times the claimed"
                    );
                }
            }
        }
    }

    #[test]
    fn merging_beats_the_best_exposure() {
        let bracket = Bracket::new(ResponseCurve::srgb(), 3);
        let mut random = Random::new(3);
        // In the longest exposure it is at 0.8 of full scale.
        let radiance = 0.8 / (40.0 * 1.6e-3);
        let mut squares = [0.0; 2];
        for _ in 0..20_000 {
            let samples = bracket.all(radiance, &mut random);
            let merged = merge(&samples, &Consistency::default()).unwrap().radiance;
            squares[0] += (f64::from(merged) - radiance).powi(2);
            squares[1] += (f64::from(samples[2].radiance) - radiance).powi(2);
        }
        assert!(squares[0] < 0.85 * squares[1], "{squares:?}");
    }

    #[test]
    fn a_lamp_that_clips_in_all_but_the_shortest_exposure_is_measured() {
        let mut random = Random::new(5);
        for n in 2..=5 {
            let bracket = Bracket::new(knee(), n);
            let lamp = 200.0;
            let samples = bracket.all(lamp, &mut random);
            assert!(samples[1..].iter().all(|sample| sample.clipping == Clipping::Above));
            let merged = merge(&samples, &Consistency::default()).unwrap();
            assert_eq!((merged.state, merged.trusted), (State::Measured, n as usize));
            assert!((f64::from(merged.radiance) / lamp - 1.0).abs() < 0.06, "{merged:?}");
        }
    }

    #[test]
    fn what_clips_everywhere_is_a_bound_and_so_is_black() {
        let mut random = Random::new(5);
        let bracket = Bracket::new(ResponseCurve::srgb(), 3);
        let merged = merge(&bracket.all(1e4, &mut random), &Consistency::default()).unwrap();
        assert_eq!((merged.state, merged.trusted), (State::AtLeast, 3));
        // The shortest exposure has the highest bound: full scale less half a code.
        assert!((merged.radiance - 249.0).abs() < 0.5, "{merged:?}");
        let black = Sample {
            radiance: 0.0,
            ..bracket.tables[0].channels()[0].sample(0, 1.0)
        };
        let merged = merge(&[black, black], &Consistency::default()).unwrap();
        assert_eq!((merged.state, merged.radiance), (State::AtMost, 0.0));
        assert!((merged.variance - 0.5 * black.floor).abs() < 1e-6 * black.floor);
        assert_eq!(merge(&[], &Consistency::default()), None);
    }

    #[test]
    fn after_a_change_only_the_newest_count() {
        let mut random = Random::new(8);
        let bracket = Bracket::new(ResponseCurve::srgb(), 4);
        // Switched on, off, and from clipped to dark; between the second and third sample.
        for (before, after) in [(1.0, 3.0), (3.0, 1.0), (1e4, 2.0), (0.0, 3.0)] {
            let samples: Vec<Sample> = (0..4)
                .map(|step| bracket.shoot(step, if step < 2 { before } else { after }, &mut random))
                .collect();
            let merged = merge(&samples, &Consistency::default()).unwrap();
            assert_eq!(merged.trusted, 2, "{before} to {after}: {merged:?}");
            assert!((f64::from(merged.radiance) / after - 1.0).abs() < 0.05, "{merged:?}");
        }
        // A lamp goes on and clips: what was measured before is no measurement of it.
        let samples = [bracket.shoot(1, 2.0, &mut random), bracket.shoot(2, 1e4, &mut random)];
        let merged = merge(&samples, &Consistency::default()).unwrap();
        assert_eq!((merged.trusted, merged.state), (1, State::AtLeast));
    }

    #[test]
    fn channels_share_their_samples() {
        let sample = |radiance: f32| Sample {
            radiance,
            shot: 0.0,
            floor: 1e-4,
            clipping: Clipping::None,
        };
        let samples = [[1.0, 1.0, 1.0], [1.0, 2.0, 1.0], [1.0, 2.0, 1.0]].map(|rgb| rgb.map(sample));
        let merged = merge_rgb(&samples, &Consistency::default()).unwrap();
        assert_eq!(merged.map(|estimate| estimate.trusted), [2, 2, 2]);
        assert_eq!(merged[1].radiance, 2.0);
        assert_eq!(merge_rgb(&[], &Consistency::default()), None);
    }

    #[test]
    fn limits_are_those_of_the_tables() {
        // Upper quantiles of χ² at a one-sided 3 σ (probability 0.00135); the approximation is good to 3 %.
        for (freedom, expected) in [(2, 13.22), (6, 21.74), (10, 28.78)] {
            assert!(
                (chi_square_limit(freedom, 3.0) / expected - 1.0).abs() < 0.03,
                "{freedom}"
            );
        }
    }

    proptest! {
        #[test]
        fn the_estimate_lies_between_its_samples(
            radiances in prop::collection::vec(0.1f32..10.0, 1..6),
            floor in 1e-4f32..1.0,
        ) {
            let samples: Vec<Sample> = radiances
                .iter()
                .enumerate()
                .map(|(i, &radiance)| Sample { radiance, shot: 0.01, floor: floor / (1 + i) as f32, clipping: Clipping::None })
                .collect();
            let merged = merge(&samples, &Consistency::default()).unwrap();
            let newest = &radiances[radiances.len() - merged.trusted..];
            let (low, high) = newest.iter().fold((f32::MAX, 0f32), |(l, h), &r| (l.min(r), h.max(r)));
            prop_assert!(merged.trusted >= 1);
            prop_assert!(merged.radiance >= 0.9999 * low && merged.radiance <= 1.0001 * high);
            let least = samples.iter().map(|s| s.variance_at(merged.radiance)).fold(f32::MAX, f32::min);
            prop_assert!(merged.variance <= 1.0001 * least);
        }

        #[test]
        fn still_samples_agree(seed in 0u64..1000, radiance in 0.5f64..200.0) {
            let bracket = Bracket::new(knee(), 4);
            let samples = bracket.all(radiance, &mut Random::new(seed));
            prop_assert_eq!(merge(&samples, &Consistency::default()).unwrap().trusted, 4);
        }
    }
}
