//! The measurements, in their order: each stands on those before.

use std::borrow::Cow;

use glam::DMat3;
use mirrorball_calib::{
    photometric::{
        black::{self, BlackLevel},
        debevec_malik,
        latency::{self, ControlLatency, Level, Request},
        linearity::{self, ResponseIs, TrueExposure},
        noise::{self, Repeats, SensorNoise},
        vignetting::{self, FlatPicture, Vignetting},
    },
    photometry::Photometry,
    response::ResponseCurve,
    response_fit::{Channels, ExposureTimes, FlatPatches, RatioErrors, Shot, fit_patches, ratio_errors},
};

use super::{
    Args, PhotometricError, ResponseFrom,
    series::{RequestLine, Series, read_csv, read_folder},
};
use crate::commands::CommandError;

/// Repeats of a setting that the response is fitted to; more say the same again.
const REPEATS_FOR_RESPONSE: usize = 3;

/// Share of a picture's pixels, from the darkest, at which its level is read: neither black nor clipped in most scenes.
const LEVEL_SHARE: f64 = 0.5;

/// Everything measured.
pub(super) struct Measured {
    pub(super) curves: [ResponseCurve; 3],
    pub(super) known_codes: Option<[u8; 2]>,
    pub(super) exposures: Vec<TrueExposure>,
    pub(super) errors: Option<RatioErrors>,
    pub(super) rivals: Option<Rivals>,
    pub(super) noise: Option<SensorNoise>,
    pub(super) vignetting: Option<Vignetting>,
    pub(super) black: Option<BlackLevel>,
    pub(super) latency: Option<ControlLatency>,
}

/// The same pictures by other means.
pub(super) struct Rivals {
    pub(super) debevec_malik: [ResponseCurve; 3],
    pub(super) debevec_malik_errors: Option<RatioErrors>,
    /// Our fit, with the exposures taken as the driver says.
    pub(super) nominal_errors: Option<RatioErrors>,
}

/// A response and what can be said about it.
struct Response {
    curves: [ResponseCurve; 3],
    known_codes: Option<[u8; 2]>,
    exposures: Vec<TrueExposure>,
    errors: Option<RatioErrors>,
    rivals: Option<Rivals>,
}

impl Measured {
    /// The camera's entry in the rig; what was not measured stays as it was.
    pub(super) fn photometry(&self, before: Option<&Photometry>) -> Result<Photometry, PhotometricError> {
        let (full_well_e, read_noise_e) = match (&self.noise, before) {
            (Some(noise), _) => (noise.full_well_e, noise.read_noise_e),
            (None, Some(before)) => (before.full_well_e, before.read_noise_e),
            (None, None) => return Err(PhotometricError::NoNoise),
        };
        Ok(Photometry {
            // Any number will do: it fixes the unit of radiance.
            sensitivity: before.map_or(1.0, |before| before.sensitivity),
            vignetting: match (&self.vignetting, before) {
                (Some(vignetting), _) => vignetting.coefficients,
                (None, Some(before)) => before.vignetting,
                (None, None) => [0.0, 0.0],
            },
            full_well_e,
            read_noise_e,
            response: self.curves[1].clone(),
            color: before.map_or(DMat3::IDENTITY, |before| before.color),
        })
    }
}

pub(super) fn measure(args: &Args, series: &Series) -> Result<Measured, CommandError> {
    let black = args.dark.as_deref().map(|folder| dark(folder, series)).transpose()?;
    let response = respond(args, series)?;
    let curves = match &black {
        Some(black) => response.curves.map(|curve| without_black(&curve, black.code)),
        None => response.curves,
    };
    let vignetting = args
        .flat
        .as_deref()
        .map(|folder| flat(folder, series, &curves[1]))
        .transpose()?;
    let latency = args
        .requests
        .as_deref()
        .map(|file| follow(file, series, &curves[1]))
        .transpose()?;
    Ok(Measured {
        noise: sensor_noise(series, &curves[1])?,
        curves,
        known_codes: response.known_codes,
        exposures: response.exposures,
        errors: response.errors,
        rivals: response.rivals,
        vignetting,
        black,
        latency,
    })
}

