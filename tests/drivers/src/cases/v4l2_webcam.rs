//! The V4L2 source on simulated USB webcams: pictures, controls, faults of the bus and of the webcam, unplugging.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use mirrorball_capture::v4l2::doctor::{Severity, diagnose, gather};
use mirrorball_capture::v4l2::{
    AutoMode, Camera, CameraAddress, CameraNode, ControlError, FormatKind, LossCause, Method, PowerLine, StreamError,
    Taken, V4l2Error, list_nodes,
};
use mirrorball_capture::{ControlKind, ControlValues, Size};
use mirrorball_driver_tests::raw_camera::{self, RawCamera};
use mirrorball_driver_tests::webcam::controls::{Control, MANUAL};
use mirrorball_driver_tests::webcam::{FrameFault, Webcam, WebcamConfig, counter};

use super::v4l2_support::{PATIENCE, Running, expect, expect_no_growth, footprint, open, say, settings, wish};
const NAME: &str = "Scene camera";
const VGA: (u32, u32) = (640, 480);
const SMALL: (u32, u32) = (320, 240);
const NODROP: &str = "/sys/module/uvcvideo/parameters/nodrop";

fn plug() -> Result<Webcam, String> {
    Webcam::plug(0, WebcamConfig::named(NAME)).map_err(say)
}

fn start(webcam: &Webcam, method: Method) -> Result<Running, String> {
    let node = webcam.node(PATIENCE).map_err(say)?;
    Running::start(&node, &wish(SMALL, 30.0, &[FormatKind::Yuyv]), method)
}

/// Raw pictures by both methods are those that the webcam sent; a size that is too much for raw comes as JPEG.
pub(super) fn formats() -> Result<(), String> {
    let webcam = plug()?;
    let node = webcam.node(PATIENCE).map_err(say)?;
    for method in [Method::Mmap, Method::UserPtr] {
        let mut running = Running::start(&node, &wish(VGA, 30.0, &[FormatKind::Nv12, FormatKind::Yuyv]), method)?;
        expect(
            running.stream.method() == method,
            "the method asked for",
            running.stream.method(),
        )?;
        let mut before = None;
        for _ in 0..15 {
            let raw = running.frame()?;
            let shown = counter::read_yuyv(&raw.pixels, VGA.0 as usize).ok_or("no counter in the picture")?;
            let truth = webcam.truth_of(shown).ok_or("a frame that was never sent")?;
            expect(raw.is_start_of_exposure(), "stamps of the start", raw.flags)?;
            // The machine is emulated: the driver may sleep for a while before it looks at the first packet.
            let late_ns = raw.timestamp_ns.abs_diff(truth.start_ns);
            expect(late_ns < 500_000_000, "the stamp of its first packet", late_ns)?;
            if let Some((sequence, earlier)) = before {
                let is_next = raw.sequence.wrapping_sub(sequence) == raw.dropped_before + 1;
                expect(
                    is_next && truth.counter > earlier,
                    "the frame after",
                    (sequence, raw.sequence),
                )?;
            }
            before = Some((raw.sequence, truth.counter));
        }
    }
    let formats = [FormatKind::Yuyv, FormatKind::Mjpeg];
    let mut running = Running::start(&node, &wish((1280, 720), 30.0, &formats), Method::Auto)?;
    let expected = "negotiated 1280x720 MJPEG at 30 frames/s; YUYV refused: only 15 frames/s";
    expect(
        running.negotiated.to_string() == expected,
        expected,
        running.negotiated.to_string(),
    )?;
    for _ in 0..2 {
        let raw = running.frame()?;
        let is_jpeg = raw.pixels.starts_with(&[0xff, 0xd8]) && raw.pixels.ends_with(&[0xff, 0xd9]);
        expect(is_jpeg, "a whole JPEG picture", (raw.pixels.len(), raw.bytes_used))?;
    }
    Ok(())
}

