//! `probe`: what a picture of the light probe shows of the light.

pub(crate) mod canvas;
mod chart;
mod error;
mod files;
mod measure;
mod report;
mod taken;

use std::{io::Write, path::PathBuf};

use glam::Vec3;
use mirrorball_calib::{
    lights::{LightCounts, LightMethod, LightTracker},
    probe::cube::Cube,
};

pub(crate) use error::ProbeError;

use super::{CommandError, read_rig};
use measure::{Measured, PROBE_CUBE_SIZE};
use report::{Figures, FoundLight};

/// Lights at fixed directions; the method `median_cut` has none.
const DOME_LIGHTS: u32 = 48;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Picture of the mirror ball, or of a fisheye camera (PNG or JPEG); several exposures of one view are merged.
    #[arg(value_name = "IMAGE", required = true)]
    images: Vec<PathBuf>,
    /// Rig file with cameras, markers and ball.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Camera of the rig that took the picture; otherwise the one in `frames.csv`, the fixed one, or the only one.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Exposure time in seconds, one for all pictures or one each; otherwise that in the `frames.csv` of the recording that
    /// the picture belongs to.
    #[arg(long, value_name = "T", value_delimiter = ',', num_args = 1)]
    exposure_s: Option<Vec<f64>>,
    /// Analogue gain, linear; otherwise that in `frames.csv`, or 1.
    #[arg(long, value_name = "G")]
    gain: Option<f64>,
    /// White balance gains of red, green and blue, linear; otherwise those in `frames.csv`, or 1,1,1.
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', num_args = 1)]
    wb: Option<Vec<f64>>,
    /// Distance of the room from the probe in metres: a ball shows near light in another place than far light.
    #[arg(long, value_name = "M", default_value_t = 2.0)]
    room_distance_m: f32,
    /// How lights are found: `stable`, `median_cut` or `regions`.
    #[arg(long, value_name = "METHOD", default_value = "stable", value_parser = method)]
    lights: LightMethod,
    /// Most lights on bright regions, 1 to 250; with `median_cut`, all lights.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=250))]
    lights_count: u32,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// Folder for `environment.exr`, `environment.hdr` and `environment.png`; made if need be, files are overwritten.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let rig = read_rig(&args.rig)?;
    let options = taken::Options {
        camera: args.camera.as_deref(),
        exposure_s: args.exposure_s.as_deref(),
        gain: args.gain,
        white_balance: args.wb.as_deref(),
    };
    let pictures = taken::pictures(&args.images, &rig, &args.rig, &options)?;
    let measured = measure::measure(&pictures, &rig, args.room_distance_m)?;
    let radiance = measured.filled();
    let found = lights(&measured, &radiance, args.lights, args.lights_count);
    let figures = Figures::of(&measured, found);
    files::write(&args.out, &radiance, &chart::draw(&measured, &radiance, &figures))?;
    let text = if args.json {
        report::json(&pictures, &measured, &figures, args.lights).map_err(|error| CommandError::Output(error.into()))?
    } else {
        report::text(&pictures, &measured, &figures, args.lights)
    };
    out.write_all(text.as_bytes()).map_err(CommandError::Output)
}

fn method(name: &str) -> Result<LightMethod, String> {
    LightMethod::from_name(name).ok_or_else(|| {
        let names = LightMethod::ALL.map(|method| format!("`{}`", method.name()));
        format!("allowed are {}", names.join(", "))
    })
}

/// The lights of the map, those on bright regions first, from strong to weak.
fn lights(measured: &Measured, radiance: &Cube<Vec3>, method: LightMethod, count: u32) -> Vec<FoundLight> {
    let counts = match method {
        LightMethod::Stable | LightMethod::Regions => LightCounts {
            dome: DOME_LIGHTS,
            bright: count,
        },
        LightMethod::MedianCut => LightCounts { dome: count, bright: 0 },
    };
    let is_dome = |id: u32| match method {
        LightMethod::Stable | LightMethod::Regions => id < DOME_LIGHTS,
        LightMethod::MedianCut => false,
    };
    let open = Cube::filled(PROBE_CUBE_SIZE, true);
    // One picture does not tell how far away its lights are.
    let distance_m = Cube::filled(1, f32::INFINITY);
    let mut tracker = LightTracker::new(method, &open, counts);
    let mut found: Vec<FoundLight> = (tracker.update(radiance, &distance_m).iter())
        .map(|light| FoundLight::new(light, is_dome(light.id), measured))
        .collect();
    found.sort_by(|a, b| a.is_dome.cmp(&b.is_dome).then(b.power().total_cmp(&a.power())));
    found
}
