//! A blur of any covariance as three lines of taps on whole pixels.
//!
//! Selling's decomposition writes a symmetric positive definite matrix as a sum of `λ e eᵀ` over three directions `e` of
//! whole numbers with `λ ≥ 0` (Selling 1874; Fehrenbach and Mirebeau 2014, "Sparse non-negative stencils for anisotropic
//! diffusion"). A line of taps along each `e`, of variance `λ` in steps, then blurs with just that covariance: variances
//! add up. The taps are `exp(-n² / 2s)`, the normal distribution on whole numbers, with s such that their variance is λ
//! however small it is; for λ above 0.4 that is s = λ. Bessel's taps `exp(-λ) I_n(λ)` (Lindeberg 1990) have that variance
//! too, but a higher peak and longer tails: fitted with a Gaussian, an edge blurred with λ = 0.8 px² has 0.63 px² by them and
//! 0.80 px² by these. Below 0.3 px² the pixels are too coarse, and an edge looks up to 0.1 px² sharper than asked for.

use glam::{DMat2, DVec2, IVec2};

/// Weights of a line at most: its middle and one side.
pub const LINE_WEIGHTS: usize = 20;

/// Largest variance in any direction, px²: what [`LINE_WEIGHTS`] hold to four standard deviations.
pub const MAX_VARIANCE_PX2: f64 = 16.0;

/// Largest ratio of the variances along and across. A kernel that is thinner than the pixels would leave gaps between its
/// taps.
const LARGEST_ASPECT: f64 = 64.0;

/// Below this variance, in steps squared, a line changes nothing: the taps beside the middle get half of it.
const LEAST_VARIANCE: f64 = 1e-5;

/// Taps in a row, the same on both sides of the middle.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// From one tap to the next, columns and rows.
    pub step_px: IVec2,
    /// Weights from the middle outwards; all but the first count twice, and the sum is 1.
    pub weights: Vec<f64>,
}

/// The three lines whose blurs, one after the other, have `covariance_px2` (symmetric, px²).
///
/// Eigenvalues are held between 0 and [`MAX_VARIANCE_PX2`], and the lesser one above a 64th of the greater.
#[must_use]
pub fn lines(covariance_px2: DMat2) -> [Line; 3] {
    let covariance = drawable(covariance_px2);
    let mut base = [IVec2::X, IVec2::Y, IVec2::NEG_ONE];
    let product = |a: IVec2, b: IVec2| a.as_dvec2().dot(covariance * b.as_dvec2());
    // Each turn shortens the base; an aspect of 8 to 1 needs a handful.
    for _ in 0..64 {
        let Some([i, j]) = [[0, 1], [0, 2], [1, 2]]
            .into_iter()
            .find(|&[i, j]| product(base[i], base[j]) > 1e-12)
        else {
            break;
        };
        base = [-base[i], base[j], base[i] - base[j]];
    }
    [[1, 2, 0], [0, 2, 1], [0, 1, 2]].map(|[i, j, other]| Line {
        step_px: base[other].perp(),
        weights: normal_on_steps(-product(base[i], base[j])),
    })
}

/// Eigenvalues (greater first) and the unit eigenvector of the first, of a symmetric matrix.
#[must_use]
pub fn eigen(matrix: DMat2) -> ([f64; 2], DVec2) {
    let (xx, xy, yy) = (matrix.x_axis.x, matrix.x_axis.y, matrix.y_axis.y);
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    ([middle + half, middle - half], DVec2::from_angle(angle))
}

/// The symmetric matrix with these eigenvalues and the unit eigenvector of the first.
#[must_use]
pub fn from_eigen([along, across]: [f64; 2], direction: DVec2) -> DMat2 {
    let turn = DMat2::from_cols(direction, direction.perp());
    turn * DMat2::from_diagonal(DVec2::new(along, across)) * turn.transpose()
}

