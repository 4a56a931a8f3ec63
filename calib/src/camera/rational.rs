//! The radial factor of a perspective lens: a cubic in r², over another one in OpenCV's rational model.

/// Halvings of an interval after which a polynomial that is nearly zero on it counts as not positive.
const HALVINGS: usize = 40;

/// `f(s) = N(s) / D(s)` with `N = 1 + k1 s + k2 s² + k3 s³`, `D = 1 + k4 s + k5 s² + k6 s³` and `s = r²`.
///
/// In Brown and Conrady's model `D = 1` (Claus and Fitzgibbon 2005 gave the rational function; OpenCV `calib3d` the
/// coefficients).
pub(super) struct Radial {
    /// k1, k2, k3.
    pub(super) numerator: [f64; 3],
    /// k4, k5, k6.
    pub(super) denominator: [f64; 3],
}

impl Radial {
    /// f at this squared radius.
    pub(super) fn value(&self, s: f64) -> f64 {
        cubic(self.numerator, s) / cubic(self.denominator, s)
    }

    /// df/ds at this squared radius.
    pub(super) fn slope(&self, s: f64) -> f64 {
        let bottom = cubic(self.denominator, s);
        (cubic_slope(self.numerator, s) - cubic(self.numerator, s) / bottom * cubic_slope(self.denominator, s)) / bottom
    }

    /// Derivatives of f by k1 … k6.
    pub(super) fn by_coefficients(&self, s: f64) -> [f64; 6] {
        let by_k1 = s / cubic(self.denominator, s);
        let by_k4 = -by_k1 * self.value(s);
        [by_k1, by_k1 * s, by_k1 * s * s, by_k4, by_k4 * s, by_k4 * s * s]
    }

    /// Whether on `[0, end]` f is defined and both f and `f + 2 s f'` exceed `bound (1 + s)`, `bound` being 0 or more.
    ///
    /// f and `f + 2 s f' = d(r f)/dr` are the eigenvalues of the distortion's radial part. Times D and D² all three are
    /// polynomials, and their sign is decided on the whole interval, not on samples of it.
    pub(super) fn exceeds(&self, bound: f64, end: f64) -> bool {
        let [k1, k2, k3] = self.numerator;
        if self.denominator == [0.0; 3] {
            return positive_to([1.0 - bound, k1 - bound, k2, k3], end)
                && positive_to([1.0 - bound, 3.0 * k1 - bound, 5.0 * k2, 7.0 * k3], end);
        }
        let [k4, k5, k6] = self.denominator;
        let (top, bottom) = ([1.0, k1, k2, k3], [1.0, k4, k5, k6]);
        if !positive_to(bottom, end) {
            return false;
        }
        let bound = [bound, bound];
        let first: [f64; 5] = difference(&pad(&top), &product(&bound, &bottom));
        // N D + 2 s (N' D - N D'), term by term: the product of N's term i and D's term j occurs 1 + 2 (i - j) times.
        let mut along_radius = [0.0; 8];
        for (i, a) in top.iter().enumerate() {
            for (j, b) in bottom.iter().enumerate() {
                along_radius[i + j] += (1.0 + 2.0 * (i as f64 - j as f64)) * a * b;
            }
        }
        let square: [f64; 7] = product(&bottom, &bottom);
        let second: [f64; 8] = difference(&along_radius, &product(&bound, &square));
        is_positive(&first, end) && is_positive(&second, end)
    }
}

/// `1 + k[0] s + k[1] s² + k[2] s³`.
fn cubic(k: [f64; 3], s: f64) -> f64 {
    1.0 + s * (k[0] + s * (k[1] + s * k[2]))
}

/// Derivative of [`cubic`] by s.
fn cubic_slope(k: [f64; 3], s: f64) -> f64 {
    k[0] + s * (2.0 * k[1] + s * 3.0 * k[2])
}

/// Whether the cubic with these coefficients, constant first, is positive on `[0, end]`.
fn positive_to(coefficients: [f64; 4], end: f64) -> bool {
    let [c0, c1, c2, c3] = coefficients;
    let value = |s: f64| c0 + s * (c1 + s * (c2 + s * c3));
    if !(c0 > 0.0 && value(end) > 0.0) {
        return false;
    }
    // The extrema: 3 c3 s² + 2 c2 s + c1 = 0, solved without cancellation.
    let discriminant = c2 * c2 - 3.0 * c3 * c1;
    if discriminant <= 0.0 {
        return true;
    }
    let q = -(c2 + discriminant.sqrt().copysign(c2));
    [q / (3.0 * c3), c1 / q]
        .into_iter()
        .all(|s| !(s > 0.0 && s < end) || value(s) > 0.0)
}

