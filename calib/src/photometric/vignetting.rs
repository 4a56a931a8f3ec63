//! Vignetting from pictures of an evenly lit surface.
//!
//! No sheet is lit evenly. In the logarithm, what a picture shows is `ln V(r) + ln light(x, y)`, and light that changes
//! slowly is, to second order, `c + gx·x + gy·y + a(x² − y²) + b·x·y + e(x² + y²)`. All but the last term are orthogonal to anything
//! that depends on r alone, so each picture gets them as unknowns of its own and they cost nothing. The last one looks like
//! vignetting in one picture: it must differ between pictures, hence several positions or orientations of the sheet, of which the
//! mean is taken (Goldman 2010, "Vignette and exposure calibration and compensation", needs the same separation).

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use crate::{least_squares::loss::Loss, response::ResponseCurve};

/// Cells along the picture's longer side.
const CELLS: usize = 48;

/// Fewest cells that a picture must show between black and white.
const MIN_CELLS: usize = 100;

/// Terms of a picture's own light.
const LIGHT_TERMS: usize = 5;

/// Standard deviation of ln(signal) that no averaging removes.
const LEAST_DEVIATION: f64 = 1e-4;

/// Rounds of robust weighting and of Gauss-Newton.
const ROUNDS: usize = 30;

/// Change of v1 and v2 at which they have settled.
const SETTLED: f64 = 1e-9;

/// A picture of an evenly lit surface that fills it.
#[derive(Debug, Clone, Copy)]
pub struct FlatPicture<'a> {
    /// Red, green, blue of each pixel, row by row.
    pub codes: &'a [u8],
    /// Width and height.
    pub size_px: [usize; 2],
}

/// Vignetting as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Vignetting {
    /// v1 and v2 of `V = 1 + v1 r² + v2 r⁴`, r in half diagonals.
    pub coefficients: [f64; 2],
    /// Standard deviation of V in the corner (r = 1): between the pictures if there are three or more, else what the scatter
    /// within them says, which does not know of a light that falls off around the middle.
    pub corner_sigma: f64,
    /// Root mean square relative residual of the cells that count.
    pub rms: f64,
    /// Profile for plots: r, and the signal over the picture's own light there, of every cell.
    pub profile: Vec<[f64; 2]>,
    /// Largest change of the light over a picture from corner to corner, as a ratio of 1 or more.
    pub unevenness: f64,
}

/// Why vignetting cannot be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum VignettingError {
    /// There is no picture.
    #[error("there is no picture of an evenly lit surface (allowed: 1 or more)")]
    None,
    /// A picture is so small, or so long and thin, that it has too few cells.
    #[error(
        "flat picture `{picture}` of `{} x {}` pixels is too small, or too long and thin: it has `{found}` cells (allowed: at least `100`)", size_px[0], size_px[1]
    )]
    Shape {
        /// Index of the picture.
        picture: usize,
        /// Its width and height.
        size_px: [usize; 2],
        /// Cells.
        found: usize,
    },
    /// A picture is too dark, too bright or not as large as said.
    #[error("flat picture `{picture}` shows `{found}` cells between black and white (allowed: at least `100`)")]
    Clipped {
        /// Index of the picture.
        picture: usize,
        /// Usable cells.
        found: usize,
    },
    /// The cells do not fit the model: the picture shows a scene.
    #[error("flat picture `{picture}` is not flat: its cells differ from smooth light by `{rms:.3}` (allowed: `0.1`)")]
    NotFlat {
        /// Index of the picture.
        picture: usize,
        /// Robust relative deviation.
        rms: f64,
    },
}

struct Cell {
    /// r².
    square: f64,
    log_signal: f64,
    light: [f64; LIGHT_TERMS],
}

