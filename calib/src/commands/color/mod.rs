//! `color`: the matrix between two cameras' colours.

mod error;
mod read;
mod report;

use std::{fs, io::Write, path::PathBuf};

use glam::DVec2;
use mirrorball_calib::{
    color::{
        matching::{self, ColorMatch},
        patches::PatchSheet,
    },
    rig::RigDraft,
};

use super::{CommandError, no_camera, output::OutputArgs, read_rig};
pub(crate) use error::ColorError;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The rig: its cameras' response, vignetting and lens must be known.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Recording in which both cameras see the patches, under the same light.
    #[arg(long, value_name = "PATH")]
    recording: PathBuf,
    /// The camera whose colours are taken, and the one that is matched to it.
    #[arg(long, value_name = "A,B", value_delimiter = ',', required = true, num_args = 1)]
    cameras: Vec<String>,
    /// Patches: a TOML file, or `colorchecker` for the ColorChecker Classic.
    #[arg(long, value_name = "FILE")]
    patches: PathBuf,
    /// Where the sheet's corners are in a camera's pictures, when no marker says so: bottom-left, bottom-right, top-right,
    /// top-left of the upright sheet, in pixels. May be given for every camera.
    #[arg(long, value_name = "CAMERA=X,Y,X,Y,X,Y,X,Y", value_parser = corners)]
    chart_corners: Vec<ChartCorners>,
    /// Patch whose colour is to be met exactly: white, say.
    #[arg(long, value_name = "PATCH")]
    keep: Option<String>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Corners of the sheet in a camera's pictures.
#[derive(Debug, Clone)]
struct ChartCorners {
    camera: String,
    pixels: [DVec2; 4],
}

fn corners(text: &str) -> Result<ChartCorners, String> {
    let parse = || {
        let (camera, numbers) = text.split_once('=')?;
        let numbers: Vec<f64> = numbers
            .split(',')
            .map(|number| number.trim().parse().ok())
            .collect::<Option<_>>()?;
        let numbers: [f64; 8] = numbers.try_into().ok()?;
        Some(ChartCorners {
            camera: camera.to_owned(),
            pixels: [0, 2, 4, 6].map(|i| DVec2::new(numbers[i], numbers[i + 1])),
        })
    };
    parse().ok_or_else(|| "a camera's name, `=`, and eight numbers separated by commas".to_owned())
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    let rig = read_rig(&args.rig)?;
    let camera = |index: usize| {
        let name = args.cameras.get(index).map_or("", String::as_str);
        rig.camera(name).ok_or_else(|| no_camera(&rig, &args.rig, name))
    };
    let cameras = [camera(0)?, camera(1)?];
    let sheet = read_sheet(args)?;
    let found = read::read(args, &rig, &sheet, cameras)?;
    let matched = matching::match_cameras(&found.shared, args.keep.as_deref()).map_err(|source| ColorError::Match {
        first: cameras[0].name.clone(),
        second: cameras[1].name.clone(),
        left_out: found.left_out_text(),
        source,
    })?;
    write_rig(args, &matched, cameras[0].photometry.color, &cameras[1].name)?;
    args.output
        .write_json(&report::Numbers::new(&args.cameras, &matched, &found))?;
    args.output
        .write_report(|| report::page(&args.cameras, &matched, &found))?;
    report::write_summary(out, &args.cameras, &matched, &found).map_err(CommandError::Output)
}

fn read_sheet(args: &Args) -> Result<PatchSheet, ColorError> {
    if args.patches.as_os_str() == "colorchecker" {
        return Ok(PatchSheet::color_checker());
    }
    let file = args.patches.clone();
    let text = fs::read_to_string(&file).map_err(|source| ColorError::Read {
        file: file.clone(),
        source,
    })?;
    PatchSheet::from_toml(&text).map_err(|source| ColorError::Sheet { file, source })
}

/// Writes the second camera's matrix: into `--out` if it is there, else into a copy of the rig.
fn write_rig(
    args: &Args,
    matched: &ColorMatch,
    common_from_first: glam::DMat3,
    second: &str,
) -> Result<(), CommandError> {
    let Some(out) = &args.output.out else { return Ok(()) };
    let start = if out.exists() { out } else { &args.rig };
    let mut draft: RigDraft = super::output::draft(start)?;
    draft.set_color(second, &(common_from_first * matched.first_from_second));
    args.output.write_rig(&draft)?;
    Ok(())
}
