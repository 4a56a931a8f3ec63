//! Whether the rig still holds: as text, as numbers, as a page.

use std::{io::Write, path::PathBuf};

use mirrorball_calib::{
    report::{Block, Plot, Report},
    rig::drift::{
        BallCheck, BallPlace, CameraFit, Displacement, Drift, DriftCheck, DriftError, Finding, MATTERS, MarkerFit,
    },
};
use serde::Serialize;

use super::{
    super::{CommandError, explain::Explain, progress::Progress},
    Args,
};

/// How many times longer than they are residuals are drawn.
const ENLARGED: f64 = 200.0;

/// Why a check fails.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CheckError {
    #[error("rig file `{}` alone cannot be checked", rig.display())]
    NoRecording { rig: PathBuf },
    #[error("recording `{}` has no rig file in it", recording.display())]
    NoRig { recording: PathBuf },
    #[error("the rig no longer holds: {}", findings.join("; "))]
    Drifted { findings: Vec<String>, hint: String },
    #[error("cannot hold the pictures against the rig")]
    Drift(#[source] DriftError),
}

impl Explain for CheckError {
    fn is_bad_input(&self) -> bool {
        matches!(self, Self::NoRecording { .. } | Self::NoRig { .. })
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::NoRecording { .. } => "give a recording made with the rig as it is now: `--recording PATH`",
            Self::NoRig { .. } => "give the rig file first: `mirrorball-calib check rig.toml --recording FILE.mcap`",
            Self::Drifted { hint, .. } => hint,
            Self::Drift(error) => error.hint(),
        })
    }
}

/// Says what has drifted, writes what is to be written, and gives the error if anything has.
pub(super) fn conclude(
    check: &DriftCheck<'_>,
    ball: Option<&BallCheck>,
    args: &Args,
    out: &mut impl Write,
) -> Result<Option<CheckError>, CommandError> {
    let progress = Progress::solve("looking for what has changed");
    let verdict = check.verdict(&|suspect| progress.say(&format!("{suspect:?}")));
    drop(progress);
    let place = ball.and_then(BallCheck::place);
    let moved = place.as_ref().and_then(|place| place.finding(&MATTERS));
    let drift = match verdict {
        Ok(mut drift) => {
            // Where anything else has moved, the cameras may not be where they seem to be, and so the ball.
            if drift.holds() {
                drift.findings.extend(moved);
            }
            Some(drift)
        }
        // A rig of one marker has nothing to be held against, which is no fault of it.
        Err(error @ DriftError::TooLittle { .. }) => {
            writeln!(out, "rig: cannot be judged: {error}").map_err(CommandError::Output)?;
            moved.map(|moved| alone(moved, &error))
        }
        Err(error @ DriftError::NotConverged) => return Err(CheckError::Drift(error).into()),
    };
    let outputs = args.outputs();
    outputs.write_json(&Numbers::of(args, drift.as_ref(), place.as_ref()))?;
    outputs.write_report(|| page(args, drift.as_ref(), place.as_ref()))?;
    if let Some(place) = &place {
        writeln!(out, "{}", ball_sentence(place)).map_err(CommandError::Output)?;
    }
    let Some(drift) = drift else { return Ok(None) };
    write(&drift, out).map_err(CommandError::Output)?;
    if drift.holds() {
        return Ok(None);
    }
    Ok(Some(CheckError::Drifted {
        findings: drift.findings.iter().map(ToString::to_string).collect(),
        hint: remedy(&drift.findings),
    }))
}

/// The one finding about a rig of which nothing else can be said.
fn alone(finding: Finding, error: &DriftError) -> Drift {
    let pictures = match *error {
        DriftError::TooLittle { pictures } => pictures,
        DriftError::NotConverged => 0,
    };
    Drift {
        pictures,
        lost: 0,
        cameras: Vec::new(),
        markers: Vec::new(),
        findings: vec![finding],
    }
}

fn ball_sentence(place: &BallPlace) -> String {
    format!("ball: outline found in {} pictures, off by {place}", place.pictures)
}

