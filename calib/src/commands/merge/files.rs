//! What `merge` writes, and the response file that it reads.

use std::{
    fs,
    io::{BufWriter, Write},
    path::Path,
};

use image::{Rgb, RgbImage};
use mirrorball_calib::{
    merge::stack::MergedPicture,
    merge::{State, stack::Origin},
    probe::radiance::luminance,
    response::ResponseCurve,
};
use serde::Deserialize;

use super::{MergeError, Response, Series};

/// Colours of the map: clipped everywhere, something has moved, seen by nobody.
const CLIPPED: [u8; 3] = [255, 40, 40];
const MOVED: [u8; 3] = [255, 0, 255];
const UNSEEN: [u8; 3] = [0, 0, 0];

/// Grey that the picture's mean is shown as (Reinhard et al. 2002, eq. 2).
const KEY: f32 = 0.18;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponseFile {
    response: Option<Vec<f64>>,
    response_red: Option<Vec<f64>>,
    response_green: Option<Vec<f64>>,
    response_blue: Option<Vec<f64>>,
}

/// Reads `response.toml`.
pub(super) fn read_response(file: &Path) -> Result<[ResponseCurve; 3], MergeError> {
    let text = fs::read_to_string(file).map_err(|source| MergeError::Read {
        file: file.to_owned(),
        source,
    })?;
    let not_a_response = |message: String| MergeError::ResponseFile {
        file: file.to_owned(),
        message,
    };
    let found: ResponseFile = toml::from_str(&text).map_err(|error| not_a_response(error.to_string()))?;
    let curve = |key: &'static str, values: &[f64]| {
        ResponseCurve::from_table(values).map_err(|source| MergeError::ResponseCurve {
            file: file.to_owned(),
            key,
            source,
        })
    };
    match (
        found.response,
        found.response_red,
        found.response_green,
        found.response_blue,
    ) {
        (Some(values), None, None, None) => {
            let curve = curve("response", &values)?;
            Ok([curve.clone(), curve.clone(), curve])
        }
        (None, Some(red), Some(green), Some(blue)) => Ok([
            curve("response_red", &red)?,
            curve("response_green", &green)?,
            curve("response_blue", &blue)?,
        ]),
        _ => Err(not_a_response(
            "it has neither `response` alone nor `response_red`, `response_green` and `response_blue`".to_owned(),
        )),
    }
}

/// Writes everything into a folder, which is made.
pub(super) fn write(
    folder: &Path,
    series: &Series,
    response: &Response,
    merged: &MergedPicture,
) -> Result<(), MergeError> {
    fs::create_dir_all(folder).map_err(|error| write_error(folder, error))?;
    let file = |name: &str| folder.join(name);
    write_exr(&file("merged.exr"), merged, series.size_px)?;
    write_hdr(&file("merged.hdr"), merged, series.size_px)?;
    let png = file("merged.png");
    picture(series, merged)
        .save(&png)
        .map_err(|error| write_error(&png, error))?;
    let toml = file("response.toml");
    fs::write(&toml, response_toml(response)).map_err(|error| write_error(&toml, error))
}

fn write_error(file: &Path, source: impl std::error::Error + Send + Sync + 'static) -> MergeError {
    MergeError::Write {
        file: file.to_owned(),
        source: Box::new(source),
    }
}

fn write_exr(file: &Path, merged: &MergedPicture, [width, height]: [usize; 2]) -> Result<(), MergeError> {
    let pixel = |x: usize, y: usize| <(f32, f32, f32)>::from(merged.radiance[y * width + x]);
    exr::prelude::write_rgb_file(file, width, height, pixel).map_err(|error| write_error(file, error))
}

