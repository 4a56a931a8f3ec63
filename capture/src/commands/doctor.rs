//! `doctor`: what is wrong with a set-up of cameras.

use std::io::{self, Write};
use std::process::ExitCode;

use clap::Args;
use mirrorball_capture::Size;
use mirrorball_capture::v4l2::CameraAddress;
use mirrorball_capture::v4l2::doctor::{Severity, diagnose, gather};

#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// Cameras to look at, as `/dev/videoN`, `NAME` or `NAME@usb-PORT`; all there are if none is given.
    #[arg(value_name = "DEVICE")]
    devices: Vec<CameraAddress>,
    /// Width of the pictures to be streamed, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 1280, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    width: u32,
    /// Height of the pictures to be streamed, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 720, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    height: u32,
    /// Frames per second to be streamed.
    #[arg(long, value_name = "HZ", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rate: u32,
}

/// Prints the findings; fails if one of them is a problem.
pub(crate) fn run(args: &DoctorArgs) -> io::Result<ExitCode> {
    let size = Size {
        width: args.width,
        height: args.height,
    };
    let facts = gather(&args.devices, size, args.rate.into());
    let findings = diagnose(&facts);
    let mut out = io::stdout().lock();
    for finding in &findings {
        let severity = match finding.severity {
            Severity::Problem => "problem",
            Severity::Warning => "warning",
            Severity::Note => "note",
        };
        writeln!(out, "{severity}: {}\n  what to do: {}", finding.what, finding.remedy)?;
    }
    let n_cameras = facts.cameras.len();
    let is_bad = findings.iter().any(|finding| finding.severity == Severity::Problem);
    if !is_bad {
        writeln!(out, "no problem found with {n_cameras} cameras")?;
    }
    Ok(if is_bad { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
