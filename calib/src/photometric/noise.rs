//! Noise of the sensor from repeated pictures of a still scene: photon transfer (Janesick 2007, "Photon transfer").
//!
//! The variance between repeats is read per code, taken through the slope of the response, and fitted by
//!
//! ```text
//! var(y) = (s / F) y + (s r / F)²        s = gain · white balance
//! ```
//!
//! which gives the full well F and the read noise r in electrons. Done otherwise than in the textbook:
//!
//! - **Rounding.** Eight bits are coarse: dark noise is often smaller than a code. Where a scene's levels lie anywhere within the
//!   code, noise of standard deviation σ codes shows, between repeats, a variance of
//!   `σ² + 1/12 − Σₖ exp(−4π²k²σ²) / (2π²k²)`: σ² + 1/12 when σ is large (Sheppard), 0 when it is 0. This is inverted, so that
//!   noise far below a code is still measured.
//! - **Flicker.** What all pixels of a code have in common, such as a lamp's flicker, is taken out: only differences about their
//!   mean count.
//! - **Things that move** make differences beyond five standard deviations; they are left out.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

use crate::{least_squares::loss::Loss, response::ResponseCurve};

/// Differences of a code needed to know its variance.
const MIN_SAMPLES: f64 = 200.0;

/// Standard deviations beyond which a difference is left out: of normal ones, one in two million.
const CUT: f64 = 5.0;

/// Standard deviations by which a code must stay away from the ends of the scale.
const MARGIN: f64 = 4.0;

/// Relative error of a variance that no number of samples removes: the slope of the response.
const MODEL_ERROR: f64 = 0.03;

const ROUNDS: usize = 20;

/// Repeated pictures with one exposure setting.
#[derive(Debug, Clone)]
pub struct Repeats<'a> {
    /// Red, green, blue of each pixel; two pictures or more of one size.
    pub pictures: Vec<&'a [u8]>,
    /// Gain times white balance of red, green and blue.
    pub gain: [f64; 3],
}

/// The variance of one code.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransferPoint {
    /// Linear signal over the gain: electrons over the full well.
    pub signal: f64,
    /// Variance of the same, rounding taken out.
    pub variance: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Noise as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorNoise {
    /// Electrons at full scale and gain 1.
    pub full_well_e: f64,
    /// Its standard deviation.
    pub full_well_sigma_e: f64,
    /// Standard deviation of the read noise, in electrons.
    pub read_noise_e: f64,
    /// What the fit was made of.
    pub points: Vec<TransferPoint>,
    /// Root mean square of residuals over their standard deviations; about 1 when the model holds.
    pub misfit: f64,
}

/// Why there is no noise model.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoiseError {
    /// Nothing was taken twice.
    #[error("no exposure setting has two pictures (allowed: at least one setting with 2 or more)")]
    NoRepeats,
    /// Pictures of one setting differ in size.
    #[error("the pictures of setting `{setting}` differ in size")]
    Size {
        /// Index of the setting.
        setting: usize,
    },
    /// Too few codes are seen often enough.
    #[error("the noise of `{found}` codes could be measured (allowed: at least `8`)")]
    FewCodes {
        /// Codes found.
        found: usize,
    },
    /// The variance does not grow with the light.
    #[error("the noise does not grow with the light: photon noise cannot be seen")]
    NoShotNoise,
}

/// Variance between repeats, in codes², that noise of standard deviation `sigma` codes shows once rounded; see the module.
#[must_use]
pub fn rounded_variance(sigma: f64) -> f64 {
    let ripple: f64 = (1..=60)
        .map(|k| f64::from(k * k))
        .map(|square| (-4.0 * PI * PI * square * sigma * sigma).exp() / (2.0 * PI * PI * square))
        .sum();
    // The rest of the sum, of which every term is 1 / (2 π² k²) when there is no noise.
    let rest = if sigma < 1e-3 {
        1.0 / (2.0 * PI * PI * 60.5)
    } else {
        0.0
    };
    (sigma * sigma + 1.0 / 12.0 - ripple - rest).max(0.0)
}

