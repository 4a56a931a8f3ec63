//! Least squares for quantities that cannot be negative, with outliers, prices and expectations.

use super::clipped::Price;

/// Unknowns, what they explain, and what is thought of them beforehand.
pub(super) struct Unknowns {
    /// Per unknown: its effect on every reading, in standard deviations of the reading per unit of radiance.
    pub(super) slopes: Vec<Vec<f32>>,
    /// Reluctance to raise it.
    pub(super) prices: Vec<Price>,
    /// Expected value and the inverse square of its standard deviation; 0 where nothing is expected.
    pub(super) priors: Vec<(f32, f32)>,
}

/// Values found, and what they leave unexplained.
pub(super) struct Solution {
    pub(super) values: Vec<f32>,
    /// Reading minus explanation, in standard deviations.
    pub(super) deviations: Vec<f32>,
    pub(super) cost: f32,
}

impl Unknowns {
    /// Non-negative least squares with Huber weights, by coordinate descent.
    ///
    /// `deviations` is what every reading leaves unexplained while all unknowns are 0, in standard deviations.
    pub(super) fn solve(&self, mut deviations: Vec<f32>) -> Solution {
        let mut values = vec![0.0f32; self.slopes.len()];
        let mut weights = vec![1.0f32; deviations.len()];
        for _ in 0..4 {
            for _ in 0..40 {
                for (k, value) in values.iter_mut().enumerate() {
                    self.improve(k, value, &mut deviations, &weights);
                }
            }
            for (weight, off) in weights.iter_mut().zip(&deviations) {
                *weight = 1.0 / (off.abs() / 2.0).max(1.0);
            }
        }
        let huber = |off: &f32| {
            if off.abs() < 2.0 {
                off * off
            } else {
                4.0 * off.abs() - 4.0
            }
        };
        let mut cost: f32 = deviations.iter().map(huber).sum();
        for (value, (price, (expected, weight))) in values.iter().zip(self.prices.iter().zip(&self.priors)) {
            cost += price.total(*value) + weight * (value - expected).powi(2);
        }
        Solution {
            values,
            deviations,
            cost,
        }
    }

    /// Moves one unknown to its best value, at or above zero, the others held.
    fn improve(&self, k: usize, value: &mut f32, deviations: &mut [f32], weights: &[f32]) {
        let (expected, prior) = self.priors[k];
        // Half the price, as the squares' own factor 2 is left out.
        let mut gradient = prior * (expected - *value) - 0.5 * self.prices[k].per_unit(*value);
        let mut curvature = prior;
        for ((slope, off), weight) in self.slopes[k].iter().zip(&*deviations).zip(weights) {
            gradient += weight * slope * off;
            curvature += weight * slope * slope;
        }
        if curvature > 0.0 {
            let step = (*value + gradient / curvature).max(0.0) - *value;
            *value += step;
            for (off, slope) in deviations.iter_mut().zip(&self.slopes[k]) {
                *off -= slope * step;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_system_is_solved_and_nothing_goes_below_zero() {
        let unknowns = Unknowns {
            slopes: vec![vec![1.0, 0.0, 1.0], vec![0.0, 1.0, 1.0]],
            prices: vec![Price::NONE; 2],
            priors: vec![(0.0, 0.0); 2],
        };
        let solution = unknowns.solve(vec![2.0, 3.0, 5.0]);
        assert!((solution.values[0] - 2.0).abs() < 1e-3 && (solution.values[1] - 3.0).abs() < 1e-3);
        assert!(solution.cost < 1e-4);
        let negative = unknowns.solve(vec![-4.0, 3.0, 3.0]);
        assert_eq!(negative.values[0], 0.0);
    }
}