/// Everything ours is there with its range and steers the sensor.
pub(super) fn controls() -> Result<(), String> {
    let webcam = plug()?;
    let mut running = start(&webcam, Method::Auto)?;
    let controls = running.camera.controls();
    for kind in [
        ControlKind::ExposureTime,
        ControlKind::Gain,
        ControlKind::WhiteBalanceTemperature,
    ] {
        expect(controls.ranges().get(kind).is_some(), "a range", kind)?;
    }
    expect(
        controls.exposure_unit_s() == Some(1e-4),
        "100 µs",
        controls.exposure_unit_s(),
    )?;
    let modes = controls.take_manual(PowerLine::Hz50).map_err(say)?;
    expect(
        modes == [AutoMode::FrameRate, AutoMode::Exposure, AutoMode::WhiteBalance],
        "three modes",
        &modes,
    )?;
    expect(webcam.control(Control::ExposureMode) == MANUAL, "manual exposure", ())?;
    expect(webcam.control(Control::PowerLineFrequency) == 1, "mains of 50 Hz", ())?;
    for (exposure, gain, kelvin) in [(50, 10, 3000), (200, 0, 6000)] {
        let mut wanted = ControlValues::default();
        wanted.set(ControlKind::ExposureTime, exposure);
        wanted.set(ControlKind::Gain, gain);
        wanted.set(ControlKind::WhiteBalanceTemperature, kelvin);
        let now = controls.set(&wanted).map_err(say)?;
        expect(now == wanted, "values read back", now)?;
        let inside = [Control::ExposureTime, Control::Gain, Control::WhiteBalance].map(|one| webcam.control(one));
        expect(
            inside.map(i64::from) == [exposure, gain, kelvin],
            "the same inside",
            inside,
        )?;
    }
    let mut means = Vec::new();
    for exposure in [20, 160] {
        let mut wanted = ControlValues::default();
        wanted.set(ControlKind::ExposureTime, exposure);
        controls.set(&wanted).map_err(say)?;
        running.count(8)?;
        let raw = running.frame()?;
        means.push(
            raw.pixels.iter().step_by(2).map(|luma| f64::from(*luma)).sum::<f64>() / raw.pixels.len() as f64 * 2.0,
        );
    }
    expect(means[1] > means[0] + 20.0, "a brighter picture", &means)?;
    let mut wanted = ControlValues::default();
    wanted.set(ControlKind::ExposureTime, 1_000_000);
    let error = controls.set(&wanted).err();
    expect(
        matches!(error, Some(ControlError::OutOfRange { .. })),
        "out of range",
        &error,
    )
}

/// A control that stalls gives an error that says so, for each of UVC's error codes, and works again afterwards.
pub(super) fn stalled_controls() -> Result<(), String> {
    let webcam = plug()?;
    let mut running = start(&webcam, Method::Auto)?;
    let controls = running.camera.controls();
    controls.take_manual(PowerLine::Off).map_err(say)?;
    let mut wanted = ControlValues::default();
    for (code, gain) in (1..=8).zip(1..) {
        wanted.set(ControlKind::Gain, gain);
        webcam.stall_control(Control::Gain, Some(code));
        let error = controls.set(&wanted).err();
        let is_right = match (&error, code) {
            (Some(ControlError::Busy { .. }), 1) => true,
            (Some(ControlError::OutOfRange { .. }), 4) => true,
            (Some(ControlError::Refused { .. }), _) => code != 1 && code != 4,
            _ => false,
        };
        expect(is_right, &format!("the refusal of code {code}"), &error)?;
        webcam.stall_control(Control::Gain, None);
        let now = controls.set(&wanted).map_err(say)?;
        expect(
            now.get(ControlKind::Gain) == Some(gain),
            "a control that works again",
            now,
        )?;
    }
    running.count(3).map(|_| ())
}