/// The routines to run, each once.
fn remedy(findings: &[Finding]) -> String {
    let mut routines: Vec<String> = findings
        .iter()
        .map(|finding| format!("`mirrorball-calib {}`", finding.routine()))
        .collect();
    routines.dedup();
    format!(
        "put back what has moved, or measure it anew: {}",
        routines.join(", then ")
    )
}

fn write(drift: &Drift, out: &mut impl Write) -> std::io::Result<()> {
    for camera in &drift.cameras {
        writeln!(
            out,
            "camera `{}`: {} corners, rms {:.3} px, {:.1} times what is expected",
            camera.name, camera.corners, camera.rms_px, camera.ratio
        )?;
    }
    for marker in &drift.markers {
        let place = marker
            .displacement
            .map_or_else(|| "not determined".to_owned(), |place| place.to_string());
        writeln!(
            out,
            "marker {:>3}: rms {:.3} px, left out of the poses it is off by {place}",
            marker.id, marker.rms_px
        )?;
    }
    if drift.holds() {
        return writeln!(out, "rig: holds");
    }
    drift
        .findings
        .iter()
        .try_for_each(|finding| writeln!(out, "rig: {finding}"))
}

/// The file of `--json`; its keys are an interface.
#[derive(Serialize)]
struct Numbers {
    routine: &'static str,
    subject: PathBuf,
    recording: Option<PathBuf>,
    /// Null when the recording does not tell.
    holds: Option<bool>,
    pictures: usize,
    lost: usize,
    cameras: Vec<CameraEntry>,
    markers: Vec<MarkerEntry>,
    /// Null when no picture shows a ball.
    ball: Option<BallEntry>,
    findings: Vec<FindingEntry>,
}

#[derive(Serialize)]
struct BallEntry {
    pictures: usize,
    /// From where the rig has it, in the world.
    shift_m: [f64; 3],
    /// Along the shift.
    shift_sigma_m: f64,
}

#[derive(Serialize)]
struct CameraEntry {
    name: String,
    corners: usize,
    rms_px: f64,
    ratio: f64,
}

#[derive(Serialize)]
struct MarkerEntry {
    id: u32,
    corners: usize,
    rms_px: f64,
    ratio: f64,
    displacement: Option<DisplacementEntry>,
}

#[derive(Serialize)]
struct DisplacementEntry {
    distance_m: f64,
    distance_sigma_m: f64,
    angle_deg: f64,
    angle_sigma_deg: f64,
}

#[derive(Serialize)]
struct FindingEntry {
    kind: &'static str,
    /// Name of the camera or id of the marker.
    subject: Option<String>,
    displacement: Option<DisplacementEntry>,
    focal_ratio: Option<f64>,
    focal_ratio_sigma: Option<f64>,
    text: String,
    routine: &'static str,
}

impl Numbers {
    fn of(args: &Args, drift: Option<&Drift>, ball: Option<&BallPlace>) -> Self {
        let list = |drift: Option<&Drift>| drift.map(|drift| drift.findings.iter().map(FindingEntry::of).collect());
        Self {
            routine: "check",
            subject: args.subject.clone(),
            recording: args.recording.clone(),
            holds: drift.map(Drift::holds),
            pictures: drift.map_or(0, |drift| drift.pictures),
            lost: drift.map_or(0, |drift| drift.lost),
            cameras: drift.map_or_else(Vec::new, |drift| drift.cameras.iter().map(CameraEntry::of).collect()),
            markers: drift.map_or_else(Vec::new, |drift| drift.markers.iter().map(MarkerEntry::of).collect()),
            ball: ball.map(|place| BallEntry {
                pictures: place.pictures,
                shift_m: place.shift_m.to_array(),
                shift_sigma_m: place.sigma_m,
            }),
            findings: list(drift).unwrap_or_default(),
        }
    }
}

impl CameraEntry {
    fn of(fit: &CameraFit) -> Self {
        Self {
            name: fit.name.clone(),
            corners: fit.corners,
            rms_px: fit.rms_px,
            ratio: fit.ratio,
        }
    }
}

impl MarkerEntry {
    fn of(fit: &MarkerFit) -> Self {
        Self {
            id: fit.id,
            corners: fit.corners,
            rms_px: fit.rms_px,
            ratio: fit.ratio,
            displacement: fit.displacement.as_ref().map(DisplacementEntry::of),
        }
    }
}

