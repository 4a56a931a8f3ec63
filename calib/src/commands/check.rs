//! `check`: the camera's pose in every frame of a recording, and whether the pictures are those of the rig's cameras.

use std::{
    io::{self, Write},
    path::PathBuf,
    time::Duration,
};

use mirrorball_calib::{
    resection::{self, Located, NoPose},
    rig::{
        Rig,
        check::{RigCheck, RigMismatch},
    },
    tag::{self, Finder},
};
use mirrorball_capture::{Frame, Next, Pace, Player, Repeat, Source, SourceError, source::PictureError};

use super::{CommandError, families, read_rig};

/// How long to wait for a frame before asking again; a recording played as fast as possible never takes that long.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Pictures of each camera that are compared with the rig.
const RIG_CHECK_FRAMES: usize = 10;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder with `rig.toml`, `frames.csv` and the pictures.
    #[arg(value_name = "RECORDING_DIR")]
    recording: PathBuf,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let failed = |source: SourceError| CommandError::Recording {
        folder: args.recording.clone(),
        source: Box::new(source),
    };
    let mut player = Player::open(&args.recording, Pace::Max, Repeat::ONCE).map_err(failed)?;
    let rig = read_rig(&args.recording.join("rig.toml"))?;
    let camera = rig.scene_camera();
    let mut finder = Finder::new(&families(&rig));
    let mut summary = Summary::default();
    let mut rig_check = RigCheck::new(&rig);
    let mut n_checked = vec![0; rig.cameras.len()];
    writeln!(out, "   frame  markers  error px   camera in world, mm").map_err(CommandError::Output)?;
    loop {
        let next = player
            .next_frame(TIMEOUT)
            .map_err(|error| explain(error, &mut rig_check, failed))?;
        if let Next::Frame(frame) = &next {
            let index = rig.cameras.iter().position(|camera| *camera.name == *frame.meta.camera);
            if let Some(n) = index.map(|index| &mut n_checked[index])
                && *n < RIG_CHECK_FRAMES
            {
                *n += 1;
                rig_check.add(frame).map_err(|source| search_failed(frame, source))?;
            }
        }
        match next {
            Next::Frame(frame) if *frame.meta.camera == *camera.name => {
                let result = locate(&frame, &rig, &mut finder)?;
                write_frame(&frame, &result, out).map_err(CommandError::Output)?;
                summary.add(&result);
            }
            Next::Frame(_) | Next::TimedOut => {}
            Next::End => break,
        }
    }
    summary.write(out).map_err(CommandError::Output)?;
    rig_check.verdict().map_err(mismatch)?;
    if summary.lost > 0 {
        return Err(CommandError::Lost {
            lost: summary.lost,
            frames: summary.lost + summary.errors_px.len(),
        });
    }
    Ok(())
}

fn locate(frame: &Frame, rig: &Rig, finder: &mut Finder) -> Result<Result<Located, NoPose>, CommandError> {
    let camera = rig.scene_camera();
    let size = [frame.size.width as usize, frame.size.height as usize];
    let detections = finder
        .find(&frame.pixels, size, camera)
        .map_err(|source| search_failed(frame, source))?;
    Ok(resection::locate(&detections, rig, &camera.intrinsics))
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
