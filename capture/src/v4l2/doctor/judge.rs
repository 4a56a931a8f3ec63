//! Facts to findings: pure.

use super::{CameraFacts, Facts, Finding, Opened, Severity};
use crate::controls::ControlKind;
use crate::frame::Size;
use crate::v4l2::UsbPlace;

/// Bytes per second that all cameras on one USB 2 bus can have for streams: 80 % of each microframe (USB 2.0, 5.6.4)
/// of 60 MB/s.
const USB2_BUS_BYTES_PER_S: f64 = 48e6;

/// Bytes per second of one camera on USB 2: 3 × 1024 bytes in each of 8000 microframes (USB 2.0, 5.9.2).
const USB2_CAMERA_BYTES_PER_S: f64 = 24.576e6;

/// Speed of USB 2 in Mbit/s.
const USB2_MBIT: u32 = 480;

/// Frames of each camera that may be in shared memory at once: buffers of the driver, of sets under way, of readers.
const FRAMES_IN_SHARED_MEMORY: u64 = 32;

/// Judges the facts: the gravest findings first.
#[must_use]
pub fn diagnose(facts: &Facts) -> Vec<Finding> {
    let mut findings = Vec::new();
    if facts.cameras.is_empty() {
        findings.push(finding(
            Severity::Problem,
            "there is no camera".into(),
            "plug one in; `lsusb` shows what is there",
        ));
    }
    for camera in &facts.cameras {
        judge_camera(camera, facts, &mut findings);
    }
    judge_buses(facts, &mut findings);
    judge_driver(facts, &mut findings);
    judge_shared_memory(facts, &mut findings);
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    findings
}

fn finding(severity: Severity, what: String, remedy: &str) -> Finding {
    Finding {
        severity,
        what,
        remedy: remedy.into(),
    }
}

fn judge_camera(camera: &CameraFacts, facts: &Facts, findings: &mut Vec<Finding>) {
    let name = &camera.address;
    if let Opened::No { what, remedy } = &camera.opened {
        findings.push(finding(Severity::Problem, what.clone(), remedy));
        return;
    }
    if !camera.holders.is_empty() {
        let holders = camera.holders.join(", ");
        let what = format!("camera `{name}` is also open in {holders}");
        findings.push(finding(
            Severity::Warning,
            what,
            "end it: it may stream from the camera or change its controls",
        ));
    }
    let Size { width, height } = facts.size;
    if camera.formats.is_empty() {
        let what = format!("camera `{name}` has no format that we know in {width}x{height}");
        findings.push(finding(
            Severity::Problem,
            what,
            "`mirrorball-capture devices` lists its formats and sizes",
        ));
    }
    for mode in &camera.modes_on {
        let what = format!("camera `{name}`: {mode} is on");
        findings.push(finding(
            Severity::Note,
            what,
            "nothing: the daemon switches it off when it starts",
        ));
    }
    let has_white_balance = camera.controls.contains(&ControlKind::WhiteBalanceTemperature)
        || camera.controls.contains(&ControlKind::RedBalance);
    for (what, is_there) in [
        ("exposure time", camera.controls.contains(&ControlKind::ExposureTime)),
        ("white balance", has_white_balance),
    ] {
        if !is_there {
            let what = format!("camera `{name}` has no control for {what}: it cannot be kept in step with another");
            findings.push(finding(
                Severity::Warning,
                what,
                "use another camera, or one camera alone",
            ));
        }
    }
    if let Some(usb) = &camera.usb
        && usb.speed_mbit < USB2_MBIT
    {
        let what = format!("camera `{name}` runs at {} Mbit/s only", usb.speed_mbit);
        findings.push(finding(
            Severity::Problem,
            what,
            "use another cable, port or hub: USB 2 has 480 Mbit/s",
        ));
    }
}

/// Bytes per second of a camera in its leanest raw format; none if it has only JPEG.
fn raw_bytes_per_s(camera: &CameraFacts, facts: &Facts) -> Option<f64> {
    let sizes = camera.formats.iter().filter_map(|format| format.raw_bytes(facts.size));
    sizes.min().map(|bytes| bytes as f64 * facts.frames_per_s)
}

