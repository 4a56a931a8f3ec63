//! The response of a camera from pictures of one scene at several exposure times.
//!
//! The unknown is g, the logarithm of the linear signal of every code. Two pictures that were exposed t₁ and t₂ seconds show the
//! same light with codes a and b, so `g(a) − g(b) = ln(t₁ / t₂)` (Debevec and Malik 1997, "Recovering high dynamic range
//! radiance maps from photographs", with the radiance eliminated). What is done otherwise than there:
//!
//! - Codes are means of small flat patches, all over the picture, and a and b are *equal quantiles* of them in the two
//!   pictures (Grossberg and Nayar 2003, "Determining the camera response from images: what is knowable?"). Noise in single
//!   pixels would pull g into a staircase that fits the ratios and is wrong.
//! - g is smooth in `u = ln(code − floor) − ln(280 − code)` rather than in the code, as the curves of films and cameras are
//!   (Hurter and Driffield 1890: an S over log exposure): a power law costs little at any code, and so does a soft shoulder.
//!   Smoothness is needed: where all ratios are powers of one number, anything periodic may be added to g (same
//!   paper).
//! - Residuals are weighted robustly (Cauchy), so that what moved counts for nothing, and g never falls (pool adjacent
//!   violators, Ayer et al. 1955).
//! - Exposure times may be nominal: then curve and exposure times are fitted in turns, see [`ExposureTimes`].

mod exposures;
mod patches;
mod ratios;
mod solve;

pub use patches::FlatPatches;
pub(crate) use ratios::pair_errors;
pub use ratios::{PairError, RatioErrors, ratio_errors};
pub(crate) use solve::pool_adjacent_violators;

use crate::response::ResponseCurve;

/// Turns of fitting curve and exposure times; twelve more move them by less than 0.001 EV (measured on a series of 16).
const TURNS: usize = 6;

/// One picture of the scene.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// Red, green, blue of each pixel, row by row.
    pub codes: &'a [u8],
    /// Pixels that show nothing, such as the borders of a registered picture.
    pub holes: Option<&'a [bool]>,
    /// Exposure time in seconds, or anything in proportion to the exposure; above 0.
    pub exposure_s: f64,
}

/// Whether red, green and blue share a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// One curve for all: what a sensor has.
    Shared,
    /// A curve each: film, and pictures whose colours were rendered.
    Separate,
}

/// Whether the exposure times are to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExposureTimes {
    /// As they are.
    Exact,
    /// To be corrected: each with a standard deviation of 5 % beforehand. A factor common to all, and one that grows with
    /// the exposure time, stay as they are, since no picture can tell them from another curve.
    Nominal,
    /// The same for each channel by itself: film, whose layers do not all fail reciprocity alike (Schwarzschild 1900).
    NominalPerChannel,
}

/// A fitted response.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedResponse {
    /// Curves of red, green and blue; equal when they share one.
    pub curves: [ResponseCurve; 3],
    /// Exposure times, per picture those of red, green and blue: those given, or corrected.
    pub exposures_s: Vec<[f64; 3]>,
    /// Codes, smallest and largest, that two pictures or more have told about; outside the curve is continued.
    pub known_codes: [u8; 2],
}

/// Why no response can be fitted.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FitError {
    /// One picture cannot tell.
    #[error("there are `{found}` pictures (allowed: 2 or more)")]
    Count {
        /// Number of pictures.
        found: usize,
    },
    /// A picture is not as large as said.
    #[error("picture `{picture}` has `{found}` values (allowed: `{expected}`)")]
    Size {
        /// Index of the picture.
        picture: usize,
        /// Number of values.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
    /// An exposure time is none.
    #[error("the exposure time of picture `{picture}` is `{found}` s (allowed: above 0, finite)")]
    Exposure {
        /// Index of the picture.
        picture: usize,
        /// What was found.
        found: f64,
    },
    /// All exposure times are equal.
    #[error("all exposure times are `{found}` s (allowed: at least two that differ by 5 % or more)")]
    EqualExposures {
        /// The exposure time.
        found: f64,
    },
    /// More light makes darker pictures: the exposures are not those of the pictures.
    #[error(
        "pictures of longer exposure are darker: what the picture of `{longer_s}` s shows is darker than in that of `{shorter_s}` s"
    )]
    Reversed {
        /// The longer exposure time.
        longer_s: f64,
        /// The shorter one.
        shorter_s: f64,
    },
    /// No two pictures show enough of the same things between black and white.
    #[error(
        "no two pictures of different exposure show `{needed}` flat patches between black and white in common (found: \
         `{found}` at most)"
    )]
    NothingInCommon {
        /// The most patches that two pictures have in common.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
}

