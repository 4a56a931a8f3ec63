//! `check`: the camera's pose in every frame of a recording, whether the pictures are those of the rig's cameras, and whether
//! the rig still holds.

mod drift;
mod recording;

use std::{
    io::{self, Write},
    path::PathBuf,
    time::Duration,
};

use mirrorball_calib::{
    pose::Pose,
    probe::{View, radiance::Picture},
    resection::{self, Located, NoPose},
    rig::{
        Camera, Rig, Role,
        check::{RigCheck, RigMismatch},
        drift::{BallCheck, DriftCheck},
    },
    tag::{self, Detection, Finder},
};
use mirrorball_capture::{Frame, Next, Source, SourceError, source::PictureError, to_rgb8};

use super::{CommandError, families, input::InputError, output::OutputArgs};
pub(crate) use drift::CheckError;

/// How long to wait for a frame before asking again; a recording played as fast as possible never takes that long.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Pictures of each camera that are compared with the rig.
const RIG_CHECK_FRAMES: usize = 10;

/// Pictures of each fixed camera in which markers are looked for; they all show the same.
const FIXED_FRAMES: usize = 20;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Recording (a folder with `rig.toml`, `frames.csv` and the pictures, or an MCAP file), which is held against the rig
    /// file in it; or a rig file, which is held against `--recording`.
    #[arg(value_name = "RIG_OR_RECORDING")]
    subject: PathBuf,
    /// Recording to hold the rig file against.
    #[arg(long, value_name = "PATH")]
    recording: Option<PathBuf>,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// File for a page with plots.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

impl Args {
    fn outputs(&self) -> OutputArgs {
        OutputArgs {
            out: None,
            json: self.json.clone(),
            report: self.report.clone(),
        }
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.outputs().check()?;
    let (rig, mut source) = recording::open(&args.subject, args.recording.as_deref())?;
    let mut replay = Replay::new(&rig);
    writeln!(out, "   frame  markers  error px   camera in world, mm").map_err(CommandError::Output)?;
    replay.run(&mut *source, args, out)?;
    replay.summary.write(out).map_err(CommandError::Output)?;
    replay.rig_check.verdict().map_err(mismatch)?;
    let drifted = drift::conclude(&replay.drift, replay.ball.as_ref(), args, out)?;
    let summary = replay.summary;
    if let Some(error) = drifted {
        return Err(error.into());
    }
    if summary.lost > 0 {
        return Err(CommandError::Lost {
            lost: summary.lost,
            frames: summary.lost + summary.errors_px.len(),
        });
    }
    Ok(())
}

/// A recording played once, and what has been seen of it.
struct Replay<'a> {
    rig: &'a Rig,
    finder: Finder,
    rig_check: RigCheck<'a>,
    drift: DriftCheck<'a>,
    /// `None` when the rig has no ball.
    ball: Option<BallCheck>,
    /// Frames so far, of every camera.
    n_seen: Vec<usize>,
    summary: Summary,
}

impl<'a> Replay<'a> {
    fn new(rig: &'a Rig) -> Self {
        Self {
            rig,
            finder: Finder::new(&families(rig)),
            rig_check: RigCheck::new(rig),
            drift: DriftCheck::new(rig),
            ball: BallCheck::new(rig),
            n_seen: vec![0; rig.cameras.len()],
            summary: Summary::default(),
        }
    }

    fn run(&mut self, source: &mut dyn Source, args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
        let failed = |source: SourceError| CommandError::Recording {
            folder: args.recording.as_ref().unwrap_or(&args.subject).clone(),
            source: Box::new(source),
        };
        loop {
            let next = source
                .next_frame(TIMEOUT)
                .map_err(|error| explain(error, &mut self.rig_check, failed))?;
            match next {
                Next::Frame(frame) => self.add(&frame, out)?,
                Next::TimedOut => {}
                Next::End => return Ok(()),
            }
        }
    }

