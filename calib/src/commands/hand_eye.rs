//! `hand-eye`: where a camera is on a headset that another system tracks.

use std::{io::Write, path::PathBuf};

use glam::{DMat3, DQuat, DVec3};
use mirrorball_calib::{
    extrinsics::{
        cameras::fixed,
        hand_eye::{Clocks, HandEye, HandEyeError, Moment, TrackedPose, solve},
    },
    pose::Pose,
    report::{
        Block, Plot, Report,
        plot::{Axis, Series, Style},
    },
};
use serde::Serialize;

use super::{
    CommandError,
    csv::{Table, TableError},
    explain::Explain,
    input::Pictures,
    output::OutputArgs,
    progress::Progress,
    sightings::RigText,
    view_list::{Rows, SigmaEntry, matrix_rows, rows},
};

/// How far a quaternion's length may be from 1.
const QUATERNION_TOLERANCE: f64 = 1e-2;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig file with the camera's lens and the markers' places.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Recording: a folder with `frames.csv`, or an MCAP file.
    #[arg(long, value_name = "PATH")]
    recording: PathBuf,
    /// Camera on the headset.
    #[arg(long, value_name = "NAME")]
    camera: String,
    /// Poses tracker_from_headset, by time: CSV with `timestamp_ns` and `qw,qx,qy,qz,x,y,z` or the rows
    /// `r00,r01,r02,x,r10,r11,r12,y,r20,r21,r22,z`; metres.
    #[arg(long, value_name = "FILE.csv")]
    poses: PathBuf,
    /// Find a constant difference between the tracker's clock and the recording's too, of at most 0.25 s.
    #[arg(long)]
    time_offset: bool,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// File for a page with plots.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

/// Why the camera has no place on the headset.
#[derive(Debug, thiserror::Error)]
pub(crate) enum HandEyeFailure {
    #[error("the rig file has no markers")]
    NoMarkers,
    #[error("the camera cannot be related to the tracked headset")]
    Solve(#[from] HandEyeError),
}

impl Explain for HandEyeFailure {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Solve(HandEyeError::Solve(_)))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::NoMarkers => "find the markers first: `mirrorball-calib markers`",
            Self::Solve(HandEyeError::TooFewMoments { .. }) => {
                "keep markers in view, and look whether both time stamps are of one clock"
            }
            Self::Solve(HandEyeError::TooLittleRotation { .. } | HandEyeError::OneAxis { .. }) => {
                "turn the headset about all three axes, 20° and more, with the markers in view"
            }
            Self::Solve(HandEyeError::Solve(_)) => {
                "look whether the poses are tracker_from_headset, and not the other way round"
            }
        })
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let output = OutputArgs {
        out: None,
        json: args.json.clone(),
        report: args.report.clone(),
    };
    output.check()?;
    let rig = RigText::read(&args.rig)?;
    let camera = rig.camera(&args.camera)?;
    if rig.parts.markers.is_empty() {
        return Err(HandEyeFailure::NoMarkers.into());
    }
    let track = tracked_poses(&Table::read(&args.poses)?)?;
    let pictures = Pictures::of_recording(&args.recording)?;
    let seen = rig.look(pictures, std::slice::from_ref(&camera))?;
    let moments: Vec<Moment> = seen
        .iter()
        .filter_map(|seen| {
            let views = std::slice::from_ref(&seen.view);
            let located = fixed(&camera.intrinsics, views, &rig.parts.markers).ok()?;
            Some(Moment {
                name: seen.view.name.clone(),
                timestamp_ns: seen.timestamp_ns?,
                camera_from_world: located.pose,
            })
        })
        .collect();
    let unlocated = seen.len() - moments.len();
    let clocks = if args.time_offset { Clocks::Offset } else { Clocks::Same };
    let found = {
        let _progress = Progress::solve("relating camera and headset");
        solve(&track, &moments, clocks).map_err(HandEyeFailure::from)?
    };
    let text = sentences(&found, unlocated).join("\n");
    writeln!(out, "{text}").map_err(CommandError::Output)?;
    output.write_json(&Numbers::of(&found, &args.camera, unlocated))?;
    output.write_report(|| report(&found, unlocated))?;
    Ok(())
}

/// The tracker's poses, ordered by time.
fn tracked_poses(table: &Table) -> Result<Vec<TrackedPose>, TableError> {
    let mut poses = Vec::new();
    for index in 0..table.len() {
        let tracker_from_headset = if table.has("qw") {
            let [qw, qx, qy, qz, x, y, z] = table.numbers(index, ["qw", "qx", "qy", "qz", "x", "y", "z"])?;
            let quaternion = DQuat::from_xyzw(qx, qy, qz, qw);
            if (quaternion.length() - 1.0).abs() > QUATERNION_TOLERANCE {
                return Err(table.value(index, "qw", "part of a quaternion of length 1"));
            }
            Pose {
                rotation: DMat3::from_quat(quaternion.normalize()),
                translation: DVec3::new(x, y, z),
            }
        } else {
            let rows = [
                table.numbers(index, ["r00", "r01", "r02", "x"])?,
                table.numbers(index, ["r10", "r11", "r12", "y"])?,
                table.numbers(index, ["r20", "r21", "r22", "z"])?,
            ];
            Pose::from_rows(&rows).map_err(|_| table.value(index, "r00", "part of a rotation"))?
        };
        poses.push(TrackedPose {
            timestamp_ns: table.whole(index, "timestamp_ns")?,
            tracker_from_headset,
        });
    }
    poses.sort_by_key(|pose| pose.timestamp_ns);
    poses.dedup_by_key(|pose| pose.timestamp_ns);
    Ok(poses)
}

