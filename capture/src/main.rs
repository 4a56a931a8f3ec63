//! The capture daemon, and what one needs around it: cameras listed and checked, recordings made, played and converted.

mod commands;

use std::error::Error;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Parser, Subcommand};
use mirrorball_capture::config::{CaptureConfig, LogFormat};
use tracing_subscriber::EnvFilter;

use commands::{CommandError, devices, doctor, export, import, info, play, record, run, status};

/// Drives cameras, records them, and publishes their frames to `mirrorball-render`.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Drives the cameras of a configuration file and publishes their frames.
    Run(run::RunArgs),
    /// Plays a recording as if it were cameras.
    Play(play::PlayArgs),
    /// Lists cameras with their formats and controls.
    Devices(devices::DevicesArgs),
    /// Says what is wrong with a set-up of cameras, and what to do about it.
    Doctor(doctor::DoctorArgs),
    /// Records what the daemon publishes into an MCAP file.
    Record(record::RecordArgs),
    /// Says what a recording holds.
    Info(info::InfoArgs),
    /// Writes an MCAP recording as an image folder.
    Export(export::ExportArgs),
    /// Says how the daemon and its cameras are doing.
    Status(status::StatusArgs),
    /// Writes an image folder as an MCAP recording.
    Import(import::ImportArgs),
}

/// Exit code when the arguments or files are to blame; 1 is for all other failures.
const EXIT_BAD_INPUT: u8 = 2;

fn main() -> ExitCode {
    let cli = Cli::parse();
    if !matches!(cli.command, Command::Run(_)) {
        start_log(LogFormat::Text);
    }
    let result = match &cli.command {
        Command::Run(args) => run(args),
        Command::Devices(args) => return commands::finish(devices::run(args)),
        Command::Doctor(args) => return commands::finish(doctor::run(args)),
        Command::Play(args) => stop_on_signals().and_then(|stop| play::play(args, &stop)),
        Command::Record(args) => stop_on_signals().and_then(|stop| record::record(args, &stop)),
        Command::Info(args) => info::info(args),
        Command::Status(args) => status::status(args),
        Command::Export(args) => export::export(args),
        Command::Import(args) => import::import(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_error(&error);
            if error.is_bad_input() {
                ExitCode::from(EXIT_BAD_INPUT)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}

/// The daemon: its configuration says how it logs.
fn run(args: &run::RunArgs) -> Result<(), CommandError> {
    let config = CaptureConfig::load(&args.config)?;
    if args.check_config {
        return commands::print(&config.describe());
    }
    start_log(config.log);
    let stop = stop_on_signals()?;
    run::run(&config, &args.config, &stop)
}

fn start_log(format: LogFormat) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let is_terminal = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr);
    match format {
        LogFormat::Text => log.with_ansi(is_terminal).with_target(false).init(),
        LogFormat::Json => log.json().init(),
    }
}

/// A flag that SIGTERM and SIGINT raise. The flag guards no other data, so relaxed loads see it soon enough.
fn stop_on_signals() -> Result<Arc<AtomicBool>, CommandError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone()).map_err(CommandError::Signals)?;
    }
    Ok(stop)
}

fn print_error(error: &CommandError) {
    eprintln!("error: {error}");
    let mut cause = error.source();
    while let Some(error) = cause {
        eprintln!("  caused by: {}", error.to_string().trim_end());
        cause = error.source();
    }
    eprintln!("  hint: {}", error.hint());
}