/// Automatics: they keep us from setting, are seen when another program switches them on, and can be taken back even
/// when the webcam itself switched them on, of which nobody is told.
pub(super) fn automatics() -> Result<(), String> {
    let webcam = plug()?;
    let mut running = start(&webcam, Method::Auto)?;
    let controls = running.camera.controls();
    controls.take_manual(PowerLine::Off).map_err(say)?;
    let other = RawCamera::open(&webcam.node(PATIENCE).map_err(say)?).map_err(say)?;
    for (id, on, mode, kind) in [
        (
            raw_camera::EXPOSURE_MODE,
            3,
            AutoMode::Exposure,
            ControlKind::ExposureTime,
        ),
        (
            raw_camera::WHITE_BALANCE_AUTO,
            1,
            AutoMode::WhiteBalance,
            ControlKind::WhiteBalanceTemperature,
        ),
    ] {
        other.set_control(id, on).map_err(say)?;
        let deadline = Instant::now() + PATIENCE;
        let seen = loop {
            match running.next().map_err(say)? {
                Taken::ControlChanged(change) if change.switched_on().is_some() => break change.switched_on(),
                _ if Instant::now() > deadline => break None,
                _ => {}
            }
        };
        expect(
            seen == Some(mode),
            "the automatic mode switched on behind our back",
            seen,
        )?;
        expect(controls.modes_on().map_err(say)? == [mode], "this mode on", ())?;
        let mut wanted = ControlValues::default();
        wanted.set(kind, controls.ranges().get(kind).ok_or("no range")?.minimum);
        let error = controls.set(&wanted).err();
        expect(
            matches!(error, Some(ControlError::AutoStillOn { .. })),
            "automatic still on",
            &error,
        )?;
        controls.take_manual(PowerLine::Off).map_err(say)?;
        controls.set(&wanted).map_err(say)?;
    }
    webcam.switch_automatics_on();
    controls.take_manual(PowerLine::Off).map_err(say)?;
    let inside = (
        webcam.control(Control::ExposureMode),
        webcam.control(Control::WhiteBalanceAuto),
    );
    expect(inside == (MANUAL, 0), "automatics taken back", inside)
}

/// As the driver is set by default it drops damaged frames: gaps, each counted. What the sensor loses leaves none.
pub(super) fn dropped_errors() -> Result<(), String> {
    fs::write(NODROP, "0").map_err(say)?;
    let webcam = plug()?;
    let mut running = start(&webcam, Method::UserPtr)?;
    running.count(5)?.check_sum()?;
    for (fault, n_expected) in [
        (FrameFault::ErrorBit, 3),
        (FrameFault::Short, 3),
        (FrameFault::LostInSensor, 0),
    ] {
        webcam.befall(fault, 3);
        let mut before = running.frame()?;
        let mut n_dropped = before.dropped_before;
        for _ in 0..12 {
            let raw = running.frame()?;
            expect(
                raw.sequence.wrapping_sub(before.sequence) == raw.dropped_before + 1,
                "counted gaps",
                raw.sequence,
            )?;
            n_dropped += raw.dropped_before;
            before = raw;
        }
        expect(
            n_dropped == n_expected,
            &format!("{n_expected} dropped after {fault:?}"),
            n_dropped,
        )?;
    }
    Ok(())
}

/// With `nodrop=1` damaged frames are delivered: they are losses with a cause, never frames.
pub(super) fn delivered_errors() -> Result<(), String> {
    fs::write(NODROP, "1").map_err(say)?;
    let result = (|| {
        let webcam = plug()?;
        for method in [Method::Mmap, Method::UserPtr] {
            let mut running = start(&webcam, method)?;
            running.count(5)?;
            for fault in [FrameFault::ErrorBit, FrameFault::Short] {
                webcam.befall(fault, 3);
                let counts = running.count(12)?;
                counts.check_sum()?;
                let is_right = counts.losses.len() == 3
                    && counts
                        .losses
                        .iter()
                        .all(|cause| matches!(cause, LossCause::ErrorFlag | LossCause::Short { .. }));
                expect(is_right, &format!("three losses by {fault:?}"), &counts)?;
            }
        }
        Ok(())
    })();
    fs::write(NODROP, "0").map_err(say)?;
    result
}

