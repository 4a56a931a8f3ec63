//! What `photometric` says: a summary, the numbers, a page.

use std::io::{self, Write};

use mirrorball_calib::{
    report::{
        Block, Plot, Report,
        plot::{Axis, Series as Points, Style},
    },
    response::ResponseCurve,
    response_fit::RatioErrors,
};
use serde::Serialize;

use super::{Measured, series::Series};

/// The numbers as JSON.
#[derive(Serialize)]
pub(super) struct Numbers {
    routine: &'static str,
    /// Linear signal of every code, of one curve, or of red, green and blue.
    response: Vec<Vec<f64>>,
    known_codes: Option<[u8; 2]>,
    vignetting: Option<[f64; 2]>,
    vignetting_corner_sigma: Option<f64>,
    full_well_e: Option<f64>,
    full_well_sigma_e: Option<f64>,
    read_noise_e: Option<f64>,
    noise_misfit: Option<f64>,
    black_code: Option<f64>,
    exposures: Vec<Exposure>,
    exposures_without_picture: Vec<String>,
    latency_frames: Option<usize>,
    latency_of_changes: Option<Vec<usize>>,
    ratio_errors: Option<Errors>,
    ratio_errors_nominal_exposures: Option<Errors>,
    ratio_errors_debevec_malik: Option<Errors>,
}

#[derive(Serialize)]
struct Exposure {
    nominal_s: f64,
    gain: f64,
    true_s: f64,
    sigma: Option<f64>,
    pictures: Vec<String>,
}

#[derive(Serialize)]
struct Errors {
    median: f64,
    worst: f64,
    worst_pictures: [usize; 2],
    worst_channel: usize,
    pairs: usize,
    patches: usize,
}

impl Errors {
    fn new(errors: &RatioErrors) -> Self {
        Self {
            median: errors.pair_median,
            worst: errors.worst.error.abs(),
            worst_pictures: errors.worst.pictures,
            worst_channel: errors.worst.channel,
            pairs: errors.pairs,
            patches: errors.patches,
        }
    }
}

impl Numbers {
    pub(super) fn new(series: &Series, measured: &Measured) -> Self {
        let rivals = measured.rivals.as_ref();
        let noise = measured.noise.as_ref();
        let vignetting = measured.vignetting.as_ref();
        let table = |curve: &ResponseCurve| (0..=255).map(|code| curve.linear_from_code(code)).collect();
        let settings = series.settings.iter().zip(&measured.exposures).enumerate();
        let exposures = settings.map(|(index, (setting, found))| Exposure {
            nominal_s: setting.exposure_s,
            gain: setting.gain,
            true_s: found.true_s / setting.gain,
            sigma: found.sigma,
            pictures: series
                .pictures_of(index)
                .map(|picture| series.names[picture].clone())
                .collect(),
        });
        Self {
            routine: "photometric",
            response: curves(measured).iter().map(|(_, curve)| table(curve)).collect(),
            known_codes: measured.known_codes,
            vignetting: vignetting.map(|found| found.coefficients),
            vignetting_corner_sigma: vignetting.map(|found| found.corner_sigma),
            full_well_e: noise.map(|found| found.full_well_e),
            full_well_sigma_e: noise.map(|found| found.full_well_sigma_e),
            read_noise_e: noise.map(|found| found.read_noise_e),
            noise_misfit: noise.map(|found| found.misfit),
            black_code: measured.black.map(|black| black.code),
            exposures: exposures.collect(),
            exposures_without_picture: series.unused.clone(),
            latency_frames: measured.latency.as_ref().map(|latency| latency.frames),
            latency_of_changes: measured.latency.as_ref().map(|latency| latency.of_changes.clone()),
            ratio_errors: measured.errors.as_ref().map(Errors::new),
            ratio_errors_nominal_exposures: rivals
                .and_then(|rivals| rivals.nominal_errors.as_ref())
                .map(Errors::new),
            ratio_errors_debevec_malik: rivals
                .and_then(|rivals| rivals.debevec_malik_errors.as_ref())
                .map(Errors::new),
        }
    }
}

/// The curve, or those of red, green and blue where they differ.
fn curves(measured: &Measured) -> Vec<(&'static str, &ResponseCurve)> {
    let [red, green, blue] = &measured.curves;
    if red == green && green == blue {
        vec![("response", green)]
    } else {
        vec![("red", red), ("green", green), ("blue", blue)]
    }
}

