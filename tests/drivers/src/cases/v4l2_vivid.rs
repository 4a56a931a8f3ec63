//! The V4L2 source on the kernel's virtual camera: formats, both ways of taking pictures, controls, every fault.

use std::path::{Path, PathBuf};
use std::time::Duration;

use mirrorball_capture::v4l2::{
    AutoMode, ControlError, FormatKind, LossCause, Method, StampClock, StreamError, Taken, V4l2Error, Watched,
};
use mirrorball_capture::{ControlKind, ControlValues, pool::HeapPool};
use mirrorball_driver_tests::raw_camera::{self, RawCamera};
use mirrorball_driver_tests::vivid::{self, VividFault};

use super::v4l2_support::{
    Counts, Running, expect, expect_no_growth, footprint, free_buffers, open, say, settings, wish,
};

/// `V4L2_CID_AUTOGAIN`.
const AUTOGAIN: u32 = 0x0098_0912;
pub(super) const SIZE: (u32, u32) = (320, 180);
const METHODS: [Method; 2] = [Method::Mmap, Method::UserPtr];

fn node() -> Result<PathBuf, String> {
    vivid::nodes()
        .into_iter()
        .next()
        .ok_or_else(|| "there is no vivid camera".to_owned())
}

fn start(method: Method) -> Result<Running, String> {
    Running::start(&node()?, &wish(SIZE, 60.0, &[FormatKind::Yuyv]), method)
}

pub(super) fn set(fault: VividFault, value: i32) -> Result<(), String> {
    let camera = RawCamera::open(&node()?).map_err(say)?;
    vivid::set(&camera, fault, value).map_err(say)
}

/// Every raw format by both methods: the right length, rising numbers and stamps, the same picture.
pub(super) fn formats() -> Result<(), String> {
    for kind in [FormatKind::Yuyv, FormatKind::Nv12, FormatKind::Grey] {
        let mut means = Vec::new();
        for method in METHODS {
            let mut running = Running::start(&node()?, &wish(SIZE, 60.0, &[kind]), method)?;
            expect(
                running.stream.method() == method,
                "the method asked for",
                running.stream.method(),
            )?;
            let raw = running.frame()?;
            expect(
                raw.pixels.len() == running.negotiated.format.max_bytes(running.negotiated.size),
                "a whole picture",
                raw.pixels.len(),
            )?;
            expect(raw.clock() == StampClock::Monotonic, "monotonic stamps", raw.clock())?;
            means.push(raw.pixels.iter().map(|byte| f64::from(*byte)).sum::<f64>() / raw.pixels.len() as f64);
            drop(raw);
            let counts = running.count(20)?;
            counts.check_sum()?;
            expect(
                counts.losses.is_empty() && counts.n_stamps_back == 0,
                "an undisturbed stream",
                &counts,
            )?;
        }
        // Moving text covers a few pixels.
        let is_same = (means[0] - means[1]).abs() < 2.0 && means[0] > 16.0;
        expect(is_same, &format!("the same {kind} picture by both methods"), &means)?;
    }
    Ok(())
}

/// What cannot be had is refused with reasons, and a camera that streams is not given away twice.
pub(super) fn refusals() -> Result<(), String> {
    let mut camera = open(&node()?)?;
    let error = camera.negotiate(&wish(SIZE, 60.0, &[FormatKind::Mjpeg])).err();
    let is_right = matches!(&error, Some(V4l2Error::FormatRefused { refusals, .. }) if refusals.len() == 1);
    expect(is_right, "no MJPEG", &error)?;
    let negotiated = camera
        .negotiate(&wish((640, 480), 30.0, &[FormatKind::Nv12]))
        .map_err(say)?;
    expect(
        negotiated.frames_per_s().is_some_and(|rate| (rate - 25.0).abs() < 0.01),
        "25 frames/s",
        &negotiated,
    )?;
    let mut small = HeapPool::new(8, 100);
    let error = camera.start(&negotiated, settings(Method::Auto), &mut small).err();
    expect(
        matches!(error, Some(StreamError::PoolTooSmall { .. })),
        "a pool that is too small",
        &error,
    )?;

    let mut running = start(Method::Mmap)?;
    running.frame()?;
    let mut other = open(&node()?)?;
    let error = other.negotiate(&wish((640, 480), 25.0, &[FormatKind::Nv12])).err();
    expect(matches!(error, Some(V4l2Error::Busy { .. })), "a busy camera", &error)
}

