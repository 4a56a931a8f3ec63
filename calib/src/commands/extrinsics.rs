//! `extrinsics`: where fixed cameras stand, and where a camera is beside another.

use std::{io::Write, path::PathBuf};

use mirrorball_calib::{
    extrinsics::{
        BundleError, View,
        cameras::{CameraError, CameraPlace, fixed, pair},
    },
    pose::Pose,
    report::{Block, Report},
    rig::{Camera, Marker, Role},
};
use serde::Serialize;

use super::{
    CommandError,
    explain::Explain,
    input::InputArgs,
    output::OutputArgs,
    progress::Progress,
    sightings::{RigText, Seen, SightingsError},
    view_list::{
        RejectedEntry, Rows, SigmaEntry, ViewEntry, difference, matrix_rows, push_views, rejected_entries, rows,
        view_entries,
    },
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig file with the cameras' lenses and the markers' places.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Fixed camera to locate by the markers that it sees; every fixed camera of the rig unless given.
    #[arg(long, value_name = "NAME", conflicts_with = "pair")]
    camera: Vec<String>,
    /// Two cameras whose relative pose is wanted: pictures taken at the same time show markers to both.
    #[arg(long, value_name = "FIRST,SECOND", value_parser = two_names)]
    pair: Option<[String; 2]>,
    /// Rig file with the places of a target's markers to each other, in place of the rig's markers; with `--pair`.
    #[arg(long, value_name = "FILE", requires = "pair")]
    target: Option<PathBuf>,
    /// Largest difference between the time stamps of pictures taken at the same time, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 1.0)]
    max_skew_ms: f64,
    #[command(flatten)]
    output: OutputArgs,
}

fn two_names(text: &str) -> Result<[String; 2], String> {
    let names = text
        .split_once(',')
        .ok_or_else(|| "two names, as in `left,right`".to_owned())?;
    Ok([names.0.to_owned(), names.1.to_owned()])
}

/// Why there is no pose.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ExtrinsicsError {
    #[error("the rig file has no fixed camera (role `ball` or `fisheye`)")]
    NoFixedCamera,
    #[error("camera `{name}` moves (role `scene`): it has no place of its own")]
    Moves { name: String },
    #[error("the rig file has no markers")]
    NoMarkers,
    #[error("cameras `{first}` and `{second}` cannot be related")]
    Pair {
        first: String,
        second: String,
        #[source]
        source: CameraError,
    },
    #[error("camera `{name}` cannot be located")]
    Camera {
        name: String,
        #[source]
        source: CameraError,
    },
    #[error("`--pair` names camera `{name}` twice")]
    Same { name: String },
}

impl Explain for ExtrinsicsError {
    fn is_bad_input(&self) -> bool {
        match self {
            // Pictures that contradict each other are bad input; a solve that does not end is not.
            Self::Pair { source, .. } | Self::Camera { source, .. } => {
                !matches!(source, CameraError::Bundle(BundleError::Solve(_)))
            }
            Self::NoFixedCamera | Self::Moves { .. } | Self::NoMarkers | Self::Same { .. } => true,
        }
    }

    fn hint(&self) -> Option<&str> {
        let source = match self {
            Self::NoFixedCamera => return Some("relate two cameras with `--pair FIRST,SECOND`"),
            Self::Moves { .. } => return Some("relate it to another camera with `--pair FIRST,SECOND`"),
            Self::NoMarkers => return Some("find the markers first: `mirrorball-calib markers`"),
            Self::Same { .. } => return Some("name two cameras of the rig"),
            Self::Pair { source, .. } | Self::Camera { source, .. } => source,
        };
        Some(match source {
            CameraError::NoMarkers { .. } => {
                "put markers where the camera sees them and find their places with `mirrorball-calib markers`, or carry a \
                 target before it and a second camera: `--pair`"
            }
            CameraError::TooFewPairs { .. } => {
                "show markers to both cameras at once; the time stamps of a pair may differ by `--max-skew-ms`"
            }
            CameraError::NoSquare => "look whether the lens in the rig file is this camera's",
            CameraError::Ambiguous { .. } => "show it several markers, or one that is larger in the picture",
            CameraError::Bundle(_) => {
                "look whether the camera or a marker moved, and whether the markers' sides are right"
            }
        })
    }
}

