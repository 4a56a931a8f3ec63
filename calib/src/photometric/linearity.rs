//! What exposures really were: the ratio of every two pictures, through the response, against what the driver said.
//!
//! Least squares over the medians of all pairs of pictures. One factor common to all settings cannot be seen and stays as the
//! driver says; if the response was fitted to the same pictures, neither can a power of the exposure (another exponent of the
//! curve says the same).

use nalgebra::{DMatrix, DVector};

use crate::{
    least_squares::loss::Loss,
    response::ResponseCurve,
    response_fit::{FlatPatches, PairError, pair_errors},
};

/// Standard deviation of the logarithm of a setting before anything is seen.
const PRIOR_DEVIATION: f64 = 0.05;

/// What the response may still be wrong by in a pair's log ratio; patches do not remove it.
const MODEL_DEVIATION: f64 = 0.003;

/// Weight of what is fixed by definition.
const FIXED: f64 = 1e8;

const ROUNDS: usize = 10;

/// Where the response came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResponseIs {
    /// Known beforehand.
    Known,
    /// Fitted to the same pictures.
    FittedToThese,
}

/// The exposure of one setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueExposure {
    /// What the driver said: seconds, times gain.
    pub nominal_s: f64,
    /// What it was.
    pub true_s: f64,
    /// Relative standard deviation of the latter; `None` where no picture of it could be compared with another.
    pub sigma: Option<f64>,
}

/// Measures the exposures. `setting_of` gives the setting of each picture of `patches`, an index into `nominal_s`.
#[must_use]
pub fn measure(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    nominal_s: &[f64],
    setting_of: &[usize],
    response: ResponseIs,
) -> Vec<TrueExposure> {
    let pairs = pair_errors(patches, curves, &patches.channel_exposures_s());
    let is_seen = |setting: usize| {
        let of = |picture: &usize| setting_of[*picture] == setting;
        pairs.iter().any(|pair| pair.pictures.iter().any(of))
    };
    let seen: Vec<usize> = (0..nominal_s.len()).filter(|&setting| is_seen(setting)).collect();
    let held = held(nominal_s, &seen, response);
    let mut corrections = DVector::zeros(nominal_s.len());
    let mut covariance = DMatrix::identity(nominal_s.len(), nominal_s.len());
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (held.clone(), DVector::zeros(nominal_s.len()));
        for pair in &pairs {
            let [a, b] = pair.pictures.map(|picture| setting_of[picture]);
            let error = pair.error.ln_1p();
            let weight = weight(pair, error - (corrections[a] - corrections[b]));
            right[a] += weight * error;
            right[b] -= weight * error;
            normal[(a, a)] += weight;
            normal[(b, b)] += weight;
            normal[(a, b)] -= weight;
            normal[(b, a)] -= weight;
        }
        let cholesky = normal.cholesky().expect("the prior makes the matrix positive definite");
        corrections = cholesky.solve(&right);
        covariance = cholesky.inverse();
    }
    let misfit = misfit(&pairs, |pair| {
        let [a, b] = pair.pictures.map(|picture| setting_of[picture]);
        pair.error.ln_1p() - (corrections[a] - corrections[b])
    });
    (0..nominal_s.len())
        .map(|setting| TrueExposure {
            nominal_s: nominal_s[setting],
            true_s: nominal_s[setting] * corrections[setting].exp(),
            sigma: seen
                .contains(&setting)
                .then(|| misfit * covariance[(setting, setting)].sqrt()),
        })
        .collect()
}

/// Weight of a pair: channels are three views of one error.
fn weight(pair: &PairError, residual: f64) -> f64 {
    let sigma = pair.sigma.hypot(MODEL_DEVIATION);
    Loss::Huber.cost_and_weight(residual.abs() / sigma).1 / (3.0 * sigma * sigma)
}

