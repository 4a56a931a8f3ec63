//! `color`: the matrix between two cameras' colours, the table of their white balances, and the sheet to print for both.

mod error;
mod read;
mod report;
mod white_balance;

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

use glam::DVec2;
use mirrorball_calib::{
    color::{
        matching::{self, ColorMatch},
        patches::PatchSheet,
        print,
    },
    rig::{Camera, Rig, RigDraft},
};

use super::{CommandError, no_camera, output::OutputArgs, read_rig};
pub(crate) use error::ColorError;

/// Name of the built-in chart.
const COLOR_CHECKER: &str = "colorchecker";

/// Largest mean relative error after matching: the most different sensors leave 3 %, surfaces that are not the same far more.
const MAX_ERROR: f64 = 0.15;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The rig: its cameras' response, vignetting and lens must be known.
    #[arg(long, value_name = "FILE", required_unless_present = "print_sheet")]
    rig: Option<PathBuf>,
    /// Recording in which both cameras see the patches, under the same light.
    #[arg(long, value_name = "PATH", required_unless_present = "print_sheet")]
    recording: Option<PathBuf>,
    /// The camera whose colours are taken, and the one that is matched to it.
    #[arg(
        long,
        value_name = "A,B",
        value_delimiter = ',',
        num_args = 1,
        required_unless_present = "print_sheet"
    )]
    cameras: Vec<String>,
    /// Patches: a TOML file, `colorchecker` for the ColorChecker Classic, or `sheet` for the sheet of `--print-sheet`.
    #[arg(long, value_name = "FILE", required_unless_present = "print_sheet")]
    patches: Option<PathBuf>,
    /// Where the sheet's corners are in a camera's pictures, when no marker says so: bottom-left, bottom-right, top-right,
    /// top-left of the upright sheet, in pixels; of a ColorChecker, the outer corners of its corner patches. May be given for
    /// every camera.
    #[arg(long, value_name = "CAMERA=X,Y,X,Y,X,Y,X,Y", value_parser = corners)]
    chart_corners: Vec<ChartCorners>,
    /// Patch whose colour is to be met exactly: white, say.
    #[arg(long, value_name = "PATCH")]
    keep: Option<String>,
    /// Tells, instead of the matrix, which white-balance setting of the second camera goes with which of the first. The recording
    /// shows the sheet's neutral patches at several settings.
    #[arg(long, conflicts_with_all = ["keep", "out"])]
    white_balance: bool,
    /// What the drivers were set to: a table with the columns `camera`, `frame` (its sequence number) and `setting` (kelvin, say).
    /// Without it, a setting is the gain of red over that of blue that the recording tells.
    #[arg(long, value_name = "FILE.csv", requires = "white_balance")]
    settings: Option<PathBuf>,
    /// Writes a sheet of patches to print on A4, and does nothing else.
    #[arg(long, value_name = "FILE.svg", conflicts_with_all = ["rig", "recording", "cameras", "patches"])]
    print_sheet: Option<PathBuf>,
    /// Id of the marker on the printed sheet: one that nothing else in the room carries.
    #[arg(long, value_name = "ID")]
    marker: Option<u32>,
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

/// What is to be measured.
struct Task<'a> {
    args: &'a Args,
    rig_file: &'a Path,
    recording: &'a Path,
    rig: Rig,
    sheet: PatchSheet,
}

impl<'a> Task<'a> {
    fn new(args: &'a Args) -> Result<Self, CommandError> {
        let given = |file: &'a Option<PathBuf>| file.as_deref().expect("the command line is refused without it");
        let rig_file = given(&args.rig);
        Ok(Self {
            args,
            rig_file,
            recording: given(&args.recording),
            rig: read_rig(rig_file)?,
            sheet: read_sheet(given(&args.patches), args.marker)?,
        })
    }

    fn cameras(&self) -> Result<[&Camera; 2], CommandError> {
        let camera = |index: usize| {
            let name = self.args.cameras.get(index).map_or("", String::as_str);
            let found = self.rig.camera(name);
            found.ok_or_else(|| no_camera(&self.rig, self.rig_file, name))
        };
        let cameras = [camera(0)?, camera(1)?];
        if cameras[0].name == cameras[1].name {
            return Err(ColorError::OneCamera {
                camera: cameras[0].name.clone(),
            }
            .into());
        }
        // A chart lies anywhere: nothing but its corners tells where.
        let is_placed = |camera: &Camera| self.args.chart_corners.iter().any(|given| given.camera == camera.name);
        if self.args.patches.as_deref() == Some(Path::new(COLOR_CHECKER))
            && let Some(camera) = cameras.into_iter().find(|camera| !is_placed(camera))
        {
            return Err(ColorError::NoChartCorners {
                camera: camera.name.clone(),
            }
            .into());
        }
        Ok(cameras)
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    if let Some(file) = &args.print_sheet {
        let mut sheet = PatchSheet::printed();
        sheet.marker = args.marker.or(sheet.marker);
        let id = sheet.marker.unwrap_or_default();
        let svg = print::sheet_svg(&sheet).ok_or(ColorError::NoSuchMarker { id })?;
        super::output::write_file(file, svg.as_bytes())?;
        let file = file.display();
        return writeln!(out, "{file}: print at 100 %, then check the ruler").map_err(CommandError::Output);
    }
    args.output.check()?;
    let task = Task::new(args)?;
    let cameras = task.cameras()?;
    if args.white_balance {
        return white_balance::run(&task, cameras, out);
    }
    let found = read::read(&task, cameras)?;
    let matched = matching::match_cameras(&found.shared, args.keep.as_deref()).map_err(|source| ColorError::Match {
        first: cameras[0].name.clone(),
        second: cameras[1].name.clone(),
        left_out: found.left_out_text(),
        source,
    })?;
    if matched.after.relative_mean > MAX_ERROR {
        return Err(ColorError::Unlike {
            first: cameras[0].name.clone(),
            second: cameras[1].name.clone(),
            percent: 100.0 * matched.after.relative_mean,
            allowed: 100.0 * MAX_ERROR,
        }
        .into());
    }
    args.output
        .write_json(&report::Numbers::new(&args.cameras, &matched, &found))?;
    args.output
        .write_report(|| report::page(&args.cameras, &matched, &found))?;
    write_rig(&task, &matched, cameras)?;
    report::write_summary(out, &args.cameras, &matched, &found).map_err(CommandError::Output)
}

fn read_sheet(file: &Path, marker: Option<u32>) -> Result<PatchSheet, ColorError> {
    let mut sheet = match file.to_str() {
        Some(COLOR_CHECKER) => PatchSheet::color_checker(),
        Some("sheet") => PatchSheet::printed(),
        _ => {
            let file = file.to_owned();
            let text = fs::read_to_string(&file).map_err(|source| ColorError::Read {
                file: file.clone(),
                source,
            })?;
            PatchSheet::from_toml(&text).map_err(|source| ColorError::Sheet { file, source })?
        }
    };
    sheet.marker = marker.or(sheet.marker);
    Ok(sheet)
}

/// Writes the second camera's matrix: into `--out` if it is there, else into a copy of the rig.
fn write_rig(task: &Task<'_>, matched: &ColorMatch, [first, second]: [&Camera; 2]) -> Result<(), CommandError> {
    let output = &task.args.output;
    let Some(out) = &output.out else { return Ok(()) };
    let start = if out.exists() { out } else { task.rig_file };
    let mut draft: RigDraft = super::output::draft(start)?;
    draft.set_color(&second.name, &(first.photometry.color * matched.first_from_second));
    output.write_rig(&draft)?;
    Ok(())
}