fn judge_buses(facts: &Facts, findings: &mut Vec<Finding>) {
    let on_usb2: Vec<_> = facts
        .cameras
        .iter()
        .filter_map(|camera| Some((camera, camera.usb.as_ref()?)))
        .filter(|(_, usb)| usb.speed_mbit <= USB2_MBIT)
        .collect();
    let (Size { width, height }, rate) = (facts.size, facts.frames_per_s);
    for (camera, _) in &on_usb2 {
        let Some(needed) = raw_bytes_per_s(camera, facts).filter(|needed| *needed > USB2_CAMERA_BYTES_PER_S) else {
            continue;
        };
        let what = format!(
            "camera `{}` would need {} for raw {width}x{height} at {rate} frames/s, a camera on USB 2 has {}",
            camera.address,
            megabytes(needed),
            megabytes(USB2_CAMERA_BYTES_PER_S)
        );
        findings.push(finding(
            Severity::Warning,
            what,
            "take MJPEG, a smaller size, fewer frames/s or a USB 3 camera",
        ));
    }
    for (index, (_, place)) in on_usb2.iter().enumerate() {
        // Each bus is reported once, by its first camera.
        if on_usb2[..index]
            .iter()
            .any(|(_, other)| other.bus_number == place.bus_number)
        {
            continue;
        }
        let same_bus: Vec<_> = on_usb2
            .iter()
            .filter(|(_, other)| other.bus_number == place.bus_number)
            .collect();
        if same_bus.len() < 2 {
            continue;
        }
        let is_same_hub = same_bus.iter().all(|(_, other)| other.hub == place.hub) && place.hub != root_hub(place);
        let names: Vec<_> = same_bus
            .iter()
            .map(|(camera, _)| format!("`{}`", camera.address))
            .collect();
        let shared = if is_same_hub {
            format!("hub {}", place.hub)
        } else {
            format!("USB bus {}", place.bus_number)
        };
        let raw: f64 = same_bus
            .iter()
            .filter_map(|(camera, _)| raw_bytes_per_s(camera, facts))
            .sum();
        let is_full = raw > USB2_BUS_BYTES_PER_S;
        let severity = if is_full { Severity::Warning } else { Severity::Note };
        let need = if raw > 0.0 {
            format!("; raw they need {}", megabytes(raw))
        } else {
            String::new()
        };
        let what = format!(
            "cameras {} share {shared}, which has {} for all{need}",
            names.join(", "),
            megabytes(USB2_BUS_BYTES_PER_S)
        );
        let remedy = "if one does not start for lack of bandwidth, plug it into a port of another USB controller";
        findings.push(finding(severity, what, remedy));
    }
}

fn root_hub(place: &UsbPlace) -> String {
    format!("usb{}", place.bus_number)
}

fn judge_driver(facts: &Facts, findings: &mut Vec<Finding>) {
    let has_usb_camera = facts.cameras.iter().any(|camera| camera.usb.is_some());
    let Some(settings) = &facts.uvcvideo else { return };
    if !settings.clock.is_empty() && settings.clock != "CLOCK_MONOTONIC" {
        let what = format!("the kernel module `uvcvideo` stamps frames with {}", settings.clock);
        let remedy = "set its parameter `clock` to `CLOCK_MONOTONIC`: other clocks jump";
        findings.push(finding(Severity::Problem, what, remedy));
    }
    if has_usb_camera && !settings.hwtimestamps {
        let what = "the kernel module `uvcvideo` stamps frames when their first packet comes (`hwtimestamps=0`)".into();
        let remedy = "nothing, or try `hwtimestamps=1` with cameras whose clock is good";
        findings.push(finding(Severity::Note, what, remedy));
    }
    if has_usb_camera && !settings.nodrop {
        let what = "the kernel module `uvcvideo` drops frames with errors (`nodrop=0`)".into();
        let remedy = "nothing: they are counted as gaps; with `nodrop=1` they are counted as error frames";
        findings.push(finding(Severity::Note, what, remedy));
    }
}

