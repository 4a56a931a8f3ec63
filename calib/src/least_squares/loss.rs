//! How much an error counts.

/// Huber's constant in standard deviations (Huber 1981): 95 % efficient on normal errors.
pub const HUBER: f64 = 1.345;

/// A robust loss of errors measured in standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Loss {
    /// Half the square.
    Squares,
    /// Half the square up to [`HUBER`], linear beyond: one minimum (Huber 1964).
    Huber,
    /// Logarithmic (Cauchy): what is far off hardly counts.
    Cauchy,
}

impl Loss {
    /// Cost of a deviation of 0 or more, and its weight in the normal equations.
    #[must_use]
    pub fn cost_and_weight(self, deviation: f64) -> (f64, f64) {
        match self {
            Self::Huber if deviation > HUBER => (HUBER * (deviation - 0.5 * HUBER), HUBER / deviation),
            Self::Squares | Self::Huber => (0.5 * deviation * deviation, 1.0),
            Self::Cauchy => {
                let square = deviation * deviation;
                (0.5 * square.ln_1p(), 1.0 / (1.0 + square))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_slope_over_the_deviation() {
        for loss in [Loss::Squares, Loss::Huber, Loss::Cauchy] {
            for deviation in [0.01, 0.5, 1.3, 1.4, 7.0] {
                let cost = |x| loss.cost_and_weight(x).0;
                let slope = (cost(deviation + 1e-6) - cost(deviation - 1e-6)) / 2e-6;
                let (_, weight) = loss.cost_and_weight(deviation);
                assert!((slope / deviation - weight).abs() < 1e-6, "{loss:?} {deviation}");
            }
        }
    }
}
