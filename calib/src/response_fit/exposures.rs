//! What exposure times were really, given the curve.

use nalgebra::{DMatrix, DVector};

use super::{FlatPatches, ratios};
use crate::response::ResponseCurve;

/// Standard deviation of the logarithm of a nominal exposure time.
const TIME_DEVIATION: f64 = 0.05;

/// Standard deviation of a pair's log ratio: what the curve may still be wrong by. Many pairs and patches make it no better,
/// as their errors are one and the same.
const PAIR_DEVIATION: f64 = 0.02;

/// Weight of what is fixed by definition.
const FIXED: f64 = 1e8;

/// Logarithms of corrected exposure times, from those of the nominal ones: least squares over the medians of all pairs of
/// pictures, corrections being small, zero on the whole, and not growing with exposure.
pub(super) fn correct(patches: &FlatPatches, curves: &[ResponseCurve; 3], nominal: &[f64]) -> Vec<f64> {
    let n = nominal.len();
    let mean = nominal.iter().sum::<f64>() / n as f64;
    let mut normal = DMatrix::from_fn(n, n, |i, j| {
        let fixed = FIXED * (1.0 + (nominal[i] - mean) * (nominal[j] - mean));
        if i == j { fixed + TIME_DEVIATION.powi(-2) } else { fixed }
    });
    let mut right = DVector::zeros(n);
    let weight = PAIR_DEVIATION.powi(-2) / 3.0;
    let exposures_s: Vec<f64> = nominal.iter().map(|log| log.exp()).collect();
    for pair in ratios::pair_errors(patches, curves, &exposures_s) {
        let [a, b] = pair.pictures;
        let error = pair.error.ln_1p();
        right[a] += weight * error;
        right[b] -= weight * error;
        normal[(a, a)] += weight;
        normal[(b, b)] += weight;
        normal[(a, b)] -= weight;
        normal[(b, a)] -= weight;
    }
    let corrections = normal
        .cholesky()
        .expect("the prior makes the matrix positive definite")
        .solve(&right);
    nominal
        .iter()
        .zip(&corrections)
        .map(|(log, correction)| log + correction)
        .collect()
}
