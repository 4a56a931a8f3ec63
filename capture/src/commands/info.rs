//! `info`: what a recording holds.

use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use mirrorball_capture::recording::mcap::Ending;
use mirrorball_capture::recording::{CameraReport, RecordingReport, report_on};
use mirrorball_capture::{Next, Pace, Repeat, open_recording};

use super::CommandError;

/// Most gaps of a camera that are printed.
const PRINTED_GAPS: usize = 20;

#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// An MCAP file, or a folder with `rig.toml`, `frames.csv` and the pictures.
    #[arg(value_name = "FILE|DIR")]
    recording: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Read all pictures and check sums too; exit code 2 if any is bad.
    #[arg(long)]
    verify: bool,
}

/// Prints what a recording holds.
pub(crate) fn info(args: &InfoArgs) -> Result<(), CommandError> {
    let report = report_on(&args.recording)?;
    let mut out = io::stdout().lock();
    let printed = if args.json {
        let json = serde_json::to_string_pretty(&report).map_err(io::Error::from);
        json.and_then(|json| writeln!(out, "{json}"))
    } else {
        print_report(&mut out, &report)
    };
    printed.map_err(CommandError::Print)?;
    if args.verify { verify(args) } else { Ok(()) }
}

/// Plays the whole recording and says what is bad.
fn verify(args: &InfoArgs) -> Result<(), CommandError> {
    let mut source = open_recording(&args.recording, Pace::Max, Repeat::ONCE)?;
    let (mut n_frames, mut n_bad) = (0u64, 0u64);
    loop {
        match source.next_frame(Duration::from_secs(1)) {
            Ok(Next::Frame(_)) => n_frames += 1,
            Ok(Next::TimedOut) => {}
            Ok(Next::End) => break,
            Err(error) if error.is_skippable() => {
                n_bad += 1;
                tracing::warn!("{error}");
            }
            Err(error) => return Err(error.into()),
        }
    }
    tracing::info!("{n_frames} frames can be played");
    if n_bad > 0 {
        let path = args.recording.clone();
        return Err(CommandError::Damaged { path, n_bad });
    }
    Ok(())
}

fn print_report(out: &mut impl Write, report: &RecordingReport) -> io::Result<()> {
    let size = report
        .bytes
        .map_or_else(String::new, |bytes| format!(", {:.1} MB", bytes as f64 / 1e6));
    let program = report
        .program
        .as_deref()
        .map_or_else(String::new, |program| format!(", by {program}"));
    writeln!(
        out,
        "{} recording, {:.3} s{size}{program}",
        report.kind, report.duration_s
    )?;
    writeln!(out, "rig file: {}", if report.has_rig { "yes" } else { "no" })?;
    match report.ending {
        Ending::Complete => writeln!(out, "ends: as it should")?,
        Ending::NoSummary => writeln!(
            out,
            "ends: broken off after a whole record; nothing that was written is lost"
        )?,
        Ending::CutOff {
            lost_bytes,
            lost_frames,
        } => writeln!(
            out,
            "ends: cut off; the last {lost_bytes} bytes with at least {lost_frames} frames are not played"
        )?,
    }
    if report.damaged_bytes > 0 {
        writeln!(out, "damaged: {} bytes", report.damaged_bytes)?;
    }
    if report.missed_sets > 0 {
        writeln!(
            out,
            "frame sets that never reached the recorder: {}",
            report.missed_sets
        )?;
    }
    for camera in &report.cameras {
        print_camera(out, camera)?;
    }
    if !report.events.is_empty() {
        writeln!(out, "events: {} (see --json)", report.events.len())?;
    }
    Ok(())
}

fn print_camera(out: &mut impl Write, camera: &CameraReport) -> io::Result<()> {
    let [width, height] = camera.size_px;
    writeln!(
        out,
        "camera `{}`: {}, {width}×{height} {}",
        camera.name, camera.role, camera.format
    )?;
    writeln!(
        out,
        "  {} frames, {:.3} frames/s, longest interval {:.1} ms",
        camera.frames, camera.rate_hz, camera.longest_interval_ms
    )?;
    if camera.bad_frames > 0 {
        writeln!(out, "  {} bad frames", camera.bad_frames)?;
    }
    let causes: Vec<_> = camera
        .lost_by_cause
        .iter()
        .map(|(cause, n)| format!("{cause} {n}"))
        .collect();
    match causes.as_slice() {
        [] => writeln!(out, "  nothing lost")?,
        causes => writeln!(out, "  {} frames lost: {}", camera.lost_frames, causes.join(", "))?,
    }
    for gap in camera.gaps.iter().take(PRINTED_GAPS) {
        let causes: Vec<_> = gap.causes.keys().map(String::as_str).collect();
        writeln!(
            out,
            "    {} after {} at {:.3} s: {}",
            gap.frames,
            gap.after_sequence,
            gap.at_s,
            causes.join(", ")
        )?;
    }
    if camera.n_gaps > PRINTED_GAPS as u64 {
        writeln!(out, "    and {} more gaps", camera.n_gaps - PRINTED_GAPS as u64)?;
    }
    Ok(())
}
