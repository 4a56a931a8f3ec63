//! Looks at pictures and recordings with the eyes of the tracker and of the light probe.

mod commands;

use std::{
    error::Error,
    io::{self, Write},
    process::ExitCode,
};

use clap::{Parser, Subcommand};
use tracing_subscriber::EnvFilter;

use commands::{CommandError, ball, check, detect, merge, probe, timing};

/// Markers, cameras and the rig.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Finds the markers in pictures and prints them.
    Detect(detect::Args),
    /// Locates the camera in every frame of a recording and prints how well that went.
    Check(check::Args),
    /// Finds the mirror ball: centre, radius, reflectance.
    Ball(ball::Args),
    /// Merges exposures of one view into a picture of radiance and finds the camera's response.
    Merge(merge::Args),
    /// Measures the light that a picture of the probe shows: map, confidence, lights.
    Probe(probe::Args),
    /// Compares two cameras' clocks, or measures the latency from an event to its picture on a display.
    Timing(timing::Args),
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .init();
    let mut out = io::BufWriter::new(io::stdout().lock());
    let result = match Cli::parse().command {
        Command::Detect(args) => detect::run(&args, &mut out),
        Command::Check(args) => check::run(&args, &mut out),
        Command::Ball(args) => ball::run(&args, &mut out),
        Command::Merge(args) => merge::run(&args, &mut out),
        Command::Probe(args) => probe::run(&args, &mut out),
        Command::Timing(args) => timing::run(&args, &mut out),
    };
    let result = result.and_then(|()| out.flush().map_err(CommandError::Output));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Whoever reads the output may have stopped, and standard error may be closed: nothing is left to say then.
            let _ = out.flush();
            let _ = report(&error, &mut io::stderr().lock());
            error.exit_code()
        }
    }
}

/// Prints an error, its causes and what to do about it.
fn report(error: &CommandError, stderr: &mut impl Write) -> io::Result<()> {
    writeln!(stderr, "error: {error}")?;
    let mut cause = error.source();
    while let Some(source) = cause {
        writeln!(stderr, "  caused by: {source}")?;
        cause = source.source();
    }
    match error.hint() {
        Some(hint) => writeln!(stderr, "  hint: {hint}"),
        None => Ok(()),
    }
}