fn respond(args: &Args, series: &Series) -> Result<Response, PhotometricError> {
    let nominal_s: Vec<f64> = series.settings.iter().map(|setting| setting.product_s()).collect();
    let chosen: Vec<usize> = (0..nominal_s.len())
        .flat_map(|setting| series.pictures_of(setting).take(REPEATS_FOR_RESPONSE))
        .collect();
    let shots: Vec<Shot<'_>> = chosen
        .iter()
        .map(|&picture| Shot {
            codes: &series.codes[picture],
            holes: series.holes_of(picture),
            exposure_s: nominal_s[series.setting_of[picture]],
        })
        .collect();
    let size_px = series.size_px.map(|side| side as usize);
    let channels = match args.response {
        ResponseFrom::Fit => Channels::Shared,
        ResponseFrom::FitChannels => Channels::Separate,
        ResponseFrom::Srgb => return Ok(srgb(&shots, size_px, &nominal_s, &settings_of(series, &chosen))),
    };
    let patches = FlatPatches::new(&shots, size_px).map_err(PhotometricError::Fit)?;
    let fitted = fit_patches(&patches, channels, ExposureTimes::Nominal).map_err(PhotometricError::Fit)?;
    let exact = fit_patches(&patches, channels, ExposureTimes::Exact).map_err(PhotometricError::Fit)?;
    let settings = settings_of(series, &chosen);
    let exposures = linearity::measure(
        &patches,
        &fitted.curves,
        &nominal_s,
        &settings,
        ResponseIs::FittedToThese,
    );
    let debevec_malik = debevec_malik::fit(&shots, size_px);
    Ok(Response {
        errors: errors_with(&patches, &fitted.curves, &exposures, &settings),
        rivals: Some(Rivals {
            debevec_malik_errors: ratio_errors(&patches, &debevec_malik, &patches.channel_exposures_s()),
            debevec_malik,
            nominal_errors: ratio_errors(&patches, &exact.curves, &patches.channel_exposures_s()),
        }),
        curves: fitted.curves,
        known_codes: Some(fitted.known_codes),
        exposures,
    })
}

fn settings_of(series: &Series, pictures: &[usize]) -> Vec<usize> {
    pictures.iter().map(|&picture| series.setting_of[picture]).collect()
}