/// The pool runs dry: frames are counted as overruns, the driver keeps its buffers, and it goes on afterwards.
pub(super) fn overrun() -> Result<(), String> {
    for method in METHODS {
        let mut running = start(method)?;
        let mut held = Vec::new();
        let loss = loop {
            match running.next().map_err(say)? {
                Taken::Frame(raw) => held.push(raw),
                Taken::Lost(loss) => break loss,
                other => return Err(format!("expected frames, found {other:?}")),
            }
        };
        expect(loss.cause == LossCause::Overrun, "an overrun", loss)?;
        let expected = if method == Method::UserPtr { 6 } else { 10 };
        expect(
            held.len() == expected,
            &format!("{expected} frames before the overrun"),
            held.len(),
        )?;
        drop(held);
        let counts = running.count(10)?;
        expect(counts.losses.is_empty(), "no overrun with buffers free", &counts)?;
        let Running { stream, mut pool, .. } = running;
        drop(stream);
        let n_free = free_buffers(&mut pool);
        expect(n_free == 10, "all 10 buffers back in the pool", n_free)?;
    }
    Ok(())
}

/// Gain and automatic gain: ranges, values read back, refusals, and other programs' changes as events.
pub(super) fn controls() -> Result<(), String> {
    let mut running = start(Method::Auto)?;
    let controls = running.camera.controls();
    let range = controls.ranges().get(ControlKind::Gain).ok_or("vivid has a gain")?;
    expect(
        (range.minimum, range.maximum) == (0, 255),
        "a gain from 0 to 255",
        range,
    )?;
    expect(
        controls.ranges().get(ControlKind::ExposureTime).is_none(),
        "no exposure time",
        controls.ranges(),
    )?;
    let modes = controls
        .take_manual(mirrorball_capture::v4l2::PowerLine::Hz50)
        .map_err(say)?;
    expect(modes.contains(&AutoMode::Gain), "automatic gain to switch off", &modes)?;
    expect(controls.modes_on().map_err(say)?.is_empty(), "no mode on", ())?;
    let mut wanted = ControlValues::default();
    wanted.set(ControlKind::Gain, 77);
    let now = controls.set(&wanted).map_err(say)?;
    expect(now.get(ControlKind::Gain) == Some(77), "77 read back", now)?;
    wanted.set(ControlKind::Gain, 256);
    let error = controls.set(&wanted).err();
    expect(
        matches!(error, Some(ControlError::OutOfRange { value: 256, .. })),
        "out of range",
        &error,
    )?;
    let mut missing = ControlValues::default();
    missing.set(ControlKind::ExposureTime, 1);
    let error = controls.set(&missing).err();
    expect(
        matches!(error, Some(ControlError::Missing { .. })),
        "a missing control",
        &error,
    )?;

    // What we set ourselves makes no event; what another program sets does.
    let other = RawCamera::open(&node()?).map_err(say)?;
    other.set_control(AUTOGAIN, 1).map_err(say)?;
    let change = next_change(&mut running)?;
    expect(
        change.switched_on() == Some(AutoMode::Gain),
        "automatic gain switched on behind our back",
        change,
    )?;
    expect(
        controls.modes_on().map_err(say)? == [AutoMode::Gain],
        "automatic gain on",
        (),
    )?;
    other.set_control(AUTOGAIN, 0).map_err(say)?;
    let change = next_change(&mut running)?;
    expect(
        change.switched_on().is_none() && change.value == 0,
        "automatic gain switched off",
        change,
    )?;
    other.set_control(raw_camera::GAIN, 12).map_err(say)?;
    let change = next_change(&mut running)?;
    expect(
        change.what == Watched::Control(ControlKind::Gain) && change.value == 12,
        "gain 12",
        change,
    )
}