impl DisplacementEntry {
    fn of(displacement: &Displacement) -> Self {
        Self {
            distance_m: displacement.distance_m,
            distance_sigma_m: displacement.distance_sigma_m,
            angle_deg: displacement.angle_rad.to_degrees(),
            angle_sigma_deg: displacement.angle_sigma_rad.to_degrees(),
        }
    }
}

impl FindingEntry {
    fn of(finding: &Finding) -> Self {
        let (kind, subject, displacement, lens) = match finding {
            Finding::MarkerMoved { id, displacement, .. } => {
                ("marker_moved", Some(id.to_string()), Some(displacement), None)
            }
            Finding::LensChanged { camera, change, .. } => ("lens_changed", Some(camera.clone()), None, Some(change)),
            Finding::CameraMoved {
                camera, displacement, ..
            } => ("camera_moved", Some(camera.clone()), Some(displacement), None),
            Finding::BallMoved { .. } => ("ball_moved", None, None, None),
            Finding::Unexplained { .. } => ("unexplained", None, None, None),
        };
        Self {
            kind,
            subject,
            displacement: displacement.map(DisplacementEntry::of),
            focal_ratio: lens.map(|change| change.focal_ratio),
            focal_ratio_sigma: lens.map(|change| change.focal_ratio_sigma),
            text: finding.to_string(),
            routine: finding.routine(),
        }
    }
}

fn page(args: &Args, drift: Option<&Drift>, ball: Option<&BallPlace>) -> Report {
    let mut report = Report::new("Does the rig still hold?");
    let recording = args.recording.as_ref().unwrap_or(&args.subject);
    report.push(Block::Text(format!("Recording: {}", recording.display())));
    if let Some(place) = ball {
        report.push(Block::Text(ball_sentence(place)));
    }
    let Some(drift) = drift else {
        let text = "No two markers of the rig are seen together: nothing can be held against anything.";
        report.push(Block::Warning(text.to_owned()));
        return report;
    };
    let (pictures, lost) = (drift.pictures, drift.lost);
    report.push(Block::Text(format!("{pictures} pictures, {lost} without a pose.")));
    if drift.holds() {
        report.push(Block::Text("The rig holds.".to_owned()));
    }
    for finding in &drift.findings {
        let routine = finding.routine();
        report.push(Block::Warning(format!("{finding}. Run mirrorball-calib {routine}.")));
    }
    report.push(markers(drift)).push(cameras(drift));
    for camera in &drift.cameras {
        report.push(Block::Plot {
            caption: format!(
                "Residuals of camera {}: markers that all point one way have moved, arrows to or from the middle are a lens",
                camera.name
            ),
            plot: Plot::Vectors {
                size_px: camera.size_px,
                vectors: camera.residuals_px.clone(),
                scale: ENLARGED / camera.ratio.max(1.0),
            },
        });
    }
    report
}

fn markers(drift: &Drift) -> Block {
    let row = |marker: &MarkerFit| {
        let place = marker
            .displacement
            .map_or_else(|| "not determined".to_owned(), |place| place.to_string());
        vec![
            marker.id.to_string(),
            marker.corners.to_string(),
            format!("{:.3}", marker.rms_px),
            format!("{:.1}", marker.ratio),
            place,
        ]
    };
    Block::Table {
        caption: "Markers, each left out of all poses and found again".to_owned(),
        head: ["marker", "corners", "rms, px", "of expected", "off by"]
            .map(str::to_owned)
            .to_vec(),
        rows: drift.markers.iter().map(row).collect(),
    }
}

fn cameras(drift: &Drift) -> Block {
    let row = |camera: &CameraFit| {
        vec![
            camera.name.clone(),
            camera.corners.to_string(),
            format!("{:.3}", camera.rms_px),
            format!("{:.1}", camera.ratio),
        ]
    };
    Block::Table {
        caption: "Cameras, against the rig as the file has it".to_owned(),
        head: ["camera", "corners", "rms, px", "of expected"]
            .map(str::to_owned)
            .to_vec(),
        rows: drift.cameras.iter().map(row).collect(),
    }
}
