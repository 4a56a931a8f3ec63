//! What `color` says: a summary, the numbers, a page.

use std::io::{self, Write};

use mirrorball_calib::{
    color::matching::{ColorMatch, PatchMatch, Residuals},
    report::{Block, Plot, Report},
};
use serde::Serialize;

use super::read::Found;

/// The numbers as JSON.
#[derive(Serialize)]
pub(super) struct Numbers {
    routine: &'static str,
    cameras: Vec<String>,
    pictures: [usize; 2],
    first_from_second: [[f64; 3]; 3],
    gain: f64,
    before: Left,
    after: Left,
    patches: Vec<PatchNumbers>,
    left_out: Vec<LeftOut>,
}

#[derive(Serialize)]
struct Left {
    relative_mean: f64,
    relative_worst: f64,
    delta_e00_mean: f64,
    delta_e00_worst: f64,
}

#[derive(Serialize)]
struct PatchNumbers {
    name: String,
    first: [f64; 3],
    before: [f64; 3],
    after: [f64; 3],
    relative_error: f64,
    delta_e00_before: f64,
    delta_e00_after: f64,
    delta_e00_reference_first: Option<f64>,
    delta_e00_reference_second: Option<f64>,
}

#[derive(Serialize)]
struct LeftOut {
    camera: String,
    patch: String,
    reason: String,
}

impl From<&Residuals> for Left {
    fn from(residuals: &Residuals) -> Self {
        Self {
            relative_mean: residuals.relative_mean,
            relative_worst: residuals.relative_worst,
            delta_e00_mean: residuals.delta_e_mean,
            delta_e00_worst: residuals.delta_e_worst,
        }
    }
}

impl From<&PatchMatch> for PatchNumbers {
    fn from(patch: &PatchMatch) -> Self {
        Self {
            name: patch.name.clone(),
            first: patch.first,
            before: patch.before,
            after: patch.after,
            relative_error: patch.relative_error,
            delta_e00_before: patch.delta_e[0],
            delta_e00_after: patch.delta_e[1],
            delta_e00_reference_first: patch.delta_e_reference.map(|both| both[0]),
            delta_e00_reference_second: patch.delta_e_reference.map(|both| both[1]),
        }
    }
}

impl Numbers {
    pub(super) fn new(cameras: &[String], matched: &ColorMatch, found: &Found) -> Self {
        let matrix = matched.first_from_second;
        let left_out = found.left_out.iter().map(|(camera, patch, reason)| LeftOut {
            camera: camera.clone(),
            patch: patch.clone(),
            reason: reason.clone(),
        });
        Self {
            routine: "color",
            cameras: cameras.to_vec(),
            pictures: found.pictures,
            first_from_second: [0, 1, 2].map(|row| matrix.row(row).to_array()),
            gain: matched.gain,
            before: (&matched.before).into(),
            after: (&matched.after).into(),
            patches: matched.patches.iter().map(PatchNumbers::from).collect(),
            left_out: left_out.collect(),
        }
    }
}

/// Lines for a person at a terminal.
pub(super) fn write_summary(
    out: &mut impl Write,
    cameras: &[String],
    matched: &ColorMatch,
    found: &Found,
) -> io::Result<()> {
    writeln!(
        out,
        "{} patches common to `{}` ({} pictures) and `{}` ({} pictures)",
        matched.patches.len(),
        cameras[0],
        found.pictures[0],
        cameras[1],
        found.pictures[1]
    )?;
    for (name, left) in [("one gain", &matched.before), ("matrix", &matched.after)] {
        writeln!(
            out,
            "{name:>8}: error mean {:.2} %, worst {:.1} %; ΔE00 mean {:.2}, worst {:.2}",
            100.0 * left.relative_mean,
            100.0 * left.relative_worst,
            left.delta_e_mean,
            left.delta_e_worst
        )?;
    }
    for row in 0..3 {
        let [r, g, b] = matched.first_from_second.row(row).to_array();
        writeln!(out, "  {r:9.5} {g:9.5} {b:9.5}")?;
    }
    if !found.left_out.is_empty() {
        writeln!(out, "left out: {}", found.left_out_text())?;
    }
    Ok(())
}

/// The page.
pub(super) fn page(cameras: &[String], matched: &ColorMatch, found: &Found) -> Report {
    let (first, second) = (&cameras[0], &cameras[1]);
    let mut report = Report::new(format!("Colour of camera {second}, matched to camera {first}"));
    let white = matched
        .patches
        .iter()
        .flat_map(|patch| patch.first)
        .fold(1e-12, f64::max);
    let shown = |rgb: [f64; 3]| rgb.map(|value| encode(value / white));
    report.push(Block::Plot {
        caption: "Patches. After matching, the first and the last column should look alike.".to_owned(),
        plot: Plot::Patches {
            columns: vec![
                first.clone(),
                format!("{second}, one gain"),
                format!("{second}, matched"),
            ],
            rows: matched
                .patches
                .iter()
                .map(|patch| {
                    let colors = vec![shown(patch.first), shown(patch.before), shown(patch.after)];
                    (patch.name.clone(), colors)
                })
                .collect(),
        },
    });
    let row = |name: &str, left: &Residuals| {
        vec![
            name.to_owned(),
            format!("{:.2}", 100.0 * left.relative_mean),
            format!("{:.2}", 100.0 * left.relative_worst),
            format!("{:.2}", left.delta_e_mean),
            format!("{:.2}", left.delta_e_worst),
        ]
    };
    report.push(Block::Table {
        caption: "Difference between the cameras over all patches".to_owned(),
        head: ["", "mean %", "worst %", "ΔE00 mean", "ΔE00 worst"]
            .map(str::to_owned)
            .to_vec(),
        rows: vec![row("one gain", &matched.before), row("matrix", &matched.after)],
    });
    report.push(Block::Table {
        caption: "Patches".to_owned(),
        head: ["patch", "error %", "ΔE00 before", "ΔE00 after", "ΔE00 to the reference"]
            .map(str::to_owned)
            .to_vec(),
        rows: matched
            .patches
            .iter()
            .map(|patch| {
                vec![
                    patch.name.clone(),
                    format!("{:.2}", 100.0 * patch.relative_error),
                    format!("{:.2}", patch.delta_e[0]),
                    format!("{:.2}", patch.delta_e[1]),
                    patch
                        .delta_e_reference
                        .map_or_else(|| "–".to_owned(), |both| format!("{:.2}", both[1])),
                ]
            })
            .collect(),
    });
    if !found.left_out.is_empty() {
        report.push(Block::Warning(format!("Left out: {}.", found.left_out_text())));
    }
    report
}

/// sRGB (IEC 61966-2-1) of 0 to 1; what is outside is cut.
fn encode(linear: f64) -> f64 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}
