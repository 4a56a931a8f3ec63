//! What each fault of a webcam looks like through `uvcvideo`.

use mirrorball_driver_tests::raw_camera::{EXPOSURE_MODE, EXPOSURE_TIME, RawFrame};
use mirrorball_driver_tests::webcam::controls::Control;
use mirrorball_driver_tests::webcam::counter;
use mirrorball_driver_tests::webcam::{FrameFault, WebcamConfig};

use super::support::{Bench, MJPEG, PATIENCE, SILENCE, counter_gaps, ensure, errno, say, sequence_gaps, set_nodrop};

/// Damaged frames: the driver drops them, and only its sequence tells.
pub(super) fn damaged_frames_are_gaps() -> Result<(), String> {
    set_nodrop(false)?;
    for fault in [FrameFault::ErrorBit, FrameFault::Short] {
        let mut bench = Bench::streaming()?;
        let mut frames = bench.known_frames(5)?;
        bench.webcam.befall(fault, 3);
        frames.extend(bench.known_frames(20)?);
        let gaps = sequence_gaps(&frames);
        ensure(gaps >= 3, || {
            format!("{fault:?} on 3 frames: {gaps} gaps in the sequence")
        })?;
        ensure(counter_gaps(&frames) >= 3, || {
            format!("{fault:?}: the frames came nevertheless")
        })?;
    }
    Ok(())
}

/// With `nodrop=1` the driver hands them out with a flag.
pub(super) fn damaged_frames_are_flagged_with_nodrop() -> Result<(), String> {
    set_nodrop(true)?;
    let result = [FrameFault::ErrorBit, FrameFault::Short]
        .into_iter()
        .try_for_each(|fault| {
            let mut bench = Bench::streaming()?;
            bench.known_frames(5)?;
            bench.webcam.befall(fault, 1);
            let frame = bench.frame_where(RawFrame::is_damaged)?;
            let wanted = if fault == FrameFault::Short {
                320 * 240
            } else {
                320 * 240 * 2
            };
            ensure(frame.bytes.len() == wanted, || {
                format!("{fault:?}: {} bytes", frame.bytes.len())
            })
        });
    set_nodrop(false)?;
    result
}

/// A JPEG cut off: to the driver it is as good as any other.
pub(super) fn a_truncated_jpeg_comes_through() -> Result<(), String> {
    let mut bench = Bench::open(0, WebcamConfig::named("Webcam"), (320, 240), MJPEG)?;
    bench.start()?;
    // Automatics settle; sizes are steady then.
    let whole = (0..25).map(|_| bench.frame()).last().ok_or("no frame")??.bytes.len();
    bench.webcam.befall(FrameFault::Short, 1);
    let cut = bench.frame_where(|frame| frame.bytes.len() < whole * 3 / 4)?;
    ensure(!cut.is_damaged(), || "flagged as damaged".to_owned())?;
    ensure(!cut.bytes.ends_with(&[0xFF, 0xD9]), || "it has its end".to_owned())?;
    // The next one is whole, and shows the counter that its comment says.
    let next = bench.known()?;
    let picture = image::load_from_memory(&next.frame.bytes).map_err(say)?.to_luma8();
    let shown = counter::read(|x, y| picture.get_pixel(x as u32, y as u32).0[0]);
    let wanted = (next.truth.counter & 0xFFFF) as u16;
    ensure(shown == Some(wanted), || {
        format!("the picture shows {shown:?}, its comment says {wanted}")
    })
}

/// A frame that the sensor loses leaves no gap in the driver's sequence, only in time.
pub(super) fn frames_lost_in_the_sensor_leave_no_gap() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    let mut frames = bench.known_frames(5)?;
    bench.webcam.befall(FrameFault::LostInSensor, 4);
    frames.extend(bench.known_frames(20)?);
    let (sequence, counter) = (sequence_gaps(&frames), counter_gaps(&frames));
    ensure(counter >= u64::from(sequence) + 4, || {
        format!("{sequence} gaps in the sequence, {counter} in the sensor")
    })
}