/// What should not be so.
fn warning(series: &Series) -> Option<String> {
    let files: Vec<String> = series.unused.iter().map(|file| format!("`{file}`")).collect();
    let list = files.join(", ");
    (!files.is_empty()).then(|| format!("listed with an exposure, but not among the pictures: {list}"))
}

/// Lines for a person at a terminal.
pub(super) fn write_summary(out: &mut impl Write, series: &Series, measured: &Measured) -> io::Result<()> {
    writeln!(
        out,
        "{} pictures, {} exposure settings",
        series.names.len(),
        series.settings.len()
    )?;
    if let Some(errors) = &measured.errors {
        writeln!(
            out,
            "exposure-ratio error: median {:.2} %, worst {:.1} %",
            100.0 * errors.pair_median,
            100.0 * errors.worst.error.abs(),
        )?;
    }
    if let Some(errors) = measured
        .rivals
        .as_ref()
        .and_then(|rivals| rivals.debevec_malik_errors.as_ref())
    {
        let (median, worst) = (100.0 * errors.pair_median, 100.0 * errors.worst.error.abs());
        writeln!(
            out,
            "  Debevec and Malik's response: median {median:.2} %, worst {worst:.1} %"
        )?;
    }
    match &measured.noise {
        Some(noise) => writeln!(
            out,
            "full well {:.0} ± {:.0} electrons, read noise {:.1} electrons",
            noise.full_well_e, noise.full_well_sigma_e, noise.read_noise_e
        )?,
        None => writeln!(out, "noise not measured: no exposure was taken twice")?,
    }
    if let Some(vignetting) = &measured.vignetting {
        let [v1, v2] = vignetting.coefficients;
        let sigma = vignetting.corner_sigma;
        writeln!(out, "vignetting [{v1:.4}, {v2:.4}], in the corner ± {sigma:.4}")?;
    }
    if let Some(black) = &measured.black {
        writeln!(out, "black level: code {:.2}", black.code)?;
    }
    if let Some(latency) = &measured.latency {
        writeln!(out, "control latency: {} frames", latency.frames)?;
    }
    if let Some(warning) = warning(series) {
        writeln!(out, "warning: {warning}")?;
    }
    Ok(())
}

/// The page.
pub(super) fn page(camera: &str, series: &Series, measured: &Measured) -> Report {
    let mut report = Report::new(format!("Photometry of camera {camera}"));
    if let Some(warning) = warning(series) {
        report.push(Block::Warning(format!("{warning}.")));
    }
    report.push(response_block(measured));
    if let (Some(errors), Some(rivals)) = (&measured.errors, &measured.rivals) {
        let row = |name: &str, errors: Option<&RatioErrors>| {
            let number = |value: fn(&RatioErrors) -> f64| {
                errors.map_or_else(|| "–".to_owned(), |errors| format!("{:.2}", 100.0 * value(errors)))
            };
            vec![
                name.to_owned(),
                number(|errors| errors.pair_median),
                number(|errors| errors.worst.error.abs()),
            ]
        };
        report.push(Block::Table {
            caption: "Exposure-ratio error over pairs of pictures and channels, per cent".to_owned(),
            head: ["response", "median", "worst"].map(str::to_owned).to_vec(),
            rows: vec![
                row("ours, exposures corrected", Some(errors)),
                row("ours, exposures as the driver says", rivals.nominal_errors.as_ref()),
                row("Debevec and Malik", rivals.debevec_malik_errors.as_ref()),
            ],
        });
    }
    exposure_blocks(&mut report, series, measured);
    match &measured.noise {
        Some(noise) => {
            report.push(noise_block(noise));
        }
        None => {
            report.push(Block::Warning(
                "Noise was not measured: take every exposure two or three times.".to_owned(),
            ));
        }
    }
    if let Some(vignetting) = &measured.vignetting {
        report.push(vignetting_block(vignetting));
    }
    if let Some(black) = &measured.black {
        report.push(Block::Text(format!("Black level: code {:.2}.", black.code)));
    }
    if let Some(latency) = &measured.latency {
        report.push(Block::Text(format!(
            "A change of exposure shows after {} frames; single changes: {:?}.",
            latency.frames, latency.of_changes
        )));
    }
    report
}