fn next_change(running: &mut Running) -> Result<mirrorball_capture::v4l2::ControlChange, String> {
    for _ in 0..200 {
        if let Taken::ControlChanged(change) = running.next().map_err(say)? {
            return Ok(change);
        }
    }
    Err("no change of a control was seen".into())
}

/// `devices` lists all of vivid's controls, of kinds that the crate `v4l` panics on as well.
pub(super) fn control_list() -> Result<(), String> {
    let all = open(&node()?)?.controls().list().map_err(say)?;
    let unknown = all.iter().filter(|control| control.kind.starts_with("type ")).count();
    let menus = all.iter().filter(|control| !control.menu.is_empty()).count();
    let unnamed = all.iter().filter(|control| control.name.is_empty()).count();
    expect(
        all.len() > 40 && unknown > 0 && menus > 2 && unnamed == 0,
        "all controls",
        (all.len(), unknown, menus),
    )
}

/// 30 % dropped: gaps only, all counted. 100 %: timeouts only, and the stream goes on afterwards.
pub(super) fn dropped() -> Result<(), String> {
    for method in METHODS {
        let mut running = start(method)?;
        running.count(5)?;
        set(VividFault::DroppedPercent, 30)?;
        let counts = running.count(60)?;
        set(VividFault::DroppedPercent, 0)?;
        counts.check_sum()?;
        expect(counts.n_dropped > 5 && counts.losses.is_empty(), "gaps", &counts)?;
        set(VividFault::DroppedPercent, 100)?;
        let mut n_timeouts = 0;
        // Frames that were under way still come.
        for _ in 0..12 {
            let taken = running
                .stream
                .next(&mut running.pool, Duration::from_millis(100))
                .map_err(say)?;
            n_timeouts += usize::from(matches!(taken, Taken::TimedOut));
        }
        set(VividFault::DroppedPercent, 0)?;
        expect(n_timeouts >= 5, "timeouts", n_timeouts)?;
        let raw = running.frame()?;
        expect(raw.dropped_before > 5, "the gap after the timeouts", raw.dropped_before)?;
        running.count(5)?.check_sum()?;
    }
    Ok(())
}

/// A frame flagged as damaged is lost, never a frame, and it is one frame.
pub(super) fn flag_error() -> Result<(), String> {
    for method in METHODS {
        let mut running = start(method)?;
        running.count(3)?;
        set(VividFault::FlagError, 1)?;
        let counts = running.count(15)?;
        counts.check_sum()?;
        expect(counts.losses == [LossCause::ErrorFlag], "one error frame", &counts)?;
    }
    Ok(())
}

/// A fatal error ends the stream; the same open device streams again after a restart.
pub(super) fn fatal() -> Result<(), String> {
    for method in METHODS {
        let mut running = start(method)?;
        running.count(3)?;
        set(VividFault::Fatal, 1)?;
        let (error, _) = running.until_failure()?;
        expect(
            matches!(error, StreamError::Failed { .. }) && error.is_restartable(),
            "a failed stream",
            &error,
        )?;
        let again = running.next();
        expect(
            matches!(again, Err(StreamError::Failed { .. })),
            "a stream that stays failed",
            &again,
        )?;
        running.stream.restart().map_err(say)?;
        let counts = running.count(20)?;
        expect(
            counts.losses.is_empty() && counts.n_timeouts == 0,
            "a stream as new",
            &counts,
        )?;
    }
    Ok(())
}

/// Errors of single calls: each is reported or healed, and the next attempt works.
pub(super) fn refused_calls() -> Result<(), String> {
    for method in METHODS {
        set(VividFault::RequestBuffers, 1)?;
        let error = start(method).err();
        expect(error.is_some(), "no buffers", &error)?;
        set(VividFault::StreamOn, 1)?;
        let error = start(method).err();
        expect(
            error.as_ref().is_some_and(|text| text.contains("start the stream")),
            "no start",
            &error,
        )?;
        let mut running = start(method)?;
        running.count(3)?;
        set(VividFault::Queue, 1)?;
        let counts = running.count(30)?;
        counts.check_sum()?;
        expect(counts.n_timeouts == 0, "a stream that goes on", &counts)?;
        // The refused buffer was offered again: with three of four a slow reader would lose more, not less.
        set(VividFault::StreamOn, 1)?;
        expect(running.stream.restart().is_err(), "a restart that fails", ())?;
        running.stream.restart().map_err(say)?;
        running.count(5)?;
    }
    Ok(())
}