/// A failed transfer: empty buffers flagged as damaged, until the stream is restarted.
pub(super) fn a_failed_transfer_needs_a_restart() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    bench.known_frames(5)?;
    bench.webcam.befall(FrameFault::TransferError, 1);
    let frame = bench.frame_where(RawFrame::is_damaged)?;
    ensure(frame.bytes.is_empty(), || {
        format!("{} bytes in a buffer that was given back", frame.bytes.len())
    })?;
    bench.camera.stop().map_err(say)?;
    bench.start()?;
    bench.known_frames(5).map(|_| ())
}

/// A webcam that hangs: silence, and then it goes on.
pub(super) fn a_hang_is_silence() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    bench.known_frames(5)?;
    bench.webcam.hang(true);
    // What was on its way may still arrive.
    while bench.camera.next_frame(SILENCE).map_err(say)?.is_some() {}
    ensure(bench.camera.next_frame(SILENCE).map_err(say)?.is_none(), || {
        "a frame came".to_owned()
    })?;
    bench.webcam.hang(false);
    bench.known_frames(5).map(|_| ())
}

/// A refused control gives the error of its code (`uvc_query_ctrl` in `drivers/media/usb/uvc/uvc_video.c`).
pub(super) fn stalled_controls_have_their_error() -> Result<(), String> {
    let bench = Bench::streaming()?;
    let set = |value| bench.camera.set_control(EXPOSURE_TIME, value);
    let while_automatic = set(100).err().ok_or("the exposure can be set in automatic mode")?;
    bench.camera.set_control(EXPOSURE_MODE, 1).map_err(say)?;
    set(100).map_err(say)?;
    let mut found = Vec::new();
    for code in 1..=8 {
        bench.webcam.stall_control(Control::ExposureTime, Some(code));
        found.push(
            set(100 + i32::from(code))
                .err()
                .and_then(|error| error.raw_os_error())
                .unwrap_or(0),
        );
    }
    bench.webcam.stall_control(Control::ExposureTime, None);
    set(120).map_err(say)?;
    println!("    while automatic: {while_automatic}; codes 1 to 8: {found:?}");
    // EBUSY, EILSEQ, EREMOTE, ERANGE, EIO, EIO, EIO, EINVAL
    let wanted = [16, 84, 66, 34, errno::EIO, errno::EIO, errno::EIO, errno::EINVAL];
    ensure(found == wanted, || format!("errors {found:?}, {wanted:?} expected"))
}

/// A webcam that is slower than it said: the stamps tell.
pub(super) fn a_slow_webcam_is_seen_by_its_stamps() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    bench.known_frames(5)?;
    bench.webcam.slow_down(2.0);
    bench.known_frames(3)?;
    let mut intervals_ms: Vec<f64> = bench
        .known_frames(15)?
        .windows(2)
        .map(|pair| (pair[1].frame.timestamp_ns - pair[0].frame.timestamp_ns) as f64 / 1e6)
        .collect();
    intervals_ms.sort_by(f64::total_cmp);
    let median_ms = intervals_ms[intervals_ms.len() / 2];
    // 66.7 ms instead of 33.3; a busy machine makes single frames late, never early on the whole.
    ensure(median_ms > 55.0, || format!("{median_ms:.1} ms between frames"))
}

/// Unplugged while streaming: the reader is told, the node goes; plugged in again it comes back under another number
/// while the old one is still open.
pub(super) fn unplug_and_replug() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    bench.known_frames(5)?;
    let old_node = bench.webcam.node(PATIENCE).map_err(say)?;
    bench.webcam.unplug();
    let error = loop {
        match bench.camera.next_frame(PATIENCE) {
            Ok(Some(_)) => {}
            Ok(None) => return Err("the reader was not told of the unplug".to_owned()),
            Err(error) => break error,
        }
    };
    ensure(error.raw_os_error() == Some(errno::ENODEV), || {
        format!("ENODEV expected, found {error}")
    })?;
    ensure(!bench.webcam.has_node(), || "the node is still there".to_owned())?;
    bench.webcam.replug().map_err(say)?;
    let new_node = bench.webcam.node(PATIENCE).map_err(say)?;
    ensure(new_node != old_node, || {
        format!("{} again, though it is still open", new_node.display())
    })?;
    bench.reopen()?;
    bench.start()?;
    bench.known_frames(5).map(|_| ())
}