/// Whether the polynomial with these coefficients, constant first, is positive on `[0, end]`.
///
/// A polynomial lies within the hull of its Bernstein coefficients (Farouki 2012, "The Bernstein polynomial basis: a
/// centennial retrospective", section 4.2): when all are positive, so is it. When not, the interval is halved.
fn is_positive<const N: usize>(coefficients: &[f64; N], end: f64) -> bool {
    let degree = N - 1;
    let mut scaled = *coefficients;
    let mut power = 1.0;
    for coefficient in &mut scaled {
        *coefficient *= power;
        power *= end;
    }
    let bernstein: [f64; N] = std::array::from_fn(|j| {
        // Σ_i C(j, i) / C(degree, i) a_i
        let mut ratio = 1.0;
        let mut sum = scaled[0];
        for (i, coefficient) in scaled.iter().enumerate().take(j + 1).skip(1) {
            ratio *= (j + 1 - i) as f64 / (degree + 1 - i) as f64;
            sum += ratio * coefficient;
        }
        sum
    });
    bernstein_is_positive(bernstein, HALVINGS)
}

fn bernstein_is_positive<const N: usize>(mut right: [f64; N], halvings: usize) -> bool {
    // The first and the last coefficient are values of the polynomial.
    if !(right[0] > 0.0 && right[N - 1] > 0.0) {
        return false;
    }
    if right.iter().all(|&b| b > 0.0) {
        return true;
    }
    if halvings == 0 {
        return false;
    }
    // De Casteljau's algorithm at the middle: its first column belongs to the left half, its last row to the right one.
    let mut left = right;
    for (level, first) in left.iter_mut().enumerate().skip(1) {
        for i in 0..N - level {
            right[i] = 0.5 * (right[i] + right[i + 1]);
        }
        *first = right[0];
    }
    bernstein_is_positive(left, halvings - 1) && bernstein_is_positive(right, halvings - 1)
}

/// Product of two polynomials; `N` is the number of its coefficients.
fn product<const N: usize>(a: &[f64], b: &[f64]) -> [f64; N] {
    let mut product = [0.0; N];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            product[i + j] += x * y;
        }
    }
    product
}

/// The same polynomial with zeros for its further coefficients.
fn pad<const N: usize>(a: &[f64]) -> [f64; N] {
    product(a, &[1.0])
}

fn difference<const N: usize>(a: &[f64; N], b: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] - b[i])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn signs_on_an_interval_agree_with_the_roots(
            roots in prop::array::uniform5(-3.0f64..3.0), pair in (-3.0f64..3.0, 0.05f64..2.0), end in 0.1f64..4.0,
        ) {
            // Five real roots and a complex pair a ± ib; positive at 0.
            let mut polynomial = [0.0; 8];
            polynomial[0] = 1.0;
            for root in roots {
                prop_assume!(root.abs() > 1e-3 && (root - end).abs() > 1e-6);
                polynomial = product(&polynomial[..7], &[1.0, -1.0 / root]);
            }
            let (a, b) = pair;
            polynomial = product(&polynomial[..6], &[1.0, -2.0 * a / (a * a + b * b), 1.0 / (a * a + b * b)]);
            // A double root inside would be undecided; apart from that the sign changes at the first root inside.
            let has_root = roots.iter().any(|&root| root > 0.0 && root < end);
            prop_assert_eq!(is_positive(&polynomial, end), !has_root);
        }

        #[test]
        fn rational_bounds_agree_with_samples(
            k in prop::array::uniform6(-0.5f64..0.5), bound in 0.0f64..0.01, end in 0.01f64..4.0,
        ) {
            let radial = Radial { numerator: [k[0], k[1], k[2]], denominator: [k[3], k[4], k[5]] };
            let holds = |s: f64| {
                let (value, slope) = (radial.value(s), radial.slope(s));
                let limit = bound * (1.0 + s);
                cubic(radial.denominator, s) > 0.0 && value > limit && value + 2.0 * s * slope > limit
            };
            let samples: Vec<f64> = (0..=2000).map(|i| end * f64::from(i) / 2000.0).collect();
            if radial.exceeds(bound, end) {
                prop_assert!(samples.iter().all(|&s| holds(s)));
            } else {
                // What is missed between samples is small.
                let slack = |s: f64| {
                    let value = radial.value(s);
                    let limit = bound * (1.0 + s) + 1e-4;
                    cubic(radial.denominator, s) > 1e-4 && value > limit && value + 2.0 * s * radial.slope(s) > limit
                };
                prop_assert!(!samples.iter().all(|&s| slack(s)));
            }
        }
    }

    #[test]
    fn a_denominator_of_one_is_the_plain_polynomial() {
        let numerator = [-0.3, 0.05, 0.01];
        let plain = Radial {
            numerator,
            denominator: [0.0; 3],
        };
        let nearly = Radial {
            numerator,
            denominator: [1e-15, 0.0, 0.0],
        };
        for i in 1..200 {
            let end = f64::from(i) * 0.02;
            assert_eq!(plain.exceeds(0.003, end), nearly.exceeds(0.003, end), "{end}");
        }
    }
}