/// Root mean square of residuals over their standard deviations, at least 1: how much worse than said a response is that does not
/// suit the pictures.
fn misfit(pairs: &[PairError], residual: impl Fn(&PairError) -> f64) -> f64 {
    let square = |pair: &PairError| (residual(pair) / pair.sigma.hypot(MODEL_DEVIATION)).powi(2);
    let mean = pairs.iter().map(square).sum::<f64>() / pairs.len().max(1) as f64;
    mean.sqrt().max(1.0)
}

/// What holds beforehand: corrections are small, zero on the whole and, with a fitted response, do not grow with exposure.
fn held(nominal_s: &[f64], seen: &[usize], response: ResponseIs) -> DMatrix<f64> {
    let log = |setting: usize| nominal_s[setting].ln();
    let mean = seen.iter().map(|&setting| log(setting)).sum::<f64>() / seen.len().max(1) as f64;
    let slope = match response {
        ResponseIs::Known => 0.0,
        ResponseIs::FittedToThese => 1.0,
    };
    let mut normal = DMatrix::from_diagonal_element(nominal_s.len(), nominal_s.len(), PRIOR_DEVIATION.powi(-2));
    for &i in seen {
        for &j in seen {
            normal[(i, j)] += FIXED * (1.0 + slope * (log(i) - mean) * (log(j) - mean));
        }
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        merge::{
            noise::ChannelNoise,
            simulate::{Random, knee},
        },
        response_fit::Shot,
    };

    const SIZE_PX: [usize; 2] = [240, 160];

    fn picture(seed: u64, exposure_s: f64) -> Vec<u8> {
        let (mut scene, mut random) = (Random::new(4), Random::new(seed));
        let columns = SIZE_PX[0] / 8;
        let squares: Vec<f64> = (0..columns * SIZE_PX[1] / 8)
            .map(|_| 1e-3 * 1e3f64.powf(scene.uniform()))
            .collect();
        let noise = ChannelNoise {
            signal_per_radiance: exposure_s,
            signal_per_electron: 1.0 / 12_000.0,
            read_noise_e: 6.0,
            code_noise: 0.0,
        };
        (0..3 * SIZE_PX[0] * SIZE_PX[1])
            .map(|i| squares[i / 3 / SIZE_PX[0] / 8 * columns + i / 3 % SIZE_PX[0] / 8])
            .map(|radiance| random.code(&knee(), &noise, radiance))
            .collect()
    }

    #[test]
    fn true_exposures_come_back() {
        let nominal = [0.5, 1.0, 2.0, 4.0, 8.0];
        let factors: [f64; 5] = [1.03, 1.0, 0.98, 1.02, 0.97];
        let scale = factors.iter().map(|factor| factor.ln()).sum::<f64>() / 5.0;
        let taken: Vec<(usize, Vec<u8>)> = (0..10)
            .map(|i| (i / 2, picture(20 + i as u64, nominal[i / 2] * factors[i / 2])))
            .collect();
        let shots: Vec<Shot<'_>> = taken
            .iter()
            .map(|(setting, codes)| Shot {
                codes,
                holes: None,
                exposure_s: nominal[*setting],
            })
            .collect();
        let patches = FlatPatches::new(&shots, SIZE_PX).unwrap();
        let settings: Vec<usize> = taken.iter().map(|(setting, _)| *setting).collect();
        let curves = [knee(), knee(), knee()];
        let found = measure(&patches, &curves, &nominal, &settings, ResponseIs::Known);
        for ((found, nominal), factor) in found.iter().zip(nominal).zip(factors) {
            let error = (found.true_s / nominal).ln() - (factor.ln() - scale);
            println!("{nominal} {:.4} {error:.5} ± {:.5}", found.true_s, found.sigma.unwrap());
            assert!(error.abs() < 0.005, "{found:?}");
            assert!(found.sigma.unwrap() > 1e-4 && found.sigma.unwrap() < 0.005, "{found:?}");
        }
        let unseen = measure(
            &patches,
            &curves,
            &[0.5, 1.0, 2.0, 4.0, 8.0, 99.0],
            &settings,
            ResponseIs::Known,
        )[5];
        assert_eq!((unseen.true_s, unseen.sigma), (99.0, None));
    }
}
