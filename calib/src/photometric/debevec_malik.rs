//! The response as Debevec and Malik find it (1997, "Recovering high dynamic range radiance maps from photographs", eq. 3 and 4):
//! the classic, to compare with.
//!
//! Single pixels at places spread over the picture; g(code) and the logarithm of each place's light are unknown; residuals have
//! hat-shaped weights, and g's second differences are small. Here each place's light is eliminated, which changes nothing. Two things
//! are kinder than the original: many more places than the fifty they took, and a result that rises.

use nalgebra::{DMatrix, DVector};

use crate::{
    response::ResponseCurve,
    response_fit::{Shot, pool_adjacent_violators},
};

const CODES: usize = 256;

/// Places in the picture.
const PLACES: usize = 400;

/// λ of the paper's eq. 4; OpenCV's choice.
const SMOOTHNESS: f64 = 10.0;

/// Weight of g(128) = 0.
const FIXED: f64 = 1e8;

/// Finds the curves of red, green and blue. Pictures must all have `size_px` (width, height).
#[must_use]
pub fn fit(shots: &[Shot<'_>], size_px: [usize; 2]) -> [ResponseCurve; 3] {
    std::array::from_fn(|channel| curve(shots, size_px, channel))
}

fn curve(shots: &[Shot<'_>], size_px: [usize; 2], channel: usize) -> ResponseCurve {
    let (mut normal, mut right) = (DMatrix::zeros(CODES, CODES), DVector::zeros(CODES));
    for pixel in places(shots, size_px) {
        let seen: Vec<(usize, f64, f64)> = shots
            .iter()
            .map(|shot| (usize::from(shot.codes[3 * pixel + channel]), shot.exposure_s.ln()))
            .map(|(code, log_exposure)| (code, log_exposure, hat(code).powi(2)))
            .collect();
        let total: f64 = seen.iter().map(|(_, _, weight)| weight).sum();
        // Light eliminated: residuals about their weighted mean.
        for &(a, log_a, weight_a) in &seen {
            normal[(a, a)] += weight_a;
            right[a] += weight_a * log_a;
            for &(b, log_b, weight_b) in &seen {
                normal[(a, b)] -= weight_a * weight_b / total;
                right[a] -= weight_a * weight_b / total * log_b;
            }
        }
    }
    for code in 1..CODES - 1 {
        let weight = (SMOOTHNESS * hat(code)).powi(2);
        for (i, factor_i) in [(code - 1, 1.0), (code, -2.0), (code + 1, 1.0)] {
            for (j, factor_j) in [(code - 1, 1.0), (code, -2.0), (code + 1, 1.0)] {
                normal[(i, j)] += weight * factor_i * factor_j;
            }
        }
    }
    normal[(128, 128)] += FIXED;
    // Without two exposures the slope is free.
    for code in 0..CODES {
        normal[(code, code)] += 1e-6;
    }
    let Some(cholesky) = normal.cholesky() else {
        return ResponseCurve::srgb();
    };
    let mut g = cholesky.solve(&right);
    pool_adjacent_violators(g.as_mut_slice());
    let top = g[CODES - 1];
    let values: Vec<f64> = g
        .iter()
        .enumerate()
        .map(|(code, g)| if code == 0 { 0.0 } else { (g - top).exp() })
        .collect();
    ResponseCurve::from_table(&values).expect("pooled values rise from 0 to 1")
}

/// Eq. 4: large in the middle of the scale.
fn hat(code: usize) -> f64 {
    (code.min(CODES - 1 - code) + 1) as f64
}

/// Pixels spread evenly over the picture (a Kronecker sequence, Roberts 2018), outside of holes.
fn places(shots: &[Shot<'_>], [width, height]: [usize; 2]) -> Vec<usize> {
    let is_hole = |pixel: usize| shots.iter().any(|shot| shot.holes.is_some_and(|holes| holes[pixel]));
    (0..4 * PLACES)
        .map(|i| {
            let at = |step: f64, n: usize| ((i as f64 * step).fract() * n as f64) as usize;
            at(0.569_840_290_998, height) * width + at(0.754_877_666_247, width)
        })
        .filter(|&pixel| pixel < width * height && !is_hole(pixel))
        .take(PLACES)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::simulate::knee;

    #[test]
    fn a_known_response_comes_back_roughly() {
        // No noise: a ramp of light.
        let size_px = [200, 100];
        let times = [0.25, 1.0, 4.0];
        let pictures: Vec<Vec<u8>> = times
            .iter()
            .map(|time| {
                (0..3 * size_px[0] * size_px[1])
                    .map(|i| 1e-3 * 1e3f64.powf((i / 3 % size_px[0]) as f64 / size_px[0] as f64))
                    .map(|radiance| knee().encode(time * radiance))
                    .collect()
            })
            .collect();
        let shots: Vec<Shot<'_>> = pictures
            .iter()
            .zip(times)
            .map(|(codes, exposure_s)| Shot {
                codes,
                holes: None,
                exposure_s,
            })
            .collect();
        let [red, ..] = fit(&shots, size_px);
        let at = |curve: &ResponseCurve, code: u8| curve.linear_from_code(code) / curve.linear_from_code(128);
        for code in [48, 80, 180, 220] {
            let ratio = at(&red, code) / at(&knee(), code);
            println!("{code} {ratio:.4}");
            assert!((ratio - 1.0).abs() < 0.04, "{code}: {ratio}");
        }
    }
}
