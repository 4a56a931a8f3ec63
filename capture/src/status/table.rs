//! A status as lines for people.

use std::fmt::Write as _;

use super::{CameraState, CameraStatus, StampSource, Status};

/// Width of the first column.
const LABEL_WIDTH: usize = 18;

/// The status as a table: one column per camera, then what concerns them all.
#[must_use]
pub fn table(status: &Status) -> String {
    let mut text = format!(
        "mirrorball-capture {}, process {}, up {}, service `{}`\n\n",
        status.version,
        status.pid,
        duration(status.uptime_s),
        status.service
    );
    camera_rows(&mut text, &status.cameras);
    text.push('\n');
    let sets = &status.sets;
    let _ = writeln!(
        text,
        "{:LABEL_WIDTH$}{} published, {} unread, {} incomplete, {} bad",
        "sets", sets.published, sets.unread, sets.incomplete, sets.bad
    );
    let _ = writeln!(text, "{:LABEL_WIDTH$}{}", "readers", sets.readers);
    if let Some(skew) = &status.skew {
        let _ = writeln!(
            text,
            "{:LABEL_WIDTH$}p50 {:.2} ms, p95 {:.2} ms, max {:.2} ms",
            "skew",
            skew.p50_us * 1e-3,
            skew.p95_us * 1e-3,
            skew.max_us * 1e-3
        );
    }
    let recorder = status.recorder.as_ref().map_or_else(
        || "off".to_owned(),
        |recorder| {
            format!(
                "{} frames, {:.1} MB in {}, {} waiting, {} lost",
                recorder.frames,
                recorder.bytes as f64 * 1e-6,
                duration(recorder.elapsed_s),
                recorder.queued_frames,
                recorder.lost_frames
            )
        },
    );
    let _ = writeln!(text, "{:LABEL_WIDTH$}{recorder}", "recorder");
    text
}

/// One row for each thing, one column for each camera, as wide as it must be.
fn camera_rows(text: &mut String, cameras: &[CameraStatus]) {
    let columns: Vec<Vec<(&'static str, String)>> = cameras.iter().map(cells).collect();
    let Some(first) = columns.first() else { return };
    let width = |column: &Vec<(&str, String)>| column.iter().map(|(_, cell)| cell.chars().count()).max();
    let widths: Vec<usize> = columns.iter().map(|column| width(column).unwrap_or(0) + 2).collect();
    for (row, (label, _)) in first.iter().enumerate() {
        let mut line = format!("{label:LABEL_WIDTH$}");
        for (column, width) in columns.iter().zip(&widths) {
            let _ = write!(line, "{:width$}", column[row].1);
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    for camera in cameras {
        if let Some(reason) = &camera.reason {
            let _ = writeln!(text, "\n`{}` is not there: {reason}", camera.name);
        }
    }
}

/// Everything about a camera; the same rows for every camera.
fn cells(camera: &CameraStatus) -> Vec<(&'static str, String)> {
    let state = match camera.state {
        CameraState::WaitingForDevice => "waiting for device",
        CameraState::Restarting => "restarting",
        CameraState::Streaming => "streaming",
    };
    let stamps = camera.stamps.map(|source| match source {
        StampSource::Driver => "driver's",
        StampSource::Mapped => "mapped",
        StampSource::Arrival => "of arrival",
    });
    let rate = match camera.nominal_rate_hz {
        Some(nominal_hz) => format!("{:.2} of {nominal_hz:.2} /s", camera.rate_hz),
        None => or_dash(None),
    };
    let exposure = camera.exposure_s.map(|exposure_s| {
        let warning = if camera.flickers { ", flickers" } else { "" };
        format!("{:.2} ms{warning}", exposure_s * 1e3)
    });
    let white_balance = camera
        .white_balance
        .map(|[red, green, blue]| format!("{red:.3} {green:.3} {blue:.3}"));
    let latency = camera.latency_frames.map(|frames| {
        let doubt = if camera.is_latency_known { "" } else { ", assumed" };
        format!("{frames} frames{doubt}")
    });
    let lost: Vec<String> = camera
        .lost
        .iter()
        .map(|(cause, n_frames)| format!("{n_frames} {}", cause.label()))
        .collect();
    let lost_by = if lost.is_empty() {
        or_dash(None)
    } else {
        lost.join(", ")
    };
    vec![
        ("camera", camera.name.clone()),
        ("state", state.to_owned()),
        ("format", or_dash(camera.format.clone())),
        ("rate", rate),
        ("frames", camera.frames.to_string()),
        ("lost", camera.lost_frames().to_string()),
        ("  by cause", lost_by),
        ("found, restarted", format!("{}, {}", camera.opened, camera.restarts)),
        ("time stamps", or_dash(stamps.map(str::to_owned))),
        ("exposure", or_dash(exposure)),
        ("gain", or_dash(camera.gain.map(|gain| format!("{gain:.3}")))),
        ("white balance", or_dash(white_balance)),
        ("residual", format!("{:+.3} EV", camera.residual_ev)),
        ("latency", or_dash(latency)),
    ]
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "-".to_owned())
}

/// Seconds as hours, minutes and seconds.
fn duration(seconds: f64) -> String {
    let seconds = seconds.max(0.0) as u64;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{hours}:{minutes:02}:{seconds:02}")
}
