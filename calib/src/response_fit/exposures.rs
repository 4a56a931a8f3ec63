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
/// pictures in these channels, corrections being small, zero on the whole, and not growing with exposure.
///
/// Pictures that share nothing with others keep their time.
pub(super) fn correct(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    nominal: &[f64],
    channels: &[usize],
) -> Vec<f64> {
    let exposures_s: Vec<[f64; 3]> = nominal.iter().map(|log| [log.exp(); 3]).collect();
    let mut pairs = ratios::pair_errors(patches, curves, &exposures_s);
    pairs.retain(|pair| channels.contains(&pair.channel));
    let n = nominal.len();
    let mut normal = free_of_scale(nominal, |i| pairs.iter().any(|pair| pair.pictures.contains(&i)));
    let mut right = DVector::zeros(n);
    // Channels are three views of one error.
    let weight = PAIR_DEVIATION.powi(-2) / channels.len() as f64;
    for pair in &pairs {
        let [a, b] = pair.pictures;
        let error = pair.error.ln_1p();
        right[a] += weight * error;
        right[b] -= weight * error;
        normal[(a, a)] += weight;
        normal[(b, b)] += weight;
        normal[(a, b)] -= weight;
        normal[(b, a)] -= weight;
    }
    let cholesky = normal.cholesky().expect("the prior makes the matrix positive definite");
    let corrections = cholesky.solve(&right);
    nominal
        .iter()
        .zip(&corrections)
        .map(|(log, correction)| log + correction)
        .collect()
}

/// Normal matrix of what holds beforehand. Sum and slope are those of the pictures that are seen: of all, the others would
/// balance a slope of these.
fn free_of_scale(nominal: &[f64], is_seen: impl Fn(usize) -> bool) -> DMatrix<f64> {
    let seen: Vec<usize> = (0..nominal.len()).filter(|&i| is_seen(i)).collect();
    let mean = seen.iter().map(|&i| nominal[i]).sum::<f64>() / seen.len().max(1) as f64;
    let mut normal = DMatrix::from_diagonal_element(nominal.len(), nominal.len(), TIME_DEVIATION.powi(-2));
    for &i in &seen {
        for &j in &seen {
            normal[(i, j)] += FIXED * (1.0 + (nominal[i] - mean) * (nominal[j] - mean));
        }
    }
    normal
}