/// A pose that was found.
struct Found {
    /// The camera, and the one that it is related to.
    camera: String,
    first: Option<String>,
    place: CameraPlace,
    /// Against the rig file.
    change: Option<SigmaEntry>,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    let rig = RigText::read(&args.rig)?;
    let mut draft = rig.draft(&args.output)?;
    let found = match &args.pair {
        Some(names) => {
            let cameras = [rig.camera(&names[0])?, rig.camera(&names[1])?];
            let found = related(args, &rig, &cameras)?;
            // A fixed camera's place follows from that of another one.
            if let (Some(first_from_world), false) = (cameras[0].camera_from_world, cameras[1].role == Role::Scene) {
                draft.set_camera_from_world(&cameras[1].name, &(found.place.pose * first_from_world));
            }
            vec![found]
        }
        None => {
            let found = located(args, &rig)?;
            for found in &found {
                draft.set_camera_from_world(&found.camera, &found.place.pose);
            }
            found
        }
    };
    for found in &found {
        write_text(found, out).map_err(CommandError::Output)?;
    }
    args.output.write_json(&Numbers {
        routine: "extrinsics",
        cameras: found.iter().map(CameraEntry::of).collect(),
    })?;
    args.output.write_report(|| report(&found))?;
    Ok(args.output.write_rig(&draft)?)
}

/// Every fixed camera by itself.
fn located(args: &Args, rig: &RigText) -> Result<Vec<Found>, CommandError> {
    if rig.parts.markers.is_empty() {
        return Err(ExtrinsicsError::NoMarkers.into());
    }
    let names: Vec<String> = if args.camera.is_empty() {
        let fixed = rig.parts.cameras.iter().filter(|camera| camera.role != Role::Scene);
        fixed.map(|camera| camera.name.clone()).collect()
    } else {
        args.camera.clone()
    };
    if names.is_empty() {
        return Err(ExtrinsicsError::NoFixedCamera.into());
    }
    let mut cameras = Vec::new();
    for name in &names {
        let camera = rig.camera(name)?;
        if camera.role == Role::Scene {
            return Err(ExtrinsicsError::Moves { name: name.clone() }.into());
        }
        cameras.push(camera);
    }
    let seen = rig.look(args.input.open().map_err(SightingsError::from)?, &cameras)?;
    let _progress = Progress::solve("locating the cameras");
    let mut found = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        let views = seen.iter().filter(|seen| seen.camera == index);
        let views: Vec<View> = views.map(|seen| seen.view.clone()).collect();
        let place =
            fixed(&camera.intrinsics, &views, &rig.parts.markers).map_err(|source| ExtrinsicsError::Camera {
                name: camera.name.clone(),
                source,
            })?;
        let was = camera.camera_from_world;
        found.push(Found {
            camera: camera.name.clone(),
            first: None,
            change: was.map(|was| difference(&place.pose.inverse(), &was.inverse())),
            place,
        });
    }
    Ok(found)
}

/// The second camera beside the first.
fn related(args: &Args, rig: &RigText, cameras: &[Camera; 2]) -> Result<Found, CommandError> {
    let [first, second] = cameras;
    if first.name == second.name {
        let name = first.name.clone();
        return Err(ExtrinsicsError::Same { name }.into());
    }
    let target: Option<Vec<Marker>> = match &args.target {
        Some(file) => Some(RigText::read(file)?.parts.markers),
        None => None,
    };
    let markers = target.as_ref().unwrap_or(&rig.parts.markers);
    if markers.is_empty() {
        return Err(ExtrinsicsError::NoMarkers.into());
    }
    let seen = rig.look(args.input.open().map_err(SightingsError::from)?, cameras)?;
    let pairs = pairs(&seen, args.max_skew_ms);
    let _progress = Progress::solve("relating the cameras");
    let place =
        pair([&first.intrinsics, &second.intrinsics], &pairs, markers).map_err(|source| ExtrinsicsError::Pair {
            first: first.name.clone(),
            second: second.name.clone(),
            source,
        })?;
    let was = first.camera_from_world.zip(second.camera_from_world);
    let was = was.map(|(first, second): (Pose, Pose)| second * first.inverse());
    Ok(Found {
        camera: second.name.clone(),
        first: Some(first.name.clone()),
        change: was.map(|was| difference(&place.pose.inverse(), &was.inverse())),
        place,
    })
}