fn judge_shared_memory(facts: &Facts, findings: &mut Vec<Finding>) {
    // The largest that a frame of this size can be: three bytes per pixel.
    let frame_bytes = facts.size.pixels() as u64 * 3;
    let needed = frame_bytes * FRAMES_IN_SHARED_MEMORY * facts.cameras.len().max(1) as u64;
    let found = facts.shared_memory_free_bytes;
    if found.is_some_and(|free| free >= needed) {
        return;
    }
    let free = found.map_or("does not exist".into(), |free| {
        format!("has {} MB free", free / 1_000_000)
    });
    let what = format!("`/dev/shm` {free}, frames may need {} MB", needed / 1_000_000);
    let severity = if found.is_none() {
        Severity::Problem
    } else {
        Severity::Warning
    };
    findings.push(finding(
        severity,
        what,
        "make it larger: `mount -o remount,size=50% /dev/shm`",
    ));
}

fn megabytes(bytes_per_s: f64) -> String {
    format!("{:.1} MB/s", bytes_per_s / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::controls::AutoMode;
    use crate::v4l2::doctor::UvcSettings;
    use crate::v4l2::{FormatKind, V4l2Error};

    const HD: Size = Size {
        width: 1280,
        height: 720,
    };

    fn camera(address: &str, port: &str) -> CameraFacts {
        let usb = UsbPlace {
            bus: format!("usb-0000:00:14.0-{port}"),
            hub: port
                .rsplit_once('.')
                .map_or("usb1".into(), |(hub, _)| format!("1-{hub}")),
            bus_number: 1,
            speed_mbit: 480,
        };
        CameraFacts {
            address: address.into(),
            opened: Opened::Yes,
            usb: Some(usb),
            holders: Vec::new(),
            formats: vec![FormatKind::Yuyv, FormatKind::Mjpeg],
            controls: vec![
                ControlKind::ExposureTime,
                ControlKind::Gain,
                ControlKind::WhiteBalanceTemperature,
            ],
            modes_on: Vec::new(),
        }
    }

    fn facts(cameras: Vec<CameraFacts>) -> Facts {
        Facts {
            cameras,
            size: Size {
                width: 640,
                height: 480,
            },
            frames_per_s: 30.0,
            uvcvideo: Some(UvcSettings {
                nodrop: true,
                hwtimestamps: true,
                clock: "CLOCK_MONOTONIC".into(),
            }),
            shared_memory_free_bytes: Some(8_000_000_000),
        }
    }

    /// All findings as one text, one per line.
    fn report(facts: &Facts) -> String {
        let lines = diagnose(facts).into_iter();
        lines
            .map(|finding| format!("{:?}: {} -> {}\n", finding.severity, finding.what, finding.remedy))
            .collect()
    }

    #[test]
    fn a_good_set_up_has_no_findings() {
        assert_eq!(report(&facts(vec![camera("a", "1")])), "");
    }

    #[test]
    fn no_camera_at_all() {
        assert!(report(&facts(Vec::new())).starts_with("Problem: there is no camera"));
    }

    #[test]
    fn what_keeps_a_camera_from_opening_is_passed_on_and_ends_its_examination() {
        let error = V4l2Error::NoPermission {
            path: "/dev/video0".into(),
            group: "video".into(),
            source: std::io::ErrorKind::PermissionDenied.into(),
        };
        let opened = Opened::No {
            what: error.to_string(),
            remedy: error.hint(),
        };
        let locked = CameraFacts {
            opened,
            formats: Vec::new(),
            controls: Vec::new(),
            ..camera("/dev/video0", "1")
        };
        let report = report(&facts(vec![locked]));
        assert_eq!(report.lines().count(), 1, "{report}");
        assert!(
            report.contains("group `video`") && report.contains("usermod -aG video"),
            "{report}"
        );
    }

    #[test]
    fn other_programs_automatics_and_missing_controls() {
        let mut shared = camera("a", "1");
        shared.holders = vec!["cheese (process 42)".into()];
        shared.modes_on = vec![AutoMode::WhiteBalance];
        shared.controls = vec![ControlKind::Gain];
        shared.formats = Vec::new();
        let report = report(&facts(vec![shared]));
        for part in [
            "Problem: camera `a` has no format",
            "Warning: camera `a` is also open in cheese (process 42)",
            "no control for exposure time",
            "no control for white balance",
            "Note: camera `a`: automatic white balance is on",
        ] {
            assert!(report.contains(part), "{part} is not in\n{report}");
        }
        assert!(report.starts_with("Problem"), "the gravest comes first:\n{report}");
    }

    #[test]
    fn raw_pictures_that_do_not_fit_on_usb_2() {
        let hd = Facts {
            size: HD,
            ..facts(vec![camera("a", "1")])
        };
        // 1280 × 720 × 2 × 30 = 55.3 MB/s.
        assert!(
            report(&hd).contains("would need 55.3 MB/s for raw 1280x720 at 30 frames/s"),
            "{}",
            report(&hd)
        );
        let mut fast = camera("a", "1");
        fast.usb = fast.usb.map(|usb| UsbPlace {
            speed_mbit: 5000,
            ..usb
        });
        assert_eq!(
            report(&Facts {
                size: HD,
                ..facts(vec![fast])
            }),
            ""
        );
        let mut compressed = camera("a", "1");
        compressed.formats = vec![FormatKind::Mjpeg];
        assert_eq!(
            report(&Facts {
                size: HD,
                ..facts(vec![compressed])
            }),
            ""
        );
    }

    #[test]
    fn two_cameras_on_one_hub_or_bus() {
        let same_hub = facts(vec![camera("a", "4.1"), camera("b", "4.2")]);
        // 640 × 480 × 2 × 30 × 2 = 36.9 MB/s fit into 48.
        assert!(
            report(&same_hub).starts_with("Note: cameras `a`, `b` share hub 1-4"),
            "{}",
            report(&same_hub)
        );
        assert!(
            report(&same_hub).contains("raw they need 36.9 MB/s"),
            "{}",
            report(&same_hub)
        );
        let same_bus = Facts {
            frames_per_s: 60.0,
            ..facts(vec![camera("a", "1"), camera("b", "2")])
        };
        assert!(
            report(&same_bus).contains("Warning: cameras `a`, `b` share USB bus 1"),
            "{}",
            report(&same_bus)
        );
        let mut other_bus = camera("b", "1");
        other_bus.usb = other_bus.usb.map(|usb| UsbPlace {
            bus_number: 3,
            hub: "usb3".into(),
            ..usb
        });
        assert_eq!(report(&facts(vec![camera("a", "1"), other_bus])), "");
    }

    #[test]
    fn slow_cables() {
        let mut slow = camera("a", "1");
        slow.usb = slow.usb.map(|usb| UsbPlace { speed_mbit: 12, ..usb });
        assert!(report(&facts(vec![slow])).contains("Problem: camera `a` runs at 12 Mbit/s only"));
    }

    #[test]
    fn settings_of_the_kernel_module() {
        let uvcvideo = Some(UvcSettings {
            nodrop: false,
            hwtimestamps: false,
            clock: "CLOCK_REALTIME".into(),
        });
        let report = report(&Facts {
            uvcvideo,
            ..facts(vec![camera("a", "1")])
        });
        assert!(report.starts_with("Problem: the kernel module `uvcvideo` stamps frames with CLOCK_REALTIME"));
        assert!(
            report.contains("hwtimestamps=0") && report.contains("nodrop=0"),
            "{report}"
        );
    }

    #[test]
    fn shared_memory() {
        let none = Facts {
            shared_memory_free_bytes: None,
            ..facts(vec![camera("a", "1")])
        };
        assert!(report(&none).starts_with("Problem: `/dev/shm` does not exist"));
        let little = Facts {
            shared_memory_free_bytes: Some(10_000_000),
            ..facts(vec![camera("a", "1")])
        };
        // 640 × 480 × 3 × 32 = 29.5 MB.
        assert!(report(&little).starts_with("Warning: `/dev/shm` has 10 MB free, frames may need 29 MB"));
    }
}
