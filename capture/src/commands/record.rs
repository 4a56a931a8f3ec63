//! `record`: what the daemon publishes, as one more reader, into an MCAP file.
//!
//! The newest set wins, so a set can be missed; that is counted and written down. The daemon itself records without
//! such losses.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use mirrorball_capture::handover::{self, DEFAULT_SERVICE};
use mirrorball_capture::recording::mcap::{
    ChunkCompression, EventKind, Recorded, Recorder, RecorderOptions, RecorderStats, RecordingEvent,
};
use mirrorball_capture::recording::read_cameras;
use mirrorball_capture::{CameraDescription, CameraRole, Frame, FrameSet, Received};

use super::{CommandError, read_rig_text};

/// How long to wait for a set before looking whether to stop.
const STEP_TIMEOUT: Duration = Duration::from_millis(50);

/// Interval of the progress line.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Debug, Args)]
pub(crate) struct RecordArgs {
    /// File to write, which must not exist.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Name of the service to read.
    #[arg(long, default_value = DEFAULT_SERVICE)]
    service: String,
    /// Stop after so many seconds of recording.
    #[arg(long, value_name = "S", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Stop after so many frames of the leading camera.
    #[arg(long, value_name = "N", conflicts_with = "duration")]
    frames: Option<u64>,
    /// Rig file, kept in the recording; gives the cameras' roles. Without it the leading camera has the role `scene`,
    /// every other one `ball`.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Compress with LZ4.
    #[arg(long)]
    lz4: bool,
}

fn parse_duration(text: &str) -> Result<Duration, String> {
    let allowed = "allowed is a number of seconds above 0";
    let seconds: f64 = text.parse().map_err(|_| allowed.to_owned())?;
    let duration = Duration::try_from_secs_f64(seconds).map_err(|_| allowed.to_owned())?;
    if duration.is_zero() {
        Err(allowed.to_owned())
    } else {
        Ok(duration)
    }
}

/// Records until `stop` is raised, or as long as asked for.
pub(crate) fn record(args: &RecordArgs, stop: &AtomicBool) -> Result<(), CommandError> {
    let mut subscriber = handover::subscribe_to(&args.service)?;
    let mut recording = Recording::new(args)?;
    tracing::info!("waiting for frames on service `{}`", args.service);
    let mut last_report = Instant::now();
    // Relaxed: the flag guards no other data.
    while !stop.load(Ordering::Relaxed) && !recording.is_done() {
        match subscriber.receive(STEP_TIMEOUT) {
            Ok(Received::Set(set)) => {
                let stats = subscriber.stats();
                recording.take_set(set, stats.missed, stats.publisher_changes)?;
            }
            Ok(Received::TimedOut) => {}
            Ok(Received::Ended) => break,
            Err(error) if error.is_skippable() => tracing::warn!("{error}"),
            Err(error) => {
                // What has been recorded stays good.
                recording.finish()?;
                return Err(error.into());
            }
        }
        if last_report.elapsed() >= REPORT_INTERVAL {
            last_report = Instant::now();
            recording.report();
        }
    }
    recording.finish()
}

/// A recording under way.
struct Recording<'a> {
    args: &'a RecordArgs,
    rig: Option<Rig>,
    recorder: Option<Recorder>,
    started: Option<Instant>,
    cameras: Vec<Seen>,
    leader_frames: u64,
    missed_sets: u64,
    publisher_changes: u64,
}

struct Rig {
    text: String,
    cameras: Vec<CameraDescription>,
}

/// A camera whose frames have come.
struct Seen {
    description: CameraDescription,
    /// Time stamp and sequence number of the frame that came last, as it came.
    last: Option<(u64, u64)>,
    /// What is added to sequence numbers since a new daemon has begun to count from 0.
    shift: u64,
    /// Sequence number recorded last.
    recorded: u64,
}

impl<'a> Recording<'a> {
    fn new(args: &'a RecordArgs) -> Result<Self, CommandError> {
        let rig = match &args.rig {
            Some(path) => Some(Rig {
                text: read_rig_text(path)?,
                cameras: read_cameras(path)?,
            }),
            None => None,
        };
        Ok(Self {
            args,
            rig,
            recorder: None,
            started: None,
            cameras: Vec::new(),
            leader_frames: 0,
            missed_sets: 0,
            publisher_changes: 0,
        })
    }

    fn is_done(&self) -> bool {
        let is_long = |duration| self.started.is_some_and(|started| started.elapsed() >= duration);
        self.args.frames.is_some_and(|frames| self.leader_frames >= frames)
            || self.args.duration.is_some_and(is_long)
            || self.recorder.as_ref().is_some_and(|recorder| !recorder.is_running())
    }