/// The sRGB curve, and what it says about the exposures if there are several.
fn srgb(shots: &[Shot<'_>], size_px: [usize; 2], nominal_s: &[f64], settings: &[usize]) -> Response {
    let curves = [(); 3].map(|()| ResponseCurve::srgb());
    let unmeasured = |&nominal_s: &f64| TrueExposure {
        nominal_s,
        true_s: nominal_s,
        sigma: None,
    };
    let (exposures, errors) = match FlatPatches::new(shots, size_px) {
        Ok(patches) => {
            let exposures = linearity::measure(&patches, &curves, nominal_s, settings, ResponseIs::Known);
            let errors = errors_with(&patches, &curves, &exposures, settings);
            (exposures, errors)
        }
        // One exposure only: nothing to compare.
        Err(_) => (nominal_s.iter().map(unmeasured).collect(), None),
    };
    Response {
        curves,
        known_codes: None,
        exposures,
        errors,
        rivals: None,
    }
}

/// Ratio errors with the exposures that were found.
fn errors_with(
    patches: &FlatPatches,
    curves: &[ResponseCurve; 3],
    exposures: &[TrueExposure],
    settings: &[usize],
) -> Option<RatioErrors> {
    let found: Vec<[f64; 3]> = settings.iter().map(|&setting| [exposures[setting].true_s; 3]).collect();
    ratio_errors(patches, curves, &found)
}

/// The curve with no light up to the black level.
fn without_black(curve: &ResponseCurve, black_code: f64) -> ResponseCurve {
    let values: Vec<f64> = (0..=255)
        .map(|code| {
            if f64::from(code) <= black_code.round() {
                0.0
            } else {
                curve.linear_from_code(code)
            }
        })
        .collect();
    ResponseCurve::from_table(&values).expect("black is at most code 64, and the curve rises above it")
}

fn dark(folder: &std::path::Path, series: &Series) -> Result<BlackLevel, CommandError> {
    let pictures = read_folder(folder, series.size_px)?;
    let codes: Vec<&[u8]> = pictures.iter().map(|(_, codes)| codes.as_slice()).collect();
    let names = || names(&pictures);
    Ok(black::measure(&codes).map_err(|source| PhotometricError::BlackLevel { names: names(), source })?)
}

fn flat(folder: &std::path::Path, series: &Series, response: &ResponseCurve) -> Result<Vignetting, CommandError> {
    let pictures = read_folder(folder, series.size_px)?;
    let size_px = series.size_px.map(|side| side as usize);
    let flats: Vec<FlatPicture<'_>> = pictures
        .iter()
        .map(|(_, codes)| FlatPicture { codes, size_px })
        .collect();
    let names = || names(&pictures);
    Ok(vignetting::measure(&flats, response)
        .map_err(|source| PhotometricError::Vignetting { names: names(), source })?)
}

fn names(pictures: &[(String, Vec<u8>)]) -> String {
    let names: Vec<&str> = pictures.iter().map(|(name, _)| name.as_str()).collect();
    names.join(", ")
}

fn sensor_noise(series: &Series, response: &ResponseCurve) -> Result<Option<SensorNoise>, PhotometricError> {
    let seen: Vec<Vec<Cow<'_, [u8]>>> = (0..series.settings.len())
        .map(|setting| series.seen(&series.pictures_of(setting).collect::<Vec<_>>()))
        .collect();
    let settings: Vec<Repeats<'_>> = series
        .settings
        .iter()
        .zip(&seen)
        .map(|(setting, seen)| Repeats {
            pictures: seen.iter().map(AsRef::as_ref).collect(),
            gain: series.white_balance.map(|white_balance| white_balance * setting.gain),
        })
        .filter(|repeats| repeats.pictures.len() > 1)
        .collect();
    if settings.is_empty() {
        return Ok(None);
    }
    noise::measure(&settings, response)
        .map(Some)
        .map_err(PhotometricError::Noise)
}

fn follow(file: &std::path::Path, series: &Series, response: &ResponseCurve) -> Result<ControlLatency, CommandError> {
    let mut requests: Vec<Request> = read_csv::<RequestLine>(file)?
        .into_iter()
        .map(|line| Request {
            frame: line.frame,
            exposure_s: line.exposure_s * line.gain,
        })
        .collect();
    requests.sort_by_key(|request| request.frame);
    let level = |(picture, &frame): (usize, &u64)| {
        let code = code_at(&series.seen(&[picture])[0], LEVEL_SHARE);
        Level {
            frame,
            signal: response.linear_from_code(code).max(1e-6),
        }
    };
    let mut levels: Vec<Level> = series.frames.iter().enumerate().map(level).collect();
    levels.sort_by_key(|level| level.frame);
    Ok(latency::measure(&requests, &levels).map_err(PhotometricError::Latency)?)
}

/// The code that this share of the values lies below.
fn code_at(codes: &[u8], share: f64) -> u8 {
    let mut counts = [0usize; 256];
    for &code in codes {
        counts[usize::from(code)] += 1;
    }
    let wanted = share * codes.len() as f64;
    let mut below = 0;
    let at = counts.iter().position(|count| {
        below += count;
        below as f64 > wanted
    });
    at.unwrap_or(255) as u8
}
