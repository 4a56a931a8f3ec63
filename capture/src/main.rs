//! The daemon: plays a recording as if it were cameras and publishes its frame sets to other processes.

mod commands;

use std::error::Error;
use std::io::IsTerminal;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, Parser, Subcommand, ValueEnum};
use mirrorball_capture::handover::{self, DEFAULT_SERVICE};
use mirrorball_capture::{
    BadFramePolicy, DEFAULT_MAX_SKEW, Grouper, HandoverError, Pace, Playback, Progress, Repeat, open_recording,
};
use tracing_subscriber::EnvFilter;

use commands::CommandError;

mod commands;

/// Publishes frames to `mirrorball-render`.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plays a recording as if it were cameras.
    Play(PlayArgs),
    /// Lists cameras with their formats and controls.
    Devices(commands::devices::DevicesArgs),
    /// Says what is wrong with a set-up of cameras, and what to do about it.
    Doctor(commands::doctor::DoctorArgs),
    /// Records what the daemon publishes into an MCAP file.
    Record(commands::record::RecordArgs),
    /// Says what a recording holds.
    Info(commands::info::InfoArgs),
    /// Writes an MCAP recording as an image folder.
    Export(commands::export::ExportArgs),
    /// Writes an image folder as an MCAP recording.
    Import(commands::import::ImportArgs),
}

#[derive(Debug, Args)]
struct PlayArgs {
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

/// Why the daemon ends.
#[derive(Debug, thiserror::Error)]
enum DaemonError {
    #[error(transparent)]
    Handover(#[from] HandoverError),
    #[error(transparent)]
    Command(#[from] CommandError),
    #[error("cannot install the handlers of SIGTERM and SIGINT")]
    Signals(#[source] std::io::Error),
}

impl DaemonError {
    fn exit_code(&self) -> ExitCode {
        match self {
            Self::Handover(error) if error.is_bad_input() => ExitCode::from(EXIT_BAD_INPUT),
            Self::Command(error) if error.is_bad_input() => ExitCode::from(EXIT_BAD_INPUT),
            Self::Handover(_) | Self::Command(_) | Self::Signals(_) => ExitCode::FAILURE,
        }
    }

    fn hint(&self) -> &'static str {
        match self {
            Self::Handover(error) => error.hint(),
            Self::Command(error) => error.hint(),
            Self::Signals(_) => "run it where processes may handle signals",
        }
    }
}

/// How long the daemon waits for a frame or a reader before it looks whether it should stop.
const STEP_TIMEOUT: Duration = Duration::from_millis(50);

/// Interval of the progress line.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Exit code when the arguments or the recording are to blame; 1 is for all other failures.
const EXIT_BAD_INPUT: u8 = 2;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let is_terminal = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr);
    log.with_ansi(is_terminal).with_target(false).init();
    let result = match cli.command {
        Command::Play(args) => play(&args),
        Command::Devices(args) => return commands::finish(commands::devices::run(&args)),
        Command::Doctor(args) => return commands::finish(commands::doctor::run(&args)),
    let result = match &cli.command {
        Command::Play(args) => play(args),
        Command::Record(args) => record(args),
        Command::Info(args) => commands::info::info(args).map_err(DaemonError::from),
        Command::Export(args) => commands::export::export(args).map_err(DaemonError::from),
        Command::Import(args) => commands::import::import(args).map_err(DaemonError::from),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_error(&error);
            error.exit_code()
        }
    }
}

fn default_max_skew_ms() -> u32 {
    u32::try_from(DEFAULT_MAX_SKEW.as_millis()).expect("the default is a few milliseconds")
}

fn record(args: &commands::record::RecordArgs) -> Result<(), DaemonError> {
    let stop = stop_on_signals().map_err(CommandError::Signals)?;
    Ok(commands::record::record(args, &stop)?)
}

fn play(args: &PlayArgs) -> Result<(), DaemonError> {
    let stop = stop_on_signals().map_err(DaemonError::Signals)?;
    let pace = match args.pace {
        PaceArg::Recorded => Pace::Recorded,
        PaceArg::Max => Pace::Max,
    };
    let repeat = if args.r#loop {
        Repeat::Forever
    } else {
        Repeat::Times(args.repeat)
    };
    let player = open_recording(&args.recording, pace, repeat).map_err(HandoverError::from)?;
    let grouper = Grouper::for_cameras(player.cameras(), Duration::from_millis(args.max_skew_ms.into()));
    let publisher = handover::publish_on(&args.service, player.cameras())?;
    tracing::info!("playing `{}` on service `{}`", args.recording.display(), args.service);
    let mut playback = Playback::new(player, grouper, publisher, BadFramePolicy::Skip);
    if args.wait_for_reader {
        wait_for_reader(&playback, &stop);
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

/// A flag that SIGTERM and SIGINT raise. The flag guards no other data, so relaxed loads see it soon enough.
fn stop_on_signals() -> std::io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    Ok(stop)
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

fn print_error(error: &DaemonError) {
    eprintln!("error: {error}");
    let mut cause = error.source();
    while let Some(error) = cause {
        eprintln!("  caused by: {}", error.to_string().trim_end());
        cause = error.source();
    }
    eprintln!("  hint: {}", error.hint());
}