/// Numbers that wrap at 2³² leave no gap.
pub(super) fn wrap_sequence() -> Result<(), String> {
    set(VividFault::WrapSequence, 1)?;
    let counts = start(Method::Auto).and_then(|mut running| running.count(200));
    set(VividFault::WrapSequence, 0)?;
    let counts = counts?;
    counts.check_sum()?;
    let has_wrapped =
        counts.first.is_some_and(|first| first > u32::MAX - 129) && counts.last.is_some_and(|last| last < 200);
    expect(has_wrapped && counts.n_dropped < 100, "numbers that wrap", &counts)
}

/// 10,000 frames over several cameras, both methods: as many open files and as much memory as before.
pub(super) fn ten_thousand_frames() -> Result<(), String> {
    const CAMERAS: usize = 8;
    vivid::reload_with(CAMERAS).map_err(say)?;
    let nodes = vivid::nodes();
    expect(nodes.len() == CAMERAS, "as many cameras", &nodes)?;
    let all = |n_frames: usize| -> Result<Vec<Counts>, String> {
        std::thread::scope(|scope| {
            let one = |index: usize, node: &Path| {
                let method = METHODS[index % 2];
                Running::start(node, &wish(SIZE, 60.0, &[FormatKind::Grey]), method)?.count(n_frames)
            };
            let threads: Vec<_> = nodes
                .iter()
                .enumerate()
                .map(|(index, node)| scope.spawn(move || one(index, node)))
                .collect();
            threads
                .into_iter()
                .map(|thread| thread.join().map_err(|_| "it panicked".to_owned())?)
                .collect()
        })
    };
    all(20)?;
    let before = footprint();
    let counts = all(10_000 / CAMERAS)?;
    let after = footprint();
    for counts in &counts {
        counts.check_sum()?;
    }
    let n_dropped: u64 = counts.iter().map(|counts| counts.n_dropped).sum();
    println!("    {before:?} -> {after:?}; {n_dropped} dropped by the driver");
    vivid::reload().map_err(say)?;
    expect_no_growth(before, after)
}

/// Starting and stopping leaks nothing, and all buffers are back in the pool.
pub(super) fn starts_and_stops() -> Result<(), String> {
    let once = |method| -> Result<(), String> {
        let mut running = start(method)?;
        running.count(1)?;
        let Running {
            stream,
            mut pool,
            camera,
            negotiated,
        } = running;
        drop(stream);
        let mut again = Running {
            stream: camera.start(&negotiated, settings(method), &mut pool).map_err(say)?,
            pool,
            negotiated,
            camera,
        };
        again.count(1)?;
        let Running { stream, mut pool, .. } = again;
        drop(stream);
        let n_free = free_buffers(&mut pool);
        expect(n_free == 10, "all 10 buffers back in the pool", n_free)
    };
    once(Method::Mmap)?;
    once(Method::UserPtr)?;
    let before = footprint();
    for _ in 0..15 {
        once(Method::Mmap)?;
        once(Method::UserPtr)?;
    }
    expect_no_growth(before, footprint())
}

/// Disconnected: the stream says so at once, dropping it is quiet, and the camera is found when it is back.
pub(super) fn disconnect() -> Result<(), String> {
    for method in METHODS {
        let mut running = start(method)?;
        running.count(3)?;
        set(VividFault::Disconnect, 1)?;
        let (error, _) = running.until_failure()?;
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
        let error = running.stream.restart().err();
        expect(
            matches!(error, Some(StreamError::Unplugged { .. })),
            "no restart",
            &error,
        )?;
        drop(running);
        vivid::reload().map_err(say)?;
        start(method)?.count(3)?;
    }
    Ok(())
}