/// Pictures that belong together: each of the first camera's with the nearest in time of the second's.
fn pairs(seen: &[Seen], max_skew_ms: f64) -> Vec<[View; 2]> {
    let of = |camera: usize| seen.iter().filter(move |seen| seen.camera == camera);
    let pair = |first: &Seen| {
        let time = first.timestamp_ns?;
        let skew = |other: &Seen| other.timestamp_ns.map_or(u64::MAX, |ns| ns.abs_diff(time));
        let second = of(1).min_by_key(|other| skew(other))?;
        (skew(second) as f64 <= 1e6 * max_skew_ms).then(|| [first.view.clone(), second.view.clone()])
    };
    of(0).filter_map(pair).collect()
}

/// What the JSON file holds for a camera; its keys are an interface.
#[derive(Serialize)]
struct Numbers<'a> {
    routine: &'static str,
    cameras: Vec<CameraEntry<'a>>,
}

#[derive(Serialize)]
struct CameraEntry<'a> {
    camera: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_from_world: Option<Rows>,
    #[serde(skip_serializing_if = "Option::is_none")]
    first_camera: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_from_first_camera: Option<Rows>,
    sigma: SigmaEntry,
    covariance: Vec<Vec<f64>>,
    change: Option<SigmaEntry>,
    rms_px: f64,
    views: Vec<ViewEntry<'a>>,
    rejected: Vec<RejectedEntry<'a>>,
}

impl<'a> CameraEntry<'a> {
    fn of(found: &'a Found) -> Self {
        let (pose, first) = (rows(&found.place.pose), found.first.as_deref());
        Self {
            camera: &found.camera,
            camera_from_world: first.is_none().then_some(pose),
            first_camera: first,
            camera_from_first_camera: first.map(|_| pose),
            sigma: found.place.sigma.into(),
            covariance: matrix_rows(&found.place.covariance),
            change: found.change,
            rms_px: found.place.rms_px,
            views: view_entries(&found.place.views),
            rejected: rejected_entries(&found.place.rejected),
        }
    }
}

/// Where it is and how sure that is, in a sentence.
fn sentence(found: &Found) -> String {
    let place = 1e3 * found.place.pose.inverse().translation;
    let sigma = SigmaEntry::from(found.place.sigma);
    let frame = found
        .first
        .as_ref()
        .map_or("the world".to_owned(), |first| format!("`{first}`"));
    let mut text = format!(
        "camera `{}` at {:.2} {:.2} {:.2} mm in {frame}, σ {:.3} mm and {:.4}°; {} pictures, {:.3} px root mean square, {} \
         detections left out",
        found.camera,
        place.x,
        place.y,
        place.z,
        sigma.place_mm,
        sigma.rotation_deg,
        found.place.views.len(),
        found.place.rms_px,
        found.place.rejected.len()
    );
    if let Some(change) = found.change {
        text += &format!(
            "; {:.3} mm and {:.4}° from where the rig file had it",
            change.place_mm, change.rotation_deg
        );
    }
    text
}

fn write_text(found: &Found, out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "{}", sentence(found))
}

fn report(found: &[Found]) -> Report {
    let mut report = Report::new("Places of cameras");
    for found in found {
        report.push(Block::Heading(format!("Camera {}", found.camera)));
        report.push(Block::Text(sentence(found)));
        push_views(&mut report, &found.place.views, &found.place.rejected);
    }
    report
}