/// The inverse of [`rounded_variance`], squared: the variance of the noise before rounding.
#[must_use]
pub fn variance_before_rounding(rounded: f64) -> f64 {
    let (mut low, mut high) = (0.0, rounded.max(0.0).sqrt() + 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if rounded_variance(middle) < rounded {
            low = middle;
        } else {
            high = middle;
        }
    }
    low * low
}

/// Fits the noise model.
///
/// # Errors
/// When nothing was taken twice, sizes differ, or too few codes tell.
pub fn measure(settings: &[Repeats<'_>], response: &ResponseCurve) -> Result<SensorNoise, NoiseError> {
    if settings.iter().all(|setting| setting.pictures.len() < 2) {
        return Err(NoiseError::NoRepeats);
    }
    let mut points = Vec::new();
    for (index, setting) in settings.iter().enumerate() {
        for pair in setting.pictures.windows(2) {
            if pair[0].len() != pair[1].len() {
                return Err(NoiseError::Size { setting: index });
            }
        }
        for channel in 0..3 {
            transfer_points(setting, channel, response, &mut points);
        }
    }
    if points.len() < 8 {
        return Err(NoiseError::FewCodes { found: points.len() });
    }
    fit(points)
}

/// How often each difference of two codes, −255 to 255, was seen.
type Histogram = [u32; 511];

/// Adds what the repeats of one setting say in one channel.
fn transfer_points(setting: &Repeats<'_>, channel: usize, response: &ResponseCurve, points: &mut Vec<TransferPoint>) {
    let gain = setting.gain[channel];
    let (black, clipped) = (
        f64::from(response.last_black_code()),
        f64::from(response.first_clipped_code()),
    );
    // Each pair by itself: what flickers is not the same in two of them.
    let pairs: Vec<Vec<Histogram>> = setting
        .pictures
        .windows(2)
        .map(|pair| differences(pair, channel))
        .collect();
    for code in 0..256 {
        let of_pairs = pairs.iter().map(|pair| still_variance(&pair[code]));
        let (n, sum) = of_pairs.fold((0.0, 0.0), |(n, sum), (more, variance)| {
            (n + more, sum + more * variance)
        });
        let rounded = sum / n;
        if n < MIN_SAMPLES {
            continue;
        }
        let variance = variance_before_rounding(rounded);
        let margin = MARGIN * variance.sqrt() + 1.0;
        if (code as f64) < black + margin || code as f64 > clipped - margin {
            continue;
        }
        let slope = response.code_width(code as u8) / gain;
        let scaled = variance * slope * slope;
        // A variance of n differences is known to sqrt(2/n); rounding adds its own.
        let random = slope * slope * (variance + 1.0 / 12.0) * (2.0 / n).sqrt();
        points.push(TransferPoint {
            signal: response.linear_from_code(code as u8) / gain,
            variance: scaled,
            sigma: random.hypot(MODEL_ERROR * scaled),
        });
    }
}

/// Differences of two repeats by the mean code of the two.
fn differences(pair: &[&[u8]], channel: usize) -> Vec<Histogram> {
    let mut found = vec![[0; 511]; 256];
    let codes = pair[0].iter().zip(pair[1]).skip(channel).step_by(3);
    for (&a, &b) in codes {
        // Odd sums, whose differences are odd, go to both neighbours in turn, or the even ones would miss them.
        let sum = u16::from(a) + u16::from(b) + u16::from(a > b);
        found[usize::from(sum / 2)][usize::from(255 + u16::from(a) - u16::from(b))] += 1;
    }
    found
}

/// Number of the differences that come from noise, and the variance of one of the two codes, about what all have in common.
fn still_variance(histogram: &Histogram) -> (f64, f64) {
    let all = || {
        histogram
            .iter()
            .zip(-255i32..)
            .map(|(&n, difference)| (f64::from(n), f64::from(difference)))
    };
    let half = 0.5 * all().map(|(n, _)| n).sum::<f64>();
    let median_of = |mut values: Vec<(f64, f64)>| {
        values.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut sum = 0.0;
        let middle = values.iter().find(|(n, _)| {
            sum += n;
            sum >= half
        });
        middle.map_or(0.0, |&(_, value)| value)
    };
    let middle = median_of(all().collect());
    // Median absolute deviation of a normal distribution: 0.6745 σ. Rounding may hide one code of it.
    let spread = (median_of(all().map(|(n, value)| (n, (value - middle).abs())).collect()) + 0.5) / 0.6745;
    let limit = CUT * spread;
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for (count, value) in all().filter(|(_, value)| (value - middle).abs() <= limit) {
        n += count;
        sum += count * value;
        squares += count * value * value;
    }
    let mean = sum / f64::max(n, 1.0);
    (n, 0.5 * (squares / f64::max(n, 1.0) - mean * mean).max(0.0))
}

/// Weighted least squares for 1/F and (r/F)², none below 0; Huber weights.
fn fit(points: Vec<TransferPoint>) -> Result<SensorNoise, NoiseError> {
    let mut weights: Vec<f64> = points.iter().map(|point| point.sigma.powi(-2)).collect();
    let mut x = Vector2::zeros();
    let mut covariance = Matrix2::zeros();
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (point, weight) in points.iter().zip(&weights) {
            let row = Vector2::new(point.signal, 1.0);
            normal += row * row.transpose() * *weight;
            right += row * (*weight * point.variance);
        }
        covariance = normal.try_inverse().ok_or(NoiseError::NoShotNoise)?;
        x = covariance * right;
        if x[1] < 0.0 {
            x = Vector2::new(right[0] / normal[(0, 0)], 0.0);
        }
        for (point, weight) in points.iter().zip(&mut weights) {
            let model = (x[0] * point.signal + x[1]).max(1e-30);
            // Relative to the model, not to what was found: a variance that is low by chance must not count more.
            let sigma = point.sigma * (model / point.variance.max(0.1 * model));
            let deviation = (point.variance - model).abs() / sigma;
            *weight = Loss::Huber.cost_and_weight(deviation).1 / (sigma * sigma);
        }
    }
    // NaN too.
    if !(x[0] > 0.0 && x[0] > 2.0 * covariance[(0, 0)].sqrt()) {
        return Err(NoiseError::NoShotNoise);
    }
    let full_well_e = 1.0 / x[0];
    let residual = |point: &TransferPoint| ((point.variance - x[0] * point.signal - x[1]) / point.sigma).powi(2);
    let misfit = (points.iter().map(residual).sum::<f64>() / points.len() as f64).sqrt();
    Ok(SensorNoise {
        full_well_e,
        full_well_sigma_e: covariance[(0, 0)].sqrt() * full_well_e * full_well_e * misfit.max(1.0),
        read_noise_e: x[1].sqrt() * full_well_e,
        points,
        misfit,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::merge::{
        noise::ChannelNoise,
        simulate::{Random, knee},
    };

    /// Repeats of a scene of all levels, evenly spread over the codes.
    fn repeats(response: &ResponseCurve, full_well_e: f64, read_noise_e: f64, gain: f64) -> Vec<Vec<u8>> {
        let mut random = Random::new(8);
        let gains = [1.4 * gain, gain, 1.8 * gain];
        (0..3)
            .map(|_| {
                let mut codes = Vec::new();
                for pixel in 0..80_000u32 {
                    let level = (f64::from(pixel) * 0.754_877_666).fract();
                    let below = (level * 254.99) as u8;
                    let part = level * 254.99 - f64::from(below);
                    let [y0, y1] = [below, below + 1].map(|code| response.linear_from_code(code));
                    let y = y0 + part * (y1 - y0);
                    for gain in gains {
                        let noise = ChannelNoise {
                            signal_per_radiance: 1.0,
                            signal_per_electron: gain / full_well_e,
                            read_noise_e,
                            code_noise: 0.0,
                        };
                        codes.push(random.code(response, &noise, y));
                    }
                }
                codes
            })
            .collect()
    }

    fn measured(pictures: &[Vec<u8>], response: &ResponseCurve, gain: f64) -> SensorNoise {
        let setting = Repeats {
            pictures: pictures.iter().map(Vec::as_slice).collect(),
            gain: [1.4 * gain, gain, 1.8 * gain],
        };
        measure(&[setting], response).unwrap()
    }

    #[test]
    fn full_well_and_read_noise_come_back() {
        for (response, full_well_e, read_noise_e, gain) in [
            (ResponseCurve::srgb(), 12_000.0, 12.0, 1.0),
            (knee(), 28_000.0, 20.0, 2.0),
            (ResponseCurve::srgb(), 60_000.0, 30.0, 1.0),
        ] {
            let pictures = repeats(&response, full_well_e, read_noise_e, gain);
            let found = measured(&pictures, &response, gain);
            println!(
                "F {:.0} ± {:.0} ({full_well_e}), r {:.2} ({read_noise_e}), misfit {:.2}",
                found.full_well_e, found.full_well_sigma_e, found.read_noise_e, found.misfit
            );
            assert!((found.full_well_e / full_well_e - 1.0).abs() < 0.05);
            assert!((found.read_noise_e / read_noise_e - 1.0).abs() < 0.15);
        }
    }

    #[test]
    fn flicker_and_motion_do_not_count() {
        let response = ResponseCurve::srgb();
        let mut pictures = repeats(&response, 12_000.0, 12.0, 1.0);
        // A lamp that flickers by 1 %, and a twentieth of the picture replaced.
        for code in &mut pictures[1] {
            *code = response.encode(1.01 * response.linear_from_code(*code));
        }
        let part = pictures[2].len() / 20;
        pictures[2][..part].fill(120);
        let found = measured(&pictures, &response, 1.0);
        println!("{:.0} {:.2}", found.full_well_e, found.read_noise_e);
        assert!((found.full_well_e / 12_000.0 - 1.0).abs() < 0.1);
    }

    #[test]
    fn what_tells_nothing_is_refused() {
        let grey = vec![90; 30_000];
        let setting = |pictures: Vec<&'static [u8]>| Repeats {
            pictures,
            gain: [1.0; 3],
        };
        let leaked: &'static [u8] = grey.leak();
        let curve = ResponseCurve::srgb();
        assert_eq!(measure(&[setting(vec![leaked])], &curve), Err(NoiseError::NoRepeats));
        assert_eq!(
            measure(&[setting(vec![leaked, &leaked[3..]])], &curve),
            Err(NoiseError::Size { setting: 0 })
        );
        assert_eq!(
            measure(&[setting(vec![leaked, leaked])], &curve),
            Err(NoiseError::FewCodes { found: 3 })
        );
    }

    proptest! {
        #[test]
        fn rounding_is_undone(sigma in 0.02f64..4.0) {
            let back = variance_before_rounding(rounded_variance(sigma)).sqrt();
            prop_assert!((back - sigma).abs() < 1e-3, "{} {}", back, sigma);
        }
    }

    #[test]
    fn rounded_noise_has_the_variance_of_the_formula() {
        let mut random = Random::new(5);
        for sigma in [0.05, 0.2, 0.5, 2.0] {
            let n = 200_000;
            let mean_square: f64 = (0..n)
                .map(|_| {
                    let level = 50.0 + random.uniform();
                    let mut shot = || (level + sigma * random.normal()).round();
                    (shot() - shot()).powi(2)
                })
                .sum::<f64>()
                / f64::from(n);
            let ratio = 0.5 * mean_square / rounded_variance(sigma);
            assert!((ratio - 1.0).abs() < 0.02, "{sigma}: {ratio}");
        }
    }
}