fn drawable(covariance: DMat2) -> DMat2 {
    let ([along, across], direction) = eigen(covariance);
    let along = along.clamp(0.0, MAX_VARIANCE_PX2);
    from_eigen([along, across.clamp(along / LARGEST_ASPECT, along)], direction)
}

/// `exp(-n² / 2s)` from n = 0 on, of this variance, cut off where nothing is left and made to sum up to 1 with both sides.
fn normal_on_steps(variance: f64) -> Vec<f64> {
    if variance < LEAST_VARIANCE {
        return vec![1.0];
    }
    let n = ((4.0 * variance.sqrt()).ceil() as usize + 2).min(LINE_WEIGHTS);
    let weights = |s: f64| -> Vec<f64> {
        let raw: Vec<f64> = (0..n).map(|i| (-0.5 * (i * i) as f64 / s).exp()).collect();
        let total = 2.0 * raw.iter().sum::<f64>() - raw[0];
        raw.iter().map(|weight| weight / total).collect()
    };
    let variance_of = |s: f64| -> f64 {
        let of = weights(s);
        of.iter()
            .enumerate()
            .map(|(i, weight)| 2.0 * (i * i) as f64 * weight)
            .sum()
    };
    // The variance grows with s: halves of an interval that holds every variance from the least on.
    let (mut low, mut high) = (0.01, 2.0 * variance + 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if variance_of(middle) < variance {
            low = middle;
        } else {
            high = middle;
        }
    }
    weights(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Weight of every offset of the three lines one after the other: `((x, y), weight)`.
    fn dense(lines: &[Line; 3]) -> Vec<(DVec2, f64)> {
        let taps = |line: &Line| -> Vec<(DVec2, f64)> {
            let reach = line.weights.len() as i32 - 1;
            (-reach..=reach)
                .map(|i| ((i * line.step_px).as_dvec2(), line.weights[i.unsigned_abs() as usize]))
                .collect()
        };
        let mut all = vec![(DVec2::ZERO, 1.0)];
        for line in lines {
            all = all
                .iter()
                .flat_map(|&(at, weight)| taps(line).into_iter().map(move |(d, w)| (at + d, weight * w)))
                .collect();
        }
        all
    }

    proptest! {
        #[test]
        fn a_kernel_has_the_covariance_asked_for(along in 0.02f64..16.0, aspect in 1.0f64..60.0, angle in 0.0f64..3.15) {
            let asked = from_eigen([along, along / aspect], DVec2::from_angle(angle));
            let lines = lines(asked);
            prop_assert!(lines.iter().all(|line| line.weights.len() <= LINE_WEIGHTS));
            let kernel = dense(&lines);
            let mut sum = 0.0;
            let (mut mean, mut second) = (DVec2::ZERO, DMat2::ZERO);
            for (at, weight) in kernel {
                prop_assert!(weight >= 0.0);
                sum += weight;
                mean += weight * at;
                second += weight * DMat2::from_cols(at * at.x, at * at.y);
            }
            prop_assert!((sum - 1.0).abs() < 1e-9, "sum {}", sum);
            prop_assert!(mean.length() < 1e-9);
            // What is cut off the tails, and lines too weak to count.
            let off = (second - asked).to_cols_array().iter().fold(0.0f64, |worst, d| worst.max(d.abs()));
            prop_assert!(off < 0.01 * along + 3e-3, "{} for {}", second, asked);
        }
    }

    #[test]
    fn no_blur_is_no_taps_and_too_much_is_held() {
        assert!(lines(DMat2::ZERO).iter().all(|line| line.weights == [1.0]));
        let ([along, across], _) = eigen(drawable(DMat2::from_diagonal(DVec2::new(100.0, -1.0))));
        assert_eq!((along, across), (MAX_VARIANCE_PX2, MAX_VARIANCE_PX2 / LARGEST_ASPECT));
    }

    #[test]
    fn half_of_a_small_variance_goes_to_either_neighbour() {
        let weights = normal_on_steps(0.04);
        assert!((weights[1] - 0.02).abs() < 1e-3, "{weights:?}");
    }
}
