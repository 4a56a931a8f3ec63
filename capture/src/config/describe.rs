//! A configuration in some lines for people: what `--check-config` prints.

use std::fmt::Write as _;
use std::path::Path;

use super::{CameraConfig, CaptureConfig};
use crate::lockstep::{Mains, ManualWhiteBalance, Mode};
use crate::source::CameraRole;
use crate::stamps::StampPolicy;
use crate::v4l2::Method;

pub(super) fn describe(config: &CaptureConfig) -> String {
    let service = &config.service;
    let mut lines = vec![
        format!(
            "service    `{}`, skew up to {} ms",
            service.name,
            service.max_skew.as_secs_f64() * 1e3
        ),
        format!(
            "status     {}",
            path_or(service.status_socket.as_deref(), "the default socket")
        ),
        format!("rig        {}", path_or(config.rig.as_deref(), "none")),
    ];
    lines.extend(config.cameras.iter().map(describe_camera));
    lines.push(format!("lockstep   {}", describe_lockstep(config)));
    let record = config.record.as_ref().map_or_else(
        || "never".to_owned(),
        |record| {
            format!(
                "from the start, into `{}`, queue up to {} MB",
                record.directory.display(),
                record.max_queue_mb
            )
        },
    );
    lines.push(format!("record     {record}"));
    lines.join("\n") + "\n"
}

fn path_or(path: Option<&Path>, otherwise: &str) -> String {
    path.map_or_else(|| otherwise.to_owned(), |path| format!("`{}`", path.display()))
}

fn describe_camera(camera: &CameraConfig) -> String {
    let role = match camera.role {
        CameraRole::Scene => "scene",
        CameraRole::Ball => "ball",
        CameraRole::Fisheye => "fisheye",
    };
    let formats: Vec<String> = camera.formats.iter().map(ToString::to_string).collect();
    let method = match camera.method {
        Method::Auto => "without a copy if it can",
        Method::Mmap => "copied",
        Method::UserPtr => "without a copy",
    };
    let stamps = match camera.stamps {
        StampPolicy::Auto => "checked",
        StampPolicy::Driver => "the driver's",
        StampPolicy::Mapped => "mapped",
    };
    let mut text = format!(
        "camera     `{}` ({role}) is `{}`: {}x{} at {} frames/s, {}, {} buffers, {method}, stamps {stamps}",
        camera.name,
        camera.address,
        camera.size.width,
        camera.size.height,
        camera.rate_hz,
        formats.join(" or "),
        camera.n_buffers,
    );
    if camera.stamp_offset_ns != 0 {
        let _ = write!(text, " {:+} ms", camera.stamp_offset_ns as f64 * 1e-6);
    }
    match camera.latency_frames {
        Some(frames) => _ = write!(text, ", controls show after {frames} frames"),
        None => text.push_str(", latency of controls measured"),
    }
    text
}

fn describe_lockstep(config: &CaptureConfig) -> String {
    let lockstep = &config.lockstep;
    let name = |index: usize| &*config.cameras[index].name;
    let mode = match &lockstep.mode {
        Mode::Locked => "locked at what the cameras have".to_owned(),
        Mode::FollowLeader => format!("all follow `{}`", name(lockstep.leader)),
        Mode::FixedRatio { offsets_ev } => {
            let offsets = offsets_ev.iter().enumerate();
            let offsets: Vec<String> = offsets
                .map(|(index, offset)| format!("`{}` {offset:+} EV", name(index)))
                .collect();
            format!("follow `{}` with {}", name(lockstep.leader), offsets.join(", "))
        }
        Mode::Bracket {
            camera,
            n_steps,
            step_ev,
        } => format!(
            "follow `{}`, `{}` brackets {n_steps} exposures {step_ev} EV apart",
            name(lockstep.leader),
            name(*camera)
        ),
        Mode::Manual {
            exposure_s,
            gain,
            white_balance,
        } => {
            let white_balance = match white_balance {
                ManualWhiteBalance::Kelvin(kelvin) => format!("{kelvin} K"),
                ManualWhiteBalance::Gains([r, g, b]) => format!("white balance {r}, {g}, {b}"),
            };
            format!("manual, {} ms, gain {gain}, {white_balance}", exposure_s * 1e3)
        }
    };
    let mains = match lockstep.mains {
        Mains::Steady => "lamps do not flicker",
        Mains::Hz50 => "lamps on 50 Hz",
        Mains::Hz60 => "lamps on 60 Hz",
    };
    format!("{mode}, exposure up to {} ms, {mains}", lockstep.max_exposure_s * 1e3)
}
