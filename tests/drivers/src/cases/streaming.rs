//! Frames arrive, in order, and they are the ones that were sent.

use std::thread;

use mirrorball_driver_tests::raw_camera::RawCamera;
use mirrorball_driver_tests::vivid;
use mirrorball_driver_tests::webcam::WebcamConfig;
use mirrorball_driver_tests::webcam::truth::Fate;

use super::support::{Bench, Known, MJPEG, PATIENCE, YUYV, counter_gaps, ensure, say, sequence_gaps};

pub(super) fn vivid_streams() -> Result<(), String> {
    let nodes = vivid::nodes();
    ensure(nodes.len() == 2, || {
        format!("two cameras of vivid expected, there are {nodes:?}")
    })?;
    for node in nodes {
        let mut camera = RawCamera::open(&node).map_err(say)?;
        let chosen = camera.set_format((320, 180), YUYV).map_err(say)?;
        ensure(chosen == ((320, 180), YUYV), || format!("the driver chose {chosen:?}"))?;
        camera.set_rate(60).map_err(say)?;
        camera.start(4).map_err(say)?;
        let mut last: Option<(u32, u64)> = None;
        for _ in 0..30 {
            let frame = camera.next_frame(PATIENCE).map_err(say)?.ok_or("no frame")?;
            ensure(frame.bytes.len() == 320 * 180 * 2, || {
                format!("{} bytes", frame.bytes.len())
            })?;
            let now = (frame.sequence, frame.timestamp_ns);
            ensure(last.is_none_or(|last| last < now), || format!("{now:?} after {last:?}"))?;
            last = Some(now);
        }
        camera.stop().map_err(say)?;
    }
    Ok(())
}

pub(super) fn two_webcams_stream_yuyv() -> Result<(), String> {
    both_stream((640, 480), YUYV)
}

pub(super) fn two_webcams_stream_mjpeg() -> Result<(), String> {
    both_stream((1280, 720), MJPEG)
}

fn both_stream(size: (u32, u32), fourcc: [u8; 4]) -> Result<(), String> {
    let benches = [(0, "Scene camera"), (1, "Probe camera")].map(|(port, name)| {
        let bench = Bench::open(port, WebcamConfig::named(name), size, fourcc)?;
        let card = bench.camera.name().map_err(say)?;
        ensure(card == name, || format!("the driver calls `{name}` `{card}`"))?;
        Ok::<_, String>(bench)
    });
    let threads = benches.map(|bench| {
        thread::spawn(move || {
            let mut bench = bench?;
            bench.start()?;
            let frames = bench.known_frames(60)?;
            check(&bench, &frames)
        })
    });
    for thread in threads {
        thread.join().map_err(|_| "a reader panicked")??;
    }
    Ok(())
}

/// Every frame that came had been sent, and of those between them none is missing that was sent.
fn check(bench: &Bench, frames: &[Known]) -> Result<(), String> {
    let (first, last) = (frames[0].truth.counter, frames[frames.len() - 1].truth.counter);
    let sent = bench
        .webcam
        .truth()
        .into_iter()
        .filter(|frame| (first..=last).contains(&frame.counter));
    let n_sent = sent.filter(|frame| frame.fate == Fate::Sent).count() as u32;
    let seconds = (frames[frames.len() - 1].frame.timestamp_ns - frames[0].frame.timestamp_ns) as f64 / 1e9;
    println!(
        "    {}: {:.1} frames/s; {} of {} lost between sensor and cable, {} between cable and reader",
        bench.camera.name().map_err(say)?,
        (frames.len() - 1) as f64 / seconds,
        last + 1 - first - u64::from(n_sent),
        last + 1 - first,
        sequence_gaps(frames),
    );
    let found = frames.len() as u32 + sequence_gaps(frames);
    ensure(found == n_sent, || {
        format!("{n_sent} frames sent, {found} received or missed by the driver's sequence")
    })?;
    ensure(counter_gaps(frames) >= u64::from(sequence_gaps(frames)), || {
        "a gap without a lost frame".to_owned()
    })
}