/// A failed transfer empties all buffers, and the stream goes on with what transfers it has left. When all have
/// failed it is stuck: an error that asks for a restart, which heals.
pub(super) fn transfer_error() -> Result<(), String> {
    let webcam = plug()?;
    for method in [Method::Mmap, Method::UserPtr] {
        let mut running = start(&webcam, method)?;
        running.count(5)?;
        webcam.befall(FrameFault::TransferError, 1);
        let counts = running.count(15)?;
        let is_right = !counts.losses.is_empty() && counts.losses.iter().all(|cause| *cause == LossCause::Empty);
        expect(is_right, "empty buffers and a stream that goes on", &counts)?;
        webcam.befall(FrameFault::TransferError, 20);
        let (error, counts) = running.until_failure()?;
        println!(
            "    {method}: {} frames, {} losses, {error}",
            counts.n_frames,
            counts.losses.len()
        );
        let is_right = matches!(error, StreamError::OnlyErrors { .. } | StreamError::Stuck { .. });
        expect(is_right && error.is_restartable(), "a stream to restart", &error)?;
        let healed = (0..30).find_map(|_| {
            running.stream.restart().ok()?;
            running.count(10).ok()
        });
        expect(healed.is_some(), "a healed stream", ())?;
    }
    Ok(())
}

/// A webcam that hangs gives timeouts, however many, and the stream goes on when it does.
pub(super) fn hang() -> Result<(), String> {
    let webcam = plug()?;
    let mut running = start(&webcam, Method::Auto)?;
    running.count(5)?;
    webcam.hang(true);
    let mut n_timeouts = 0;
    for _ in 0..12 {
        let taken = running
            .stream
            .next(&mut running.pool, Duration::from_millis(100))
            .map_err(say)?;
        n_timeouts += usize::from(matches!(taken, Taken::TimedOut));
    }
    webcam.hang(false);
    expect(n_timeouts >= 6, "timeouts", n_timeouts)?;
    let counts = running.count(10)?;
    expect(counts.losses.is_empty(), "a stream that goes on", &counts)
}

/// A JPEG picture that is cut off is a frame as long as it is: only decoding can tell. The stream goes on.
pub(super) fn cut_jpeg() -> Result<(), String> {
    let webcam = plug()?;
    let node = webcam.node(PATIENCE).map_err(say)?;
    let mut running = Running::start(&node, &wish(SMALL, 30.0, &[FormatKind::Mjpeg]), Method::Auto)?;
    running.count(5)?;
    webcam.befall(FrameFault::Short, 2);
    let mut n_cut = 0;
    for _ in 0..12 {
        let raw = running.frame()?;
        expect(
            raw.pixels.len() == raw.bytes_used as usize,
            "as many bytes as came",
            raw.pixels.len(),
        )?;
        n_cut += usize::from(!raw.pixels.ends_with(&[0xff, 0xd9]));
    }
    expect(n_cut == 2, "two cut pictures", n_cut)
}

/// Unplugged while streaming: said at once. Plugged in again: found by its address under another node number, while
/// the old node is still open and afterwards; nothing is left behind.
pub(super) fn unplug() -> Result<(), String> {
    let mut webcam = plug()?;
    let address: CameraAddress = format!("{NAME}: {NAME}").parse().map_err(say)?;
    let address = if Camera::open(&address).is_ok() {
        address
    } else {
        NAME.parse().map_err(say)?
    };
    let mut before = None;
    for round in 0..6 {
        let method = if round % 2 == 0 { Method::Mmap } else { Method::UserPtr };
        let mut running = start(&webcam, method)?;
        running.count(5)?;
        let old_path = running.camera.path().to_path_buf();
        let held = running.frame()?;
        webcam.unplug();
        let began = Instant::now();
        let (error, _) = running.until_failure()?;
        let noticed = began.elapsed();
        expect(
            matches!(error, StreamError::Unplugged { .. }),
            "an unplugged camera",
            &error,
        )?;
        let error = running.camera.controls().read().err();
        expect(
            matches!(error, Some(ControlError::Unplugged { .. })),
            "controls that know it",
            &error,
        )?;
        let began = Instant::now();
        webcam.replug().map_err(say)?;
        // In every other round the old node stays open, which makes the number another.
        let kept = if round % 2 == 0 { Some(running) } else { None };
        let (camera, found) = find_again(&address, began)?;
        println!(
            "    noticed after {noticed:?}, back after {found:?}: {} -> {}",
            old_path.display(),
            camera.path().display()
        );
        if kept.is_some() {
            expect(camera.path() != old_path, "another node number", camera.path())?;
        }
        drop((camera, kept));
        start(&webcam, method)?.count(5)?;
        expect(
            !held.pixels.is_empty(),
            "a frame that outlives its camera",
            held.sequence,
        )?;
        drop(held);
        if round == 1 {
            before = Some(footprint());
        }
    }
    expect_no_growth(before.ok_or("two rounds")?, footprint())
}

