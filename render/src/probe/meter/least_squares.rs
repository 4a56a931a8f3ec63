//! Least squares for quantities that cannot be negative, with outliers, prices and expectations.
//!
//! The rows are summed up in a small normal matrix first, so that a solution costs the square of the number of unknowns,
//! whatever the number of rows.

use super::super::clipped::Price;

/// Deviations up to this many standard deviations count by their square, larger ones by their size (Huber 1964).
const HUBER: f32 = 2.0;

/// Unknowns, what they explain, and what is thought of them beforehand.
pub(super) struct Unknowns {
    /// Per row: the effect of every unknown, in standard deviations of the row per unit.
    pub(super) rows: Vec<Vec<f32>>,
    /// Reluctance to raise each unknown.
    pub(super) prices: Vec<Price>,
    /// Expected value and the inverse square of its standard deviation; 0 where nothing is expected.
    pub(super) priors: Vec<(f32, f32)>,
}

/// Values found, and what they leave unexplained.
pub(super) struct Solution {
    pub(super) values: Vec<f32>,
    /// Row minus explanation, in standard deviations.
    pub(super) deviations: Vec<f32>,
    pub(super) cost: f32,
}

/// Sums over all rows: the normal matrix, row after row, and the right side.
struct Normal {
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl Unknowns {
    /// Non-negative least squares with Huber weights, by coordinate descent.
    ///
    /// `offsets` is what every row leaves unexplained while all unknowns are 0, in standard deviations.
    pub(super) fn solve(&self, offsets: &[f32]) -> Solution {
        let mut values = vec![0.0; self.prices.len()];
        let mut weights = vec![1.0; offsets.len()];
        let mut deviations = offsets.to_vec();
        for _ in 0..4 {
            let normal = self.normal(offsets, &weights);
            self.descend(&normal, &mut values);
            deviations = self.unexplained(offsets, &values);
            for (weight, off) in weights.iter_mut().zip(&deviations) {
                *weight = 1.0 / (off.abs() / HUBER).max(1.0);
            }
        }
        Solution {
            cost: self.cost(&deviations, &values),
            values,
            deviations,
        }
    }

    fn normal(&self, offsets: &[f32], weights: &[f32]) -> Normal {
        let n = self.prices.len();
        let mut normal = Normal {
            matrix: vec![0.0; n * n],
            right: vec![0.0; n],
        };
        for ((row, &offset), &weight) in self.rows.iter().zip(offsets).zip(weights) {
            for (i, &slope) in row.iter().enumerate().filter(|(_, slope)| **slope != 0.0) {
                let weighted = f64::from(weight * slope);
                normal.right[i] += weighted * f64::from(offset);
                for (sum, &other) in normal.matrix[i * n..(i + 1) * n].iter_mut().zip(row) {
                    *sum += weighted * f64::from(other);
                }
            }
        }
        normal
    }

    /// Moves one unknown after the other to its best value at or above zero, the others held.
    fn descend(&self, normal: &Normal, values: &mut [f32]) {
        /// Enough for unknowns that explain alike; the matrix is small.
        const SWEEPS: usize = 200;
        let n = values.len();
        for _ in 0..SWEEPS {
            let mut largest_step = 0.0f64;
            for k in 0..n {
                let (expected, prior) = self.priors[k];
                let explained: f64 = normal.matrix[k * n..(k + 1) * n]
                    .iter()
                    .zip(&*values)
                    .map(|(a, &x)| a * f64::from(x))
                    .sum();
                // Half the price, as the squares' own factor 2 is left out.
                let gradient = normal.right[k] - explained + f64::from(prior * (expected - values[k]))
                    - 0.5 * f64::from(self.prices[k].per_unit(values[k]));
                let curvature = normal.matrix[k * n + k] + f64::from(prior);
                if curvature > 0.0 {
                    let value = (f64::from(values[k]) + gradient / curvature).max(0.0);
                    largest_step = largest_step.max((value - f64::from(values[k])).abs() * curvature.sqrt());
                    values[k] = value as f32;
                }
            }
            if largest_step < 1e-4 {
                break;
            }
        }
    }

    fn unexplained(&self, offsets: &[f32], values: &[f32]) -> Vec<f32> {
        let explained = |row: &Vec<f32>| row.iter().zip(values).map(|(a, x)| a * x).sum::<f32>();
        offsets
            .iter()
            .zip(&self.rows)
            .map(|(offset, row)| offset - explained(row))
            .collect()
    }

    fn cost(&self, deviations: &[f32], values: &[f32]) -> f32 {
        let huber = |off: &f32| {
            if off.abs() < HUBER {
                off * off
            } else {
                2.0 * HUBER * off.abs() - HUBER * HUBER
            }
        };
        let of_rows: f32 = deviations.iter().map(huber).sum();
        let of_values = values.iter().zip(self.prices.iter().zip(&self.priors));
        of_rows
            + of_values
                .map(|(value, (price, (expected, weight)))| price.total(*value) + weight * (value - expected).powi(2))
                .sum::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(rows: Vec<Vec<f32>>) -> Unknowns {
        Unknowns {
            prices: vec![Price::NONE; rows[0].len()],
            priors: vec![(0.0, 0.0); rows[0].len()],
            rows,
        }
    }

    #[test]
    fn an_exact_system_is_solved_and_nothing_goes_below_zero() {
        let unknowns = plain(vec![vec![1.0, 0.0], vec![0.0, 1.0], vec![1.0, 1.0]]);
        let solution = unknowns.solve(&[2.0, 3.0, 5.0]);
        assert!((solution.values[0] - 2.0).abs() < 1e-3 && (solution.values[1] - 3.0).abs() < 1e-3);
        assert!(solution.cost < 1e-4);
        let negative = unknowns.solve(&[-4.0, 3.0, 3.0]);
        assert_eq!(negative.values[0], 0.0);
    }

    #[test]
    fn one_outlier_among_many_rows_moves_little() {
        let unknowns = plain(vec![vec![1.0]; 20]);
        let mut offsets = vec![5.0; 20];
        offsets[3] = 500.0;
        let value = unknowns.solve(&offsets).values[0];
        assert!((value - 5.0).abs() < 0.2, "{value}");
    }
}