    fn add(&mut self, frame: &Frame, out: &mut impl Write) -> Result<(), CommandError> {
        let cameras = &self.rig.cameras;
        let Some(index) = cameras.iter().position(|camera| *camera.name == *frame.meta.camera) else {
            return Ok(());
        };
        let frame = &to_rgb8(frame).map_err(|source| InputError::Decode {
            name: format!("{} {}", frame.meta.camera, frame.meta.sequence),
            source,
        })?;
        let number = self.n_seen[index];
        self.n_seen[index] += 1;
        if number < RIG_CHECK_FRAMES {
            self.rig_check
                .add(frame)
                .map_err(|source| search_failed(frame, source))?;
        }
        let camera = &cameras[index];
        let is_scene = camera.name == self.rig.scene_camera().name;
        let size_px = [frame.size.width, frame.size.height];
        if !is_scene && (number >= FIXED_FRAMES || size_px != camera.intrinsics.size_px) {
            return Ok(());
        }
        let detections = self.find(frame, index)?;
        self.drift.add(&camera.name, &detections);
        if let (Some(pose), Role::Ball) = (camera.camera_from_world, camera.role) {
            self.look_at_ball(frame, camera, pose);
        }
        if is_scene {
            let result = resection::locate(&detections, self.rig, &camera.intrinsics);
            if let Ok(located) = &result {
                self.look_at_ball(frame, camera, located.camera_from_world);
            }
            write_frame(frame, &result, out).map_err(CommandError::Output)?;
            self.summary.add(&result);
        }
        Ok(())
    }

    fn look_at_ball(&mut self, frame: &Frame, camera: &Camera, camera_from_world: Pose) {
        if let Some(ball) = &mut self.ball {
            ball.add(&View {
                picture: Picture::new(frame, camera),
                camera,
                camera_from_world,
            });
        }
    }

    fn find(&mut self, frame: &Frame, camera: usize) -> Result<Vec<Detection>, CommandError> {
        let size = [frame.size.width as usize, frame.size.height as usize];
        let found = self.finder.find(&frame.pixels, size, &self.rig.cameras[camera]);
        found.map_err(|source| search_failed(frame, source))
    }
}

fn search_failed(frame: &Frame, source: tag::PictureError) -> CommandError {
    CommandError::Search {
        name: format!("frame {} of {}", frame.meta.sequence, frame.meta.camera),
        source,
    }
}

fn mismatch(source: RigMismatch) -> CommandError {
    CommandError::Mismatch { source }
}

/// What a failure to read a picture says about the rig: pictures of exchanged cameras have each other's size.
fn explain(
    error: SourceError,
    rig_check: &mut RigCheck<'_>,
    failed: impl Fn(SourceError) -> CommandError,
) -> CommandError {
    if let SourceError::BadFrame { camera, source, .. } = &error
        && let PictureError::WrongSize { found, .. } = &**source
    {
        rig_check.add_size(camera, [found.width, found.height]);
    }
    rig_check.verdict().map_or_else(mismatch, |()| failed(error))
}

fn write_frame(frame: &Frame, result: &Result<Located, NoPose>, out: &mut impl Write) -> io::Result<()> {
    let sequence = frame.meta.sequence;
    match result {
        Ok(located) => {
            let centre = 1e3 * located.camera_from_world.inverse().translation;
            let (markers, error) = (located.markers, located.reprojection_error_px);
            writeln!(
                out,
                "{sequence:>8}  {markers:>7}  {error:>8.3}   {:>9.2} {:>9.2} {:>9.2}",
                centre.x, centre.y, centre.z
            )
        }
        Err(reason) => writeln!(out, "{sequence:>8}  lost: {reason}"),
    }
}

/// What is left of the frames when they have gone by.
#[derive(Default)]
struct Summary {
    errors_px: Vec<f64>,
    lost: usize,
}

impl Summary {
    fn add(&mut self, result: &Result<Located, NoPose>) {
        match result {
            Ok(located) => self.errors_px.push(located.reprojection_error_px),
            Err(_) => self.lost += 1,
        }
    }

    fn write(&mut self, out: &mut impl Write) -> io::Result<()> {
        let frames = self.errors_px.len() + self.lost;
        writeln!(
            out,
            "{frames} frames, {} located, {} lost",
            self.errors_px.len(),
            self.lost
        )?;
        self.errors_px.sort_by(f64::total_cmp);
        let Some(&worst) = self.errors_px.last() else {
            return Ok(());
        };
        let (median, p95) = (quantile(&self.errors_px, 0.5), quantile(&self.errors_px, 0.95));
        writeln!(
            out,
            "reprojection error px: median {median:.3}, p95 {p95:.3}, worst {worst:.3}"
        )
    }
}

/// The quantile of sorted values, linear between them.
fn quantile(sorted: &[f64], fraction: f64) -> f64 {
    let position = fraction * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (position - below as f64)
}