/// Opens a camera as soon as it is there.
fn find_again(address: &CameraAddress, began: Instant) -> Result<(Camera, Duration), String> {
    loop {
        match Camera::open(address) {
            Ok(camera) => return Ok((camera, began.elapsed())),
            Err(error) if began.elapsed() > PATIENCE => return Err(say(error)),
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// Cameras of the same name are told apart by port; metadata nodes are not cameras; the doctor knows the bus.
pub(super) fn addresses() -> Result<(), String> {
    let webcams = [plug()?, Webcam::plug(1, WebcamConfig::named(NAME)).map_err(say)?];
    for webcam in &webcams {
        webcam.node(PATIENCE).map_err(say)?;
    }
    let nodes: Vec<CameraNode> = list_nodes().into_iter().filter(|node| node.usb.is_some()).collect();
    let (cameras, metadata): (Vec<_>, Vec<_>) = nodes.iter().partition(|node| node.index == 0);
    expect(
        cameras.len() == 2 && metadata.len() == 2,
        "two cameras with a metadata node each",
        &nodes,
    )?;
    for camera in &cameras {
        let opened = Camera::open(&camera.address()).map_err(say)?;
        expect(opened.path() == camera.path, "the camera at this port", opened.path())?;
        let bus = camera.usb.as_ref().map(|usb| usb.bus.as_str());
        expect(
            bus == Some(opened.bus()),
            "the bus that the driver names",
            (bus, opened.bus()),
        )?;
    }
    let name: CameraAddress = cameras[0].name.parse().map_err(say)?;
    let error = Camera::open(&name).err();
    expect(
        matches!(error, Some(V4l2Error::Ambiguous { .. })),
        "two of this name",
        &error,
    )?;
    let error = open(&metadata[0].path).err();
    expect(
        error.as_ref().is_some_and(|text| text.contains("metadata")),
        "a metadata node",
        &error,
    )?;
    judge(&cameras[0].path, &cameras[1].path)
}

fn judge(first: &Path, second: &Path) -> Result<(), String> {
    let addresses = [first, second].map(|path| CameraAddress::Path(path.into()));
    let findings = diagnose(&gather(
        &addresses,
        Size {
            width: 640,
            height: 480,
        },
        30.0,
    ));
    let has = |severity: Severity, part: &str| {
        findings
            .iter()
            .any(|finding| finding.severity == severity && finding.what.contains(part))
    };
    expect(has(Severity::Note, "share USB bus"), "a shared bus", &findings)?;
    expect(
        has(Severity::Note, "automatic exposure is on"),
        "automatics that are on",
        &findings,
    )?;
    expect(!has(Severity::Problem, ""), "no problem", &findings)?;
    let mut camera = open(first)?;
    let negotiated = camera.negotiate(&wish(SMALL, 30.0, &[FormatKind::Yuyv])).map_err(say)?;
    let mut pool = mirrorball_capture::pool::HeapPool::new(8, negotiated.buffer_bytes());
    let stream = camera
        .start(&negotiated, settings(Method::Auto), &mut pool)
        .map_err(say)?;
    let error = camera.start(&negotiated, settings(Method::Mmap), &mut pool).err();
    drop(stream);
    expect(
        matches!(error, Some(StreamError::Busy { .. })),
        "a camera that streams already",
        &error,
    )
}