/// Radiance's own format, not compressed: a shared exponent per pixel (Ward 1991, "Real pixels").
fn write_hdr(file: &Path, merged: &MergedPicture, [width, height]: [usize; 2]) -> Result<(), MergeError> {
    let write = || {
        let mut out = BufWriter::new(fs::File::create(file)?);
        write!(out, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n")?;
        for &radiance in &merged.radiance {
            out.write_all(&rgbe(radiance))?;
        }
        out.flush()
    };
    write().map_err(|error: std::io::Error| write_error(file, error))
}

fn rgbe(rgb: [f32; 3]) -> [u8; 4] {
    let largest = rgb.into_iter().fold(0.0, f32::max);
    // Smaller numbers have no exponent there.
    if !(largest.is_finite() && largest > 1e-32) {
        return [0; 4];
    }
    let exponent = (largest.log2().floor() as i32 + 1).min(127);
    let scale = 2f32.powi(8 - exponent);
    let [r, g, b] = rgb.map(|value| (value.max(0.0) * scale).min(255.0) as u8);
    [r, g, b, (exponent + 128) as u8]
}

/// The merged picture as it would be looked at, and beside it where it comes from.
fn picture(series: &Series, merged: &MergedPicture) -> RgbImage {
    let [width, height] = series.size_px.map(|side| side as u32);
    let seen = || {
        merged
            .radiance
            .iter()
            .map(|&rgb| luminance(rgb.into()))
            .filter(|&l| l > 0.0)
    };
    let n = seen().count().max(1) as f32;
    let log_mean = seen().map(f32::ln).sum::<f32>() / n;
    let exposure = KEY / log_mean.exp();
    let colors = map_colors(&series.exposures_s);
    RgbImage::from_fn(2 * width, height, |x, y| {
        let at = (y * width + x % width) as usize;
        Rgb(if x < width {
            tone_mapped(merged.radiance[at], exposure)
        } else {
            map_color(&merged.origin[at], &colors)
        })
    })
}

/// Reinhard et al. 2002, "Photographic tone reproduction for digital images", eq. 3, of the luminance.
fn tone_mapped(radiance: [f32; 3], exposure: f32) -> [u8; 3] {
    let scaled = exposure * luminance(radiance.into()).max(0.0);
    let factor = exposure / (1.0 + scaled);
    let srgb = ResponseCurve::srgb();
    radiance.map(|value| srgb.encode(f64::from(value * factor)))
}

/// A colour per picture: from yellow for the shortest exposure to blue for the longest.
fn map_colors(exposures_s: &[f64]) -> Vec<[u8; 3]> {
    let logs = || exposures_s.iter().map(|time| time.ln());
    let (low, high) = (logs().fold(f64::MAX, f64::min), logs().fold(f64::MIN, f64::max));
    logs()
        .map(|log| {
            let t = (log - low) / (high - low).max(1e-9);
            let mix = |a: f64, b: f64| (a + (b - a) * t) as u8;
            [mix(255.0, 20.0), mix(230.0, 60.0), mix(60.0, 160.0)]
        })
        .collect()
}

fn map_color(origin: &Origin, colors: &[[u8; 3]]) -> [u8; 3] {
    match origin.picture {
        None => UNSEEN,
        Some(_) if origin.has_moved => MOVED,
        Some(_) if origin.states.contains(&State::AtLeast) => CLIPPED,
        Some(picture) => colors[usize::from(picture)],
    }
}

/// The curve as a rig file wants it, or three of them.
fn response_toml(response: &Response) -> String {
    let mut text = format!(
        "# Linear signal of every code; found by `mirrorball-calib merge --response {}`.\n",
        response.source
    );
    let [red, green, blue] = &response.curves;
    if red == green && green == blue {
        text += "# For `[camera.photometry]` of a rig file.\n";
        text += &list("response", red);
    } else {
        text += "# A rig file has one curve for all channels: merge with `--response fit` to get one.\n";
        for (key, curve) in [
            ("response_red", red),
            ("response_green", green),
            ("response_blue", blue),
        ] {
            text += &list(key, curve);
        }
    }
    text
}

fn list(key: &str, curve: &ResponseCurve) -> String {
    let values: Vec<String> = (0..=255)
        .map(|code| format!("{:.9}", curve.linear_from_code(code)))
        .collect();
    let lines: Vec<String> = values
        .chunks(8)
        .map(|line| format!("  {},\n", line.join(", ")))
        .collect();
    format!("{key} = [\n{}]\n", lines.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rgbe_keeps_radiance_to_half_a_percent_of_the_brightest_channel() {
        for radiance in [
            [1.0, 0.5, 0.25],
            [1e-3, 2e-3, 1e-3],
            [4096.0, 8191.0, 5000.0],
            [1.0, 1.0, 1.0],
        ] {
            let [r, g, b, e] = rgbe(radiance);
            let scale = 2f32.powi(i32::from(e) - 128 - 8);
            let largest = radiance.into_iter().fold(0.0, f32::max);
            for (code, value) in [r, g, b].into_iter().zip(radiance) {
                let error = (f32::from(code) + 0.5) * scale - value;
                assert!(error.abs() < 0.005 * largest, "{radiance:?}");
            }
        }
        assert_eq!(rgbe([0.0; 3]), [0; 4]);
        assert_eq!(rgbe([f32::NAN, -1.0, 0.0]), [0; 4]);
    }
}
