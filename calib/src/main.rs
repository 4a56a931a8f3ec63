//! Looks at pictures and recordings with the eyes of the tracker and of the light probe.

mod commands;

use std::{
    error::Error,
    io::{self, Write},
    process::ExitCode,
};

use clap::{Parser, Subcommand};
use tracing_subscriber::EnvFilter;

use commands::{
    CommandError, ball, check, color, convert, detect, display, extrinsics, hand_eye, intrinsics, markers, merge,
    photometric, probe, timing,
};

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
    /// Finds a camera's lens from pictures of a board.
    Intrinsics(intrinsics::Args),
    /// Finds where markers are to each other, from pictures that show several at a time.
    Markers(markers::Args),
    /// Finds where fixed cameras stand, or where one camera is beside another, from markers.
    Extrinsics(extrinsics::Args),
    /// Finds the mirror ball: centre, radius, reflectance.
    Ball(ball::Args),
    /// Converts cameras between rig files and those of OpenCV, ROS and Kalibr.
    Convert(convert::Args),
    /// Finds where a camera is on a headset that another system tracks.
    HandEye(hand_eye::Args),
    /// Finds eye and display of a see-through headset: shows crosses, and solves for what was aligned with them.
    Display(display::Args),
    /// Merges exposures of one view into a picture of radiance and finds the camera's response.
    Merge(merge::Args),
    /// Measures the light that a picture of the probe shows: map, confidence, lights.
    Probe(probe::Args),
    /// Measures a camera's response, noise, vignetting, black level, true exposures and control latency.
    Photometric(photometric::Args),
    /// Measures the colour matrix between two cameras from patches that both see.
    Color(color::Args),
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
        Command::Intrinsics(args) => intrinsics::run(&args, &mut out),
        Command::Markers(args) => markers::run(&args, &mut out),
        Command::Extrinsics(args) => extrinsics::run(&args, &mut out),
        Command::Ball(args) => ball::run(&args, &mut out),
        Command::Convert(args) => convert::run(&args, &mut out),
        Command::HandEye(args) => hand_eye::run(&args, &mut out),
        Command::Display(args) => display::run(&args, &mut out),
        Command::Merge(args) => merge::run(&args, &mut out),
        Command::Probe(args) => probe::run(&args, &mut out),
        Command::Photometric(args) => photometric::run(&args, &mut out),
        Command::Color(args) => color::run(&args, &mut out),
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

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::Cli;

    #[test]
    fn options_of_all_commands_fit_together() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_camera_is_one_input_among_others() {
        let parse = |line: &str| {
            let words = ["mirrorball-calib"].into_iter().chain(line.split(' '));
            Cli::command().try_get_matches_from(words).map(|_| ())
        };
        assert!(parse("detect a.png").is_ok());
        assert!(parse("detect --device vivid --size 640x480 --frames 3").is_ok());
        for line in [
            "detect",
            "detect --device vivid",
            "detect a.png --frames 3",
            "detect a.png --device vivid --size 640x480",
            "detect --device vivid --size 640",
            "detect --device vivid --size 640x480 --seconds 0",
        ] {
            assert!(parse(line).is_err(), "{line}");
        }
    }
}
