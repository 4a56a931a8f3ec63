//! Frames arrive: as many as they should, in order, and the ones that were sent.

use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use mirrorball_driver_tests::raw_camera::RawCamera;
use mirrorball_driver_tests::vivid;
use mirrorball_driver_tests::webcam::counter;
use mirrorball_driver_tests::webcam::{Webcam, WebcamConfig};

const PATIENCE: Duration = Duration::from_secs(5);

fn say(error: impl std::fmt::Display) -> String {
    error.to_string()
}

pub(super) fn vivid_streams() -> Result<(), String> {
    let nodes = vivid::nodes();
    if nodes.len() != 2 {
        return Err(format!("two vivid cameras expected: {nodes:?}"));
    }
    let received = stream(&nodes[0], (640, 360), *b"YUYV", 20)?;
    println!("    {received:?}");
    Ok(())
}

pub(super) fn webcams_stream_yuyv() -> Result<(), String> {
    both((640, 480), *b"YUYV")
}

pub(super) fn webcams_stream_mjpeg() -> Result<(), String> {
    both((1280, 720), *b"MJPG")
}

fn both(size: (u32, u32), fourcc: [u8; 4]) -> Result<(), String> {
    let webcams = [
        Webcam::plug(0, WebcamConfig::named("Scene camera")).map_err(say)?,
        Webcam::plug(1, WebcamConfig::named("Probe camera")).map_err(say)?,
    ];
    let nodes = [
        webcams[0].node(PATIENCE).map_err(say)?,
        webcams[1].node(PATIENCE).map_err(say)?,
    ];
    let results = thread::scope(|scope| {
        let threads = nodes
            .each_ref()
            .map(|node| scope.spawn(move || stream(node, size, fourcc, 90)));
        threads.map(|thread| thread.join().map_err(|_| "panic".to_owned()).and_then(|result| result))
    });
    for (result, webcam) in results.into_iter().zip(&webcams) {
        let received = result?;
        let overruns = webcam
            .truth()
            .iter()
            .filter(|frame| frame.fate != mirrorball_driver_tests::webcam::truth::Fate::Sent)
            .count();
        println!("    {received:?} overruns {overruns} of {}", webcam.truth().len());
    }
    Ok(())
}

#[derive(Debug)]
#[expect(dead_code, reason = "printed")]
struct Received {
    rate_hz: f64,
    gaps: u32,
    counters: Vec<Option<u16>>,
    bytes: usize,
}

fn stream(node: &Path, size: (u32, u32), fourcc: [u8; 4], n_frames: usize) -> Result<Received, String> {
    let mut camera = RawCamera::open(node).map_err(say)?;
    let chosen = camera.set_format(size, fourcc).map_err(say)?;
    if chosen != (size, fourcc) {
        return Err(format!("the driver chose {chosen:?}"));
    }
    camera.start(4).map_err(say)?;
    let mut frames = Vec::new();
    let start = Instant::now();
    while frames.len() < n_frames {
        let frame = camera.next_frame(PATIENCE).map_err(say)?;
        frames.push(frame.ok_or_else(|| format!("no frame after {} frames", frames.len()))?);
    }
    let elapsed_s = start.elapsed().as_secs_f64();
    camera.stop().map_err(say)?;
    let gaps = frames
        .windows(2)
        .map(|pair| pair[1].sequence - pair[0].sequence - 1)
        .sum();
    let counters = frames
        .iter()
        .step_by(30)
        .map(|frame| counter::read_yuyv(&frame.bytes, size.0 as usize))
        .collect();
    Ok(Received {
        rate_hz: n_frames as f64 / elapsed_s,
        gaps,
        counters,
        bytes: frames[0].bytes.len(),
    })
}