fn line(name: &str, curve: &ResponseCurve, style: Style) -> Points {
    Points {
        name: name.to_owned(),
        points: (0..=255)
            .map(|code| [curve.linear_from_code(code), f64::from(code)])
            .filter(|point| point[0] > 0.0)
            .collect(),
        style,
    }
}

fn response_block(measured: &Measured) -> Block {
    let mut series: Vec<Points> = curves(measured)
        .into_iter()
        .map(|(name, curve)| line(name, curve, Style::Line))
        .collect();
    if let Some(rivals) = &measured.rivals {
        series.push(line(
            "Debevec and Malik, green",
            &rivals.debevec_malik[1],
            Style::Dashed,
        ));
    }
    Block::Plot {
        caption: "Response: code over linear signal. It should be smooth; a staircase is noise.".to_owned(),
        plot: Plot::Chart {
            x: Axis::logarithmic("linear signal"),
            y: Axis::linear("code"),
            series,
        },
    }
}

fn exposure_blocks(report: &mut Report, series: &Series, measured: &Measured) {
    let rows = series.settings.iter().zip(&measured.exposures).map(|(setting, found)| {
        vec![
            format!("{:.6}", setting.exposure_s),
            format!("{:.3}", setting.gain),
            format!("{:.6}", found.true_s / setting.gain),
            found
                .sigma
                .map_or_else(|| "–".to_owned(), |sigma| format!("{:.2}", 100.0 * sigma)),
        ]
    });
    report.push(Block::Table {
        caption: "Exposure settings".to_owned(),
        head: ["nominal s", "gain", "true s", "σ %"].map(str::to_owned).to_vec(),
        rows: rows.collect(),
    });
    let ratios = measured.exposures.iter().filter(|found| found.sigma.is_some());
    report.push(Block::Plot {
        caption: "Linearity: true over nominal exposure. Points on a level line: the driver says the truth.".to_owned(),
        plot: Plot::Chart {
            x: Axis::logarithmic("nominal exposure times gain, s"),
            y: Axis::linear("true / nominal"),
            series: vec![Points {
                name: "settings".to_owned(),
                points: ratios
                    .map(|found| [found.nominal_s, found.true_s / found.nominal_s])
                    .collect(),
                style: Style::Dots,
            }],
        },
    });
}

fn noise_block(noise: &mirrorball_calib::photometric::noise::SensorNoise) -> Block {
    let mut model: Vec<[f64; 2]> = noise
        .points
        .iter()
        .map(|point| {
            let read = (noise.read_noise_e / noise.full_well_e).powi(2);
            [point.signal, point.signal / noise.full_well_e + read]
        })
        .collect();
    model.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Block::Plot {
        caption: format!(
            "Photon transfer: full well {:.0} ± {:.0} electrons, read noise {:.1} electrons.",
            noise.full_well_e, noise.full_well_sigma_e, noise.read_noise_e
        ),
        plot: Plot::Chart {
            x: Axis::logarithmic("linear signal / gain"),
            y: Axis::logarithmic("variance"),
            series: vec![
                Points {
                    name: "measured".to_owned(),
                    points: noise
                        .points
                        .iter()
                        .map(|point| [point.signal, point.variance])
                        .collect(),
                    style: Style::Dots,
                },
                Points {
                    name: "model".to_owned(),
                    points: model,
                    style: Style::Line,
                },
            ],
        },
    }
}

fn vignetting_block(found: &mirrorball_calib::photometric::vignetting::Vignetting) -> Block {
    let [v1, v2] = found.coefficients;
    let model = (0..=50).map(|step| f64::from(step) / 50.0);
    Block::Plot {
        caption: format!(
            "Vignetting [{v1:.4}, {v2:.4}]; light taken out that changes by a factor of up to {:.2} over the picture.",
            found.unevenness
        ),
        plot: Plot::Chart {
            x: Axis::linear("distance from the middle, half diagonals"),
            y: Axis::linear("fraction of the light"),
            series: vec![
                Points {
                    name: "cells".to_owned(),
                    points: found.profile.clone(),
                    style: Style::Dots,
                },
                Points {
                    name: "model".to_owned(),
                    points: model.map(|r| [r, 1.0 + r * r * (v1 + r * r * v2)]).collect(),
                    style: Style::Line,
                },
            ],
        },
    }
}