    fn take_set(&mut self, set: FrameSet, missed: u64, publisher_changes: u64) -> Result<(), CommandError> {
        let Some(leader) = set.frames.first() else {
            return Ok(());
        };
        let timestamp_ns = leader.meta.timestamp_ns;
        self.start(&set)?;
        if missed > self.missed_sets {
            let sets = missed - self.missed_sets;
            self.missed_sets = missed;
            self.event(timestamp_ns, EventKind::MissedSets { sets });
        }
        if publisher_changes > self.publisher_changes {
            self.publisher_changes = publisher_changes;
            let text = "another daemon publishes; sequence numbers go on from the last ones".to_owned();
            self.event(timestamp_ns, EventKind::Note { text });
        }
        for (index, frame) in set.frames.into_iter().enumerate() {
            let role = if index == 0 {
                CameraRole::Scene
            } else {
                CameraRole::Ball
            };
            let is_new = self.take_frame(frame, role)?;
            self.leader_frames += u64::from(is_new && index == 0);
        }
        Ok(())
    }

    /// Creates the file with the first set.
    fn start(&mut self, set: &FrameSet) -> Result<(), CommandError> {
        if self.recorder.is_some() {
            return Ok(());
        }
        let mut cameras = Vec::with_capacity(set.frames.len());
        for (index, frame) in set.frames.iter().enumerate() {
            let role = if index == 0 {
                CameraRole::Scene
            } else {
                CameraRole::Ball
            };
            cameras.push(self.describe(frame, role)?);
        }
        let options = RecorderOptions {
            rig: self.rig.as_ref().map(|rig| rig.text.clone()),
            compression: if self.args.lz4 {
                ChunkCompression::Lz4
            } else {
                ChunkCompression::None
            },
            ..RecorderOptions::default()
        };
        self.recorder = Some(Recorder::create(&self.args.out, &cameras, options)?);
        self.started = Some(Instant::now());
        tracing::info!("recording to `{}`", self.args.out.display());
        Ok(())
    }

    /// What the camera of a frame is; its role is the rig file's, else the one given.
    fn describe(&self, frame: &Frame, role: CameraRole) -> Result<CameraDescription, CommandError> {
        let mut camera = CameraDescription {
            name: frame.meta.camera.clone(),
            role,
            size: frame.size,
            format: frame.format,
        };
        if let Some(rig) = &self.rig {
            let is_same = |other: &&CameraDescription| other.name == camera.name && other.size == camera.size;
            let found = rig.cameras.iter().find(is_same).ok_or_else(|| CommandError::NotInRig {
                camera: camera.name.to_string(),
                width: frame.size.width,
                height: frame.size.height,
            })?;
            camera.role = found.role;
        }
        Ok(camera)
    }

    /// Records a frame unless an earlier set has brought it; true if it is new.
    fn take_frame(&mut self, mut frame: Frame, role: CameraRole) -> Result<bool, CommandError> {
        let place = (frame.meta.timestamp_ns, frame.meta.sequence);
        let index = self
            .cameras
            .iter()
            .position(|seen| seen.description.name == frame.meta.camera);
        let index = match index {
            Some(index) if self.cameras[index].last == Some(place) => return Ok(false),
            Some(index) => index,
            None => {
                self.add_camera(&frame, role)?;
                self.cameras.len() - 1
            }
        };
        let seen = &mut self.cameras[index];
        if let Some(last) = seen.last.replace(place)
            && place.0 > last.0
            && place.1 <= last.1
        {
            // A new daemon counts from 0 again.
            seen.shift = seen.recorded.saturating_add(1).saturating_sub(place.1);
        }
        frame.meta.sequence = frame.meta.sequence.saturating_add(seen.shift);
        seen.recorded = frame.meta.sequence;
        if let Some(recorder) = &mut self.recorder {
            match recorder.record(frame) {
                Recorded::Queued | Recorded::Lost | Recorded::Stopped => {}
            }
        }
        Ok(true)
    }

    fn add_camera(&mut self, frame: &Frame, role: CameraRole) -> Result<(), CommandError> {
        let description = self.describe(frame, role)?;
        if let Some(recorder) = &mut self.recorder
            && !recorder.cameras().any(|camera| camera.name == description.name)
        {
            recorder.add_camera(&description)?;
        }
        self.cameras.push(Seen {
            description,
            last: None,
            shift: 0,
            recorded: 0,
        });
        Ok(())
    }

    fn event(&mut self, timestamp_ns: u64, kind: EventKind) {
        if let Some(recorder) = &mut self.recorder {
            recorder.event(RecordingEvent {
                timestamp_ns,
                camera: None,
                kind,
            });
        }
    }

    fn report(&self) {
        if let Some(recorder) = &self.recorder {
            report(&recorder.stats(), self.missed_sets);
        }
    }

    fn finish(self) -> Result<(), CommandError> {
        let Some(recorder) = self.recorder else {
            let service = self.args.service.clone();
            return Err(CommandError::NothingReceived { service });
        };
        let stats = recorder.finish()?;
        report(&stats, self.missed_sets);
        Ok(())
    }
}

fn report(stats: &RecorderStats, missed_sets: u64) {
    tracing::info!(
        "recorded {} frames, {:.1} MB in {:.1} s ({:.1} MB/s), {} waiting, {} lost, {missed_sets} sets missed",
        stats.frames,
        stats.bytes as f64 / 1e6,
        stats.elapsed_s,
        stats.mean_mb_per_s(),
        stats.queued_frames,
        stats.lost_frames
    );
}
