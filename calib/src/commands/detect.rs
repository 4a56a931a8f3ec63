//! `detect`: the markers in pictures, or before a camera.

use std::{
    io::Write,
    path::{Path, PathBuf},
    time::Instant,
};

use glam::DVec2;
use image::RgbImage;
use mirrorball_calib::{
    camera::{Intrinsics, LensModel},
    rig::{Camera, Role},
    tag::{Detection, Family, Finder},
};
use mirrorball_capture::v4l2::CameraAddress;
use serde::Serialize;

use super::{
    CommandError,
    input::LiveArgs,
    sightings::{RigText, plain_photometry},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Pictures (PNG or JPEG).
    #[arg(value_name = "IMAGE", required_unless_present = "device", conflicts_with = "device")]
    images: Vec<PathBuf>,
    /// Camera instead: its device node, or its name as `mirrorball-capture devices` lists it.
    #[arg(long, value_name = "ADDRESS", requires = "size")]
    device: Option<CameraAddress>,
    #[command(flatten)]
    live: LiveArgs,
    /// Print one JSON object per picture.
    #[arg(long)]
    json: bool,
    /// Rig file with the camera's lens and response curve (sRGB until it is measured); without it, no distortion and sRGB.
    #[arg(long, value_name = "FILE", requires = "camera")]
    rig: Option<PathBuf>,
    /// Camera of the rig that took the pictures.
    #[arg(long, value_name = "NAME", requires = "rig")]
    camera: Option<String>,
}

/// What took the pictures.
enum Taker {
    Known(Box<Camera>),
    /// Any camera: as large as the picture.
    Plain,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let (taker, families) = match (&args.rig, &args.camera) {
        (Some(file), Some(name)) => {
            let rig = RigText::read(file)?;
            (Taker::Known(Box::new(rig.camera(name)?)), rig.families())
        }
        (None, _) | (_, None) => (Taker::Plain, vec![Family::Tag36h11]),
    };
    let mut finder = Finder::new(&families);
    for file in &args.images {
        let picture = image::open(file).map_err(|source| CommandError::ReadPicture {
            file: file.to_owned(),
            source,
        })?;
        let found = search(file, &picture.into_rgb8(), &taker, &mut finder)?;
        print(args, file, &found, out)?;
    }
    if let Some(address) = &args.device {
        let mut pictures = args.live.pictures(address)?.without_progress();
        while let Some(picture) = pictures.next() {
            let picture = picture?;
            let name = Path::new(&picture.name);
            let found = search(name, &picture.rgb, &taker, &mut finder)?;
            print(args, name, &found, out)?;
            // Whoever watches a camera wants to see it now.
            out.flush().map_err(CommandError::Output)?;
            if !found.detections.is_empty() {
                pictures.keep(&picture)?;
            }
        }
    }
    Ok(())
}

fn print(args: &Args, file: &Path, found: &Found, out: &mut impl Write) -> Result<(), CommandError> {
    let line = if args.json {
        json_line(file, found)?
    } else {
        text_line(file, found)
    };
    out.write_all(line.as_bytes()).map_err(CommandError::Output)
}

struct Found {
    ms: f64,
    detections: Vec<Detection>,
}

fn search(file: &Path, picture: &RgbImage, taker: &Taker, finder: &mut Finder) -> Result<Found, CommandError> {
    let plain;
    let camera = match taker {
        Taker::Known(camera) => camera,
        Taker::Plain => {
            plain = plain_camera([picture.width(), picture.height()]);
            &plain
        }
    };
    let start = Instant::now();
    let detections = finder
        .find(
            picture.as_raw(),
            [picture.width() as usize, picture.height() as usize],
            camera,
        )
        .map_err(|source| CommandError::Search {
            name: file.display().to_string(),
            source,
        })?;
    Ok(Found {
        ms: start.elapsed().as_secs_f64() * 1e3,
        detections,
    })
}

/// A camera about which nothing is known: sRGB, no distortion. Its focal length does not matter for corners.
fn plain_camera(size_px: [u32; 2]) -> Camera {
    let size = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1]));
    Camera {
        name: "unknown".to_owned(),
        role: Role::Scene,
        intrinsics: Intrinsics {
            size_px,
            focal_px: DVec2::splat(size.max_element().max(1.0)),
            principal_point_px: 0.5 * (size - 1.0),
            lens: LensModel::BrownConrady {
                k1: 0.0,
                k2: 0.0,
                p1: 0.0,
                p2: 0.0,
                k3: 0.0,
            },
        },
        photometry: plain_photometry(),
        camera_from_world: None,
    }
}

/// A line of `--json`; its keys are an interface.
#[derive(Serialize)]
struct PictureLine<'a> {
    file: String,
    ms: f64,
    detections: Vec<DetectionEntry<'a>>,
}

#[derive(Serialize)]
struct DetectionEntry<'a> {
    family: &'a str,
    id: u32,
    hamming: u32,
    decision_margin: f64,
    corners_px: [[f64; 2]; 4],
}

fn json_line(file: &Path, found: &Found) -> Result<String, CommandError> {
    let entry = |detection: &Detection| DetectionEntry {
        family: detection.family.name(),
        id: detection.id,
        hamming: detection.hamming,
        decision_margin: detection.decision_margin,
        corners_px: detection.corners_px.map(|corner| corner.to_array()),
    };
    let detections = found.detections.iter().map(entry).collect();
    let line = PictureLine {
        file: file.display().to_string(),
        ms: found.ms,
        detections,
    };
    let line = serde_json::to_string(&line).map_err(|error| CommandError::Output(error.into()))?;
    Ok(format!("{line}\n"))
}

fn text_line(file: &Path, found: &Found) -> String {
    let mut text = format!(
        "{}: {} markers, {:.1} ms\n",
        file.display(),
        found.detections.len(),
        found.ms
    );
    for detection in &found.detections {
        let corners = detection
            .corners_px
            .map(|corner| format!("({:.2}, {:.2})", corner.x, corner.y))
            .join(" ");
        text += &format!(
            "  {} {:>3}  hamming {}  ",
            detection.family, detection.id, detection.hamming
        );
        text += &format!("margin {:>5.1}  {corners}\n", detection.decision_margin);
    }
    text
}