/// What the JSON file holds; its keys are an interface.
#[derive(Serialize)]
struct Numbers<'a> {
    routine: &'static str,
    camera: &'a str,
    headset_from_camera: Rows,
    world_from_tracker: Rows,
    headset_from_camera_sigma: SigmaEntry,
    world_from_tracker_sigma: SigmaEntry,
    headset_from_camera_covariance: Vec<Vec<f64>>,
    world_from_tracker_covariance: Vec<Vec<f64>>,
    tracker_minus_camera_s: Option<f64>,
    tracker_minus_camera_sigma_s: Option<f64>,
    residual_rotation_deg: f64,
    residual_place_mm: f64,
    unlocated: usize,
    untracked: usize,
    rejected: &'a [String],
    views: Vec<ResidualEntry<'a>>,
}

#[derive(Serialize)]
struct ResidualEntry<'a> {
    name: &'a str,
    rotation_deg: f64,
    place_mm: f64,
}

impl<'a> Numbers<'a> {
    fn of(found: &'a HandEye, camera: &'a str, unlocated: usize) -> Self {
        let offset = found.tracker_minus_camera_s;
        let views = found.residuals.iter().map(|residual| ResidualEntry {
            name: &residual.name,
            rotation_deg: residual.rotation_rad.to_degrees(),
            place_mm: 1e3 * residual.place_m,
        });
        Self {
            routine: "hand-eye",
            camera,
            headset_from_camera: rows(&found.headset_from_camera),
            world_from_tracker: rows(&found.world_from_tracker),
            headset_from_camera_sigma: found.camera_sigma().into(),
            world_from_tracker_sigma: found.tracker_sigma().into(),
            headset_from_camera_covariance: matrix_rows(&found.camera_covariance),
            world_from_tracker_covariance: matrix_rows(&found.tracker_covariance),
            tracker_minus_camera_s: offset.map(|offset| offset.0),
            tracker_minus_camera_sigma_s: offset.map(|offset| offset.1),
            residual_rotation_deg: found.rotation_spread_rad.to_degrees(),
            residual_place_mm: 1e3 * found.place_spread_m,
            unlocated,
            untracked: found.untracked,
            rejected: &found.rejected,
            views: views.collect(),
        }
    }
}

fn sentences(found: &HandEye, unlocated: usize) -> Vec<String> {
    let place = |name: &str, pose: &Pose, sigma: SigmaEntry| {
        let p = 1e3 * pose.translation;
        format!(
            "{name} at {:.2} {:.2} {:.2} mm, σ {:.3} mm and {:.4}°",
            p.x, p.y, p.z, sigma.place_mm, sigma.rotation_deg
        )
    };
    let mut sentences = vec![
        place(
            "camera on the headset",
            &found.headset_from_camera,
            found.camera_sigma().into(),
        ),
        place(
            "tracker in the world",
            &found.world_from_tracker,
            found.tracker_sigma().into(),
        ),
    ];
    if let Some((offset_s, sigma_s)) = found.tracker_minus_camera_s {
        sentences.push(format!(
            "tracker's clock minus camera's {:.2} ms, σ {:.2} ms",
            1e3 * offset_s,
            1e3 * sigma_s
        ));
    }
    sentences.push(format!(
        "{} pictures, {:.3} mm and {:.4}° left per axis; {} do not fit, {unlocated} not located, {} while not tracked",
        found.residuals.len(),
        1e3 * found.place_spread_m,
        found.rotation_spread_rad.to_degrees(),
        found.rejected.len(),
        found.untracked
    ));
    sentences
}

fn report(found: &HandEye, unlocated: usize) -> Report {
    let mut report = Report::new("Camera on the headset");
    for sentence in sentences(found, unlocated) {
        report.push(Block::Text(sentence));
    }
    if !found.rejected.is_empty() {
        let names = found.rejected.join(", ");
        report.push(Block::Warning(format!(
            "pictures that do not fit and were left out: {names}"
        )));
    }
    let series = |name: &str, values: Vec<f64>| Series {
        name: name.to_owned(),
        points: values
            .into_iter()
            .enumerate()
            .map(|(i, value)| [i as f64, value])
            .collect(),
        style: Style::Dots,
    };
    let rotation = found
        .residuals
        .iter()
        .map(|residual| residual.rotation_rad.to_degrees());
    let place = found.residuals.iter().map(|residual| 1e3 * residual.place_m);
    for (axis, series) in [
        (
            "angle, °",
            series("camera as tracked against as seen", rotation.collect()),
        ),
        (
            "distance, mm",
            series("camera as tracked against as seen", place.collect()),
        ),
    ] {
        report.push(Block::Plot {
            caption: "What is left at each picture. Waves mean that clocks differ, or that the tracker drifts."
                .to_owned(),
            plot: Plot::Chart {
                x: Axis::linear("picture"),
                y: Axis::linear(axis),
                series: vec![series],
            },
        });
    }
    report
}