/// Measures vignetting.
///
/// # Errors
/// When there is no picture, one has too few cells, shows too little between black and white, or a scene instead of a flat field.
pub fn measure(pictures: &[FlatPicture<'_>], response: &ResponseCurve) -> Result<Vignetting, VignettingError> {
    if pictures.is_empty() {
        return Err(VignettingError::None);
    }
    let views: Vec<Vec<Cell>> = pictures.iter().map(|picture| cells(picture, response)).collect();
    for (picture, view) in views.iter().enumerate() {
        let size_px = pictures[picture].size_px;
        let [columns, rows] = size_px.map(|side| side.div_ceil(cell_side(size_px)));
        if columns * rows < MIN_CELLS {
            let found = columns * rows;
            return Err(VignettingError::Shape {
                picture,
                size_px,
                found,
            });
        }
        if view.len() < MIN_CELLS {
            return Err(VignettingError::Clipped {
                picture,
                found: view.len(),
            });
        }
    }
    let all: Vec<&[Cell]> = views.iter().map(Vec::as_slice).collect();
    let fit = solve(&all);
    for (picture, rms) in fit.rms.iter().enumerate() {
        if *rms > 0.1 {
            return Err(VignettingError::NotFlat { picture, rms: *rms });
        }
    }
    let corner_sigma = if views.len() < 3 {
        (Vector2::new(1.0, 1.0).transpose() * fit.covariance * Vector2::new(1.0, 1.0))[0].sqrt()
    } else {
        let corners: Vec<f64> = all.iter().map(|view| solve(&[view]).coefficients.sum()).collect();
        let n = corners.len() as f64;
        let mean = corners.iter().sum::<f64>() / n;
        (corners.iter().map(|corner| (corner - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt()
    };
    let profile = views.iter().zip(&fit.lights).flat_map(|(view, light)| {
        view.iter().map(move |cell| {
            let own: f64 = cell.light.iter().zip(light).map(|(term, factor)| term * factor).sum();
            [cell.square.sqrt(), (cell.log_signal - own).exp()]
        })
    });
    let spread = |light: &[f64; LIGHT_TERMS]| 2.0 * (light[1].hypot(light[2]) + light[3].hypot(light[4]));
    Ok(Vignetting {
        coefficients: fit.coefficients.into(),
        corner_sigma,
        rms: fit.rms.iter().fold(0.0, |worst, &rms| worst.max(rms)),
        profile: profile.collect(),
        unevenness: fit.lights.iter().map(spread).fold(0.0, f64::max).exp(),
    })
}

/// Edge of a cell in pixels.
fn cell_side([width, height]: [usize; 2]) -> usize {
    width.max(height).div_ceil(CELLS).max(1)
}

/// Means of the signal over cells of the picture; clipped ones are left out.
fn cells(picture: &FlatPicture<'_>, response: &ResponseCurve) -> Vec<Cell> {
    let [width, height] = picture.size_px;
    if picture.codes.len() != 3 * width * height {
        return Vec::new();
    }
    let side = cell_side(picture.size_px);
    let (black, clipped) = (response.last_black_code(), response.first_clipped_code());
    let size = DVec2::new(width as f64, height as f64);
    let mut cells = Vec::new();
    for top in (0..height).step_by(side) {
        for left in (0..width).step_by(side) {
            let (bottom, right) = ((top + side).min(height), (left + side).min(width));
            let (mut sum, mut n, mut is_inside) = (0.0, 0.0, true);
            for y in top..bottom {
                for code in &picture.codes[3 * (y * width + left)..3 * (y * width + right)] {
                    is_inside &= (black + 1..clipped).contains(code);
                    sum += response.linear_from_code(*code);
                    n += 1.0;
                }
            }
            if !is_inside || sum <= 0.0 {
                continue;
            }
            let middle = 0.5 * DVec2::new((left + right - 1) as f64, (top + bottom - 1) as f64);
            let p = (middle - 0.5 * (size - 1.0)) / (0.5 * size.length());
            // Over the cell, r² is larger than at its middle by its variance.
            let spread = [right - left, bottom - top].map(|n| ((n * n) as f64 - 1.0) / 12.0);
            let square = p.length_squared() + (spread[0] + spread[1]) / (0.25 * size.length_squared());
            cells.push(Cell {
                square,
                log_signal: (sum / n).ln(),
                light: [1.0, p.x, p.y, p.x * p.x - p.y * p.y, p.x * p.y],
            });
        }
    }
    cells
}

struct Fit {
    coefficients: Vector2<f64>,
    covariance: Matrix2<f64>,
    lights: Vec<[f64; LIGHT_TERMS]>,
    /// Per picture.
    rms: Vec<f64>,
}

/// Gauss-Newton over v1, v2 and every picture's light, which is eliminated picture by picture; Cauchy weights.
fn solve(views: &[&[Cell]]) -> Fit {
    let mut v = Vector2::zeros();
    let mut lights = vec![[0.0; LIGHT_TERMS]; views.len()];
    let mut rms = vec![0.0; views.len()];
    let mut covariance = Matrix2::zeros();
    for round in 0..ROUNDS {
        let mut normal = Matrix2::zeros();
        let mut right = Vector2::zeros();
        for ((view, light), rms) in views.iter().zip(&mut lights).zip(&mut rms) {
            let weights = if round == 0 {
                vec![1.0; view.len()]
            } else {
                weights(view, v, light)
            };
            // What the cells say about v1 and v2 once the picture's own light explains all it can.
            let (basis, slopes, residual) = linearised(view, v, &weights);
            let own = basis.tr_mul(&basis);
            let Some(cholesky) = own.cholesky() else { continue };
            let slopes_left = &slopes - &basis * cholesky.solve(&basis.tr_mul(&slopes));
            let residual_left = &residual - &basis * cholesky.solve(&basis.tr_mul(&residual));
            normal += slopes_left.tr_mul(&slopes_left).fixed_view::<2, 2>(0, 0);
            right += slopes_left.tr_mul(&residual_left).fixed_view::<2, 1>(0, 0);
            let found = cholesky.solve(&basis.tr_mul(&residual));
            *light = std::array::from_fn(|i| found[i]);
            *rms = (residual_left.norm_squared() / weights.iter().sum::<f64>()).sqrt();
        }
        let Some(inverse) = normal.try_inverse() else { break };
        let mean_square = rms.iter().map(|rms| rms * rms).sum::<f64>() / rms.len() as f64;
        covariance = inverse * mean_square;
        let mut step = inverse * right;
        // ln V must stay defined in the corner.
        while 1.0 + (v + step).sum() < 0.05 || 1.0 + 0.25 * (v + step)[0] + 0.0625 * (v + step)[1] < 0.05 {
            step *= 0.5;
        }
        v += step;
        if round > 1 && step.amax() < SETTLED {
            break;
        }
    }
    Fit {
        coefficients: v,
        covariance,
        lights,
        rms,
    }
}

fn log_vignetting(square: f64, v: Vector2<f64>) -> (f64, [f64; 2]) {
    let value = (1.0 + square * (v[0] + square * v[1])).max(1e-3);
    (value.ln(), [square / value, square * square / value])
}

/// Basis of the light, slopes by v1 and v2, and ln(signal) − ln V, each row times the root of its weight.
fn linearised(view: &[Cell], v: Vector2<f64>, weights: &[f64]) -> (DMatrix<f64>, DMatrix<f64>, DVector<f64>) {
    let n = view.len();
    let (mut basis, mut slopes, mut residual) =
        (DMatrix::zeros(n, LIGHT_TERMS), DMatrix::zeros(n, 2), DVector::zeros(n));
    for (i, (cell, weight)) in view.iter().zip(weights).enumerate() {
        let root = weight.sqrt();
        let (log, by_v) = log_vignetting(cell.square, v);
        for (j, term) in cell.light.iter().enumerate() {
            basis[(i, j)] = root * term;
        }
        slopes[(i, 0)] = root * by_v[0];
        slopes[(i, 1)] = root * by_v[1];
        residual[i] = root * (cell.log_signal - log);
    }
    (basis, slopes, residual)
}

/// Cauchy weights of the cells by their deviation from the present fit, in robust standard deviations: dust counts little.
fn weights(view: &[Cell], v: Vector2<f64>, light: &[f64; LIGHT_TERMS]) -> Vec<f64> {
    let residuals: Vec<f64> = view
        .iter()
        .map(|cell| {
            let own: f64 = cell.light.iter().zip(light).map(|(term, factor)| term * factor).sum();
            (cell.log_signal - own - log_vignetting(cell.square, v).0).abs()
        })
        .collect();
    let mut sorted = residuals.clone();
    sorted.sort_by(f64::total_cmp);
    // Median absolute deviation of a normal distribution: 0.6745 σ.
    let sigma = (sorted[sorted.len() / 2] / 0.6745).max(LEAST_DEVIATION);
    residuals
        .into_iter()
        .map(|residual| Loss::Cauchy.cost_and_weight(residual / (3.0 * sigma)).1)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::{
        noise::ChannelNoise,
        simulate::{Random, knee},
    };

    const SIZE_PX: [usize; 2] = [192, 144];

    /// A sheet under a light that falls off from `lamp` (in half diagonals) with strength `fall`, turned about the middle.
    fn flat(seed: u64, v: [f64; 2], light: impl Fn(DVec2) -> f64) -> Vec<u8> {
        let mut random = Random::new(seed);
        let noise = ChannelNoise {
            signal_per_radiance: 1.0,
            signal_per_electron: 1.0 / 12_000.0,
            read_noise_e: 6.0,
            code_noise: 0.0,
        };
        let size = DVec2::new(SIZE_PX[0] as f64, SIZE_PX[1] as f64);
        let mut codes = Vec::new();
        for y in 0..SIZE_PX[1] {
            for x in 0..SIZE_PX[0] {
                let p = (DVec2::new(x as f64, y as f64) - 0.5 * (size - 1.0)) / (0.5 * size.length());
                let s = p.length_squared();
                let radiance = light(p) * (1.0 + v[0] * s + v[1] * s * s);
                for tint in [0.45, 0.5, 0.4] {
                    codes.push(random.code(&knee(), &noise, tint * radiance));
                }
            }
        }
        codes
    }

    fn measured(pictures: &[Vec<u8>]) -> Vignetting {
        let flats: Vec<FlatPicture<'_>> = pictures
            .iter()
            .map(|codes| FlatPicture {
                codes,
                size_px: SIZE_PX,
            })
            .collect();
        measure(&flats, &knee()).unwrap()
    }

    /// Largest error of V over the picture.
    fn error(found: &Vignetting, truth: [f64; 2]) -> f64 {
        (0..=20)
            .map(|step| f64::from(step) / 20.0)
            .map(|s| (s * (found.coefficients[0] - truth[0]) + s * s * (found.coefficients[1] - truth[1])).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn known_vignetting_comes_back_under_a_slanted_light() {
        for (seed, truth) in [(1, [-0.31, 0.06]), (2, [0.0, 0.0]), (3, [-0.05, -0.4])] {
            let light = |p: DVec2| (0.3 * p.x - 0.2 * p.y + 0.1 * (p.x * p.x - p.y * p.y) + 0.1 * p.x * p.y).exp();
            let found = measured(&[flat(seed, truth, light)]);
            println!("{truth:?} {:?} {:.5}", found.coefficients, error(&found, truth));
            assert!(error(&found, truth) < 0.005, "{:?}", found.coefficients);
            assert!(found.unevenness > 1.5, "{}", found.unevenness);
        }
    }

    #[test]
    fn several_positions_average_light_that_falls_off_around_the_middle() {
        // In one picture nobody can tell such light from vignetting; over positions it averages out.
        let truth = [-0.25, 0.03];
        let falls = [0.03, -0.02, 0.01, -0.03, -0.01, 0.02];
        let views: Vec<Vec<u8>> = falls
            .iter()
            .zip(10..)
            .map(|(fall, seed)| {
                flat(seed, truth, |p| {
                    (fall * p.length_squared() + 0.2 * fall.signum() * p.x).exp()
                })
            })
            .collect();
        let found = measured(&views);
        println!(
            "{:?} {:.5} {:.5}",
            found.coefficients,
            error(&found, truth),
            found.corner_sigma
        );
        assert!(error(&found, truth) < 0.005);
        // The falls' standard deviation over the root of 6, times V in the corner.
        let expected = 0.0237 / 6f64.sqrt() * 0.78;
        assert!(
            (0.7..1.4).contains(&(found.corner_sigma / expected)),
            "{}",
            found.corner_sigma
        );
        let one = measured(&views[..1]);
        assert!(error(&one, truth) > 0.01, "the measure of this test sees nothing");
    }

    #[test]
    fn dust_does_not_count() {
        let truth = [-0.2, 0.0];
        let mut picture = flat(4, truth, |_| 1.0);
        for y in 10..30 {
            for x in 150..180 {
                let pixel = 3 * (y * SIZE_PX[0] + x);
                picture[pixel..pixel + 3].fill(60);
            }
        }
        let found = measured(&[picture]);
        println!("{:?} {:.5}", found.coefficients, error(&found, truth));
        assert!(error(&found, truth) < 0.005);
    }

    #[test]
    fn what_is_not_flat_is_refused() {
        assert_eq!(measure(&[], &knee()), Err(VignettingError::None));
        let n = 3 * SIZE_PX[0] * SIZE_PX[1];
        let white = vec![255; n];
        let picture = |codes| FlatPicture {
            codes,
            size_px: SIZE_PX,
        };
        let error = measure(&[picture(&white)], &knee()).unwrap_err();
        assert_eq!(error, VignettingError::Clipped { picture: 0, found: 0 });
        let thin = vec![128; 3 * 400 * 10];
        let thin = FlatPicture {
            codes: &thin,
            size_px: [400, 10],
        };
        let expected = VignettingError::Shape {
            picture: 0,
            size_px: [400, 10],
            found: 90,
        };
        assert_eq!(measure(&[thin], &knee()).unwrap_err(), expected);
        let board: Vec<u8> = (0..n)
            .map(|i| {
                if (i / 3 % SIZE_PX[0] / 16 + i / 3 / SIZE_PX[0] / 16).is_multiple_of(2) {
                    200
                } else {
                    50
                }
            })
            .collect();
        let error = measure(&[picture(&board)], &knee()).unwrap_err();
        assert!(matches!(error, VignettingError::NotFlat { picture: 0, .. }), "{error}");
    }
}