/// Fits the response of the camera that took `shots` of `size_px` (width, height).
///
/// # Errors
/// When there are fewer than two pictures, sizes differ, exposure times are none or equal, or the pictures have too little in
/// common.
pub fn fit(
    shots: &[Shot<'_>],
    size_px: [usize; 2],
    channels: Channels,
    times: ExposureTimes,
) -> Result<FittedResponse, FitError> {
    let patches = FlatPatches::new(shots, size_px)?;
    fit_patches(&patches, channels, times)
}

/// The same from patches that are already there.
///
/// # Errors
/// When they have too little in common, or are darker the longer they were exposed.
pub fn fit_patches(
    patches: &FlatPatches,
    channels: Channels,
    times: ExposureTimes,
) -> Result<FittedResponse, FitError> {
    let groups: &[&[usize]] = match channels {
        Channels::Shared => &[&[0, 1, 2]],
        Channels::Separate => &[&[0], &[1], &[2]],
    };
    let solve = |log_exposures: &[Vec<f64>; 3]| -> Result<Vec<solve::Solution>, FitError> {
        groups
            .iter()
            .map(|group| solve::solve(patches, group, log_exposures))
            .collect()
    };
    if let Some([longer_s, shorter_s]) = patches.reversed() {
        return Err(FitError::Reversed { longer_s, shorter_s });
    }
    let nominal: Vec<f64> = patches.exposures_s().iter().map(|time| time.ln()).collect();
    let correct =
        |curves: &[ResponseCurve; 3], channels: &[usize]| exposures::correct(patches, curves, &nominal, channels);
    let mut log_exposures = [(); 3].map(|()| nominal.clone());
    let mut solutions = solve(&log_exposures)?;
    let turns = if times == ExposureTimes::Exact { 0 } else { TURNS };
    for _ in 0..turns {
        let curves = curves(&solutions);
        log_exposures = match times {
            ExposureTimes::Exact | ExposureTimes::Nominal => [(); 3].map(|()| correct(&curves, &[0, 1, 2])),
            ExposureTimes::NominalPerChannel => [0, 1, 2].map(|channel| correct(&curves, &[channel])),
        };
        solutions = solve(&log_exposures)?;
    }
    let codes = |end: usize| solutions.iter().map(move |solution| solution.known_codes[end]);
    let known_codes = [codes(0).min().unwrap_or(0), codes(1).max().unwrap_or(255)];
    Ok(FittedResponse {
        curves: curves(&solutions),
        exposures_s: match times {
            ExposureTimes::Exact => patches.channel_exposures_s(),
            ExposureTimes::Nominal | ExposureTimes::NominalPerChannel => (0..nominal.len())
                .map(|picture| log_exposures.each_ref().map(|logs| logs[picture].exp()))
                .collect(),
        },
        known_codes,
    })
}

/// Curves of red, green and blue, of one solution or three.
fn curves(solutions: &[solve::Solution]) -> [ResponseCurve; 3] {
    std::array::from_fn(|channel| solutions[channel.min(solutions.len() - 1)].curve.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::{
        noise::ChannelNoise,
        simulate::{Random, knee, knee_of},
    };

    const SIZE_PX: [usize; 2] = [320, 240];

    /// Squares of 8 pixels, their light spread evenly in the logarithm over a range of 1000, coloured.
    fn scene() -> Vec<[f64; 3]> {
        let mut random = Random::new(4);
        let columns = SIZE_PX[0] / 8;
        let squares: Vec<[f64; 3]> = (0..columns * SIZE_PX[1] / 8)
            .map(|_| {
                let grey = 1e-3 * 1e3f64.powf(random.uniform());
                [0; 3].map(|_| grey * (0.7 + 0.6 * random.uniform()))
            })
            .collect();
        let square = |pixel: usize| pixel / SIZE_PX[0] / 8 * columns + pixel % SIZE_PX[0] / 8;
        (0..SIZE_PX[0] * SIZE_PX[1])
            .map(|pixel| squares[square(pixel)])
            .collect()
    }

    /// The scene through a camera, per exposure time.
    fn bracket(response: &ResponseCurve, exposures_s: &[f64]) -> Vec<Vec<u8>> {
        let scene = scene();
        let mut random = Random::new(9);
        let shoot = |&exposure_s: &f64| {
            let noise = ChannelNoise {
                signal_per_radiance: exposure_s,
                signal_per_electron: 1.0 / 12_000.0,
                read_noise_e: 6.0,
                code_noise: 0.0,
            };
            let codes = scene
                .iter()
                .flatten()
                .map(|&radiance| random.code(response, &noise, radiance));
            codes.collect()
        };
        exposures_s.iter().map(shoot).collect()
    }

    fn shots<'a>(codes: &'a [Vec<u8>], exposures_s: &[f64]) -> Vec<Shot<'a>> {
        let shot = |(codes, &exposure_s): (&'a Vec<u8>, &f64)| Shot {
            codes,
            holes: None,
            exposure_s,
        };
        codes.iter().zip(exposures_s).map(shot).collect()
    }

    /// Relative error over the middle codes, 32 to 224, root mean square, after the best common factor.
    fn error(found: &ResponseCurve, truth: &ResponseCurve) -> f64 {
        let ratios: Vec<f64> = (32..=224)
            .map(|code| found.linear_from_code(code) / truth.linear_from_code(code))
            .collect();
        let n = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / n;
        (ratios.iter().map(|ratio| (ratio / mean - 1.0).powi(2)).sum::<f64>() / n).sqrt()
    }

    const TIMES_S: [f64; 5] = [0.25, 1.0, 4.0, 16.0, 64.0];

    #[test]
    fn a_known_response_comes_back() {
        for (name, truth) in [
            ("srgb", ResponseCurve::srgb()),
            ("knee", knee()),
            ("knee, gamma 1.8", knee_of(1.8)),
        ] {
            let codes = bracket(&truth, &TIMES_S);
            for channels in [Channels::Shared, Channels::Separate] {
                let found = fit(&shots(&codes, &TIMES_S), SIZE_PX, channels, ExposureTimes::Exact).unwrap();
                for curve in &found.curves {
                    let error = error(curve, &truth);
                    println!("{name} {channels:?} {error:.4}");
                    assert!(error < 0.01, "{name}: {error}");
                }
            }
        }
    }

    #[test]
    fn three_exposures_are_enough() {
        let codes = bracket(&knee(), &TIMES_S[1..4]);
        let shots = shots(&codes, &TIMES_S[1..4]);
        let found = fit(&shots, SIZE_PX, Channels::Shared, ExposureTimes::Exact).unwrap();
        let error = error(&found.curves[1], &knee());
        println!("{error:.4}");
        assert!(error < 0.015, "{error}");
        let patches = FlatPatches::new(&shots, SIZE_PX).unwrap();
        let errors = ratio_errors(&patches, &found.curves, &patches.channel_exposures_s()).unwrap();
        println!("{errors:?}");
        assert!(
            errors.pair_median < 0.005 && errors.worst.error.abs() < 0.02,
            "{errors:?}"
        );
        // The measure sees a wrong curve.
        let wrong = [knee_of(1.8), knee_of(1.8), knee_of(1.8)];
        assert!(
            ratio_errors(&patches, &wrong, &patches.channel_exposures_s())
                .unwrap()
                .pair_median
                > 0.1
        );
    }

    #[test]
    fn nominal_exposure_times_are_corrected() {
        let actual = [0.25, 1.0 * 1.06, 4.0, 16.0 * 0.95, 64.0];
        let codes = bracket(&knee(), &actual);
        let found = fit(
            &shots(&codes, &TIMES_S),
            SIZE_PX,
            Channels::Shared,
            ExposureTimes::Nominal,
        )
        .unwrap();
        // What is common to all, or grows with the exposure, cannot be seen: compare without it.
        let unseen = |times: &[f64]| -> Vec<f64> {
            let x = [-2.0, -1.0, 0.0, 1.0, 2.0];
            let y: Vec<f64> = times
                .iter()
                .zip(TIMES_S)
                .map(|(t, nominal)| (t / nominal).ln())
                .collect();
            let mean = y.iter().sum::<f64>() / 5.0;
            let tilt = x.iter().zip(&y).map(|(x, y)| x * y).sum::<f64>() / 10.0;
            y.iter().zip(x).map(|(y, x)| y - mean - tilt * x).collect()
        };
        let greens: Vec<f64> = found.exposures_s.iter().map(|times| times[1]).collect();
        for (found, actual) in unseen(&greens).into_iter().zip(unseen(&actual)) {
            println!("{found:.4} {actual:.4}");
            assert!((found - actual).abs() < 0.01, "{found} {actual}");
        }
    }

    #[test]
    fn channels_may_fail_reciprocity_by_themselves() {
        // Red and blue of the fourth picture saw 6 % more and less than its time says, as a film's layers may.
        let factors = [1.06, 1.0, 0.94];
        let mut codes = bracket(&knee(), &TIMES_S);
        let of_factors = factors.map(|factor| bracket(&knee(), &[TIMES_S[3] * factor]));
        for (channel, of_factor) in of_factors.iter().enumerate() {
            for (code, other) in codes[3].iter_mut().zip(&of_factor[0]).skip(channel).step_by(3) {
                *code = *other;
            }
        }
        let worst = |times: ExposureTimes| {
            let shots = shots(&codes, &TIMES_S);
            let patches = FlatPatches::new(&shots, SIZE_PX).unwrap();
            let found = fit_patches(&patches, Channels::Separate, times).unwrap();
            let errors = ratio_errors(&patches, &found.curves, &found.exposures_s).unwrap();
            (errors.worst.error.abs(), found.exposures_s[3])
        };
        let (together, _) = worst(ExposureTimes::Nominal);
        let (apart, times) = worst(ExposureTimes::NominalPerChannel);
        println!("{together:.4} {apart:.4} {times:?}");
        assert!(apart < 0.02 && together > 2.0 * apart, "{together} {apart}");
        assert!(times[0] > times[1] && times[1] > times[2], "{times:?}");
    }

    #[test]
    fn what_moves_does_not_bend_the_curve() {
        let mut codes = bracket(&knee(), &TIMES_S);
        // A tenth of the fourth picture is something else.
        let part = codes[3].len() / 10;
        codes[3][..part].fill(140);
        let found = fit(
            &shots(&codes, &TIMES_S),
            SIZE_PX,
            Channels::Shared,
            ExposureTimes::Exact,
        )
        .unwrap();
        let error = error(&found.curves[0], &knee());
        println!("{error:.4}");
        assert!(error < 0.02, "{error}");
    }

    #[test]
    fn what_tells_nothing_is_refused() {
        let fit = |codes: &[Vec<u8>], times: &[f64]| {
            fit(&shots(codes, times), SIZE_PX, Channels::Shared, ExposureTimes::Exact)
                .unwrap_err()
                .to_string()
        };
        let n = 3 * SIZE_PX[0] * SIZE_PX[1];
        let grey = vec![vec![90; n], vec![60; n]];
        assert_eq!(fit(&grey[..1], &[1.0]), "there are `1` pictures (allowed: 2 or more)");
        assert_eq!(
            fit(&[grey[0].clone(), vec![9; 5]], &[1.0, 2.0]),
            format!("picture `1` has `5` values (allowed: `{n}`)")
        );
        assert_eq!(
            fit(&grey, &[1.0, f64::NAN]),
            "the exposure time of picture `1` is `NaN` s (allowed: above 0, finite)"
        );
        assert_eq!(
            fit(&grey, &[0.5, 0.51]),
            "all exposure times are `0.5` s (allowed: at least two that differ by 5 % or more)"
        );
        assert_eq!(
            fit(&[vec![255; n], vec![0; n]], &[1.0, 2.0]),
            "no two pictures of different exposure show `100` flat patches between black and white in common (found: \
             `0` at most)"
        );
    }
}
