//! `play`: a recording takes the place of the cameras.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use mirrorball_capture::handover::{self, DEFAULT_SERVICE};
use mirrorball_capture::{BadFramePolicy, DEFAULT_MAX_SKEW, Grouper, Pace, Playback, Progress, Repeat, open_recording};

use super::CommandError;

/// How long to wait for a frame or a reader before looking whether to stop.
const STEP_TIMEOUT: Duration = Duration::from_millis(50);

/// Interval of the progress line.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Debug, Args)]
pub(crate) struct PlayArgs {
    /// An MCAP file, or a folder with `rig.toml`, `frames.csv` and the pictures.
    #[arg(value_name = "FILE|DIR")]
    recording: PathBuf,
    /// How fast to play.
    #[arg(long, value_enum, default_value_t = PaceArg::Recorded)]
    pace: PaceArg,
    /// Name of the service to publish on.
    #[arg(long, default_value = DEFAULT_SERVICE)]
    service: String,
    /// Play again and again until stopped.
    #[arg(long, conflicts_with = "repeat")]
    r#loop: bool,
    /// How many times to play in all.
    #[arg(long, value_name = "N", default_value = "1")]
    repeat: NonZeroU32,
    /// Largest difference in time between frames of one set, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = default_max_skew_ms())]
    max_skew_ms: u32,
    /// Do not begin before somebody reads.
    #[arg(long)]
    wait_for_reader: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PaceArg {
    /// As the time stamps say.
    Recorded,
    /// As fast as the pictures can be read.
    Max,
}

/// Plays until the recording ends or `stop` is raised.
pub(crate) fn play(args: &PlayArgs, stop: &AtomicBool) -> Result<(), CommandError> {
    let pace = match args.pace {
        PaceArg::Recorded => Pace::Recorded,
        PaceArg::Max => Pace::Max,
    };
    let repeat = if args.r#loop {
        Repeat::Forever
    } else {
        Repeat::Times(args.repeat)
    };
    let player = open_recording(&args.recording, pace, repeat)?;
    let grouper = Grouper::for_cameras(player.cameras(), Duration::from_millis(args.max_skew_ms.into()));
    let publisher = handover::publish_on(&args.service, player.cameras())?;
    tracing::info!("playing `{}` on service `{}`", args.recording.display(), args.service);
    let mut playback = Playback::new(player, grouper, publisher, BadFramePolicy::Skip);
    if args.wait_for_reader {
        wait_for_reader(&playback, stop);
    }
    let mut last_report = Instant::now();
    while !stop.load(Ordering::Relaxed) && playback.step(STEP_TIMEOUT)? == Progress::Continues {
        if last_report.elapsed() >= REPORT_INTERVAL {
            last_report = Instant::now();
            report(&playback);
        }
    }
    report(&playback);
    Ok(())
}

fn default_max_skew_ms() -> u32 {
    u32::try_from(DEFAULT_MAX_SKEW.as_millis()).expect("the default is a few milliseconds")
}

fn wait_for_reader(playback: &Playback, stop: &AtomicBool) {
    tracing::info!("waiting for a reader");
    while playback.count_readers() == 0 && !stop.load(Ordering::Relaxed) {
        std::thread::sleep(STEP_TIMEOUT);
    }
}

fn report(playback: &Playback) {
    let stats = playback.stats();
    tracing::info!(
        "published {} sets ({} incomplete), skipped {} frames, {} readers",
        stats.publisher.published,
        stats.grouping.incomplete_sets,
        stats.skipped_frames,
        playback.count_readers()
    );
}
