//! What the daemon costs per 720p60 camera: processor time of all its threads, memory to memory.
//!
//! `cargo bench -p mirrorball-capture --bench daemon [-- SECONDS]`
//!
//! Simulated cameras send YUYV at 60 frames/s into the shared memory of the hand-over, with a copy and without; the
//! daemon checks stamps, measures each picture for the exposure, pairs and publishes, as it does with real ones. What
//! the kernel's driver costs is not in it. Beside it, in the same run: a bare copy of as many bytes.

#![expect(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use mirrorball_capture::daemon::{CameraSetup, Daemon, DaemonSettings, SimulatedDevice, SimulatedMethod};
use mirrorball_capture::handover::publish_on;
use mirrorball_capture::lockstep::LockstepSettings;
use mirrorball_capture::lockstep::tables::Tables;
use mirrorball_capture::meter::Response;
use mirrorball_capture::stamps::{StampPolicy, StampSettings};
use mirrorball_capture::{CameraDescription, CameraRole, PixelFormat, Size, Ycbcr, YcbcrMatrix, YcbcrRange};

const SIZE: Size = Size {
    width: 1280,
    height: 720,
};
const FORMAT: PixelFormat = PixelFormat::Yuyv(Ycbcr {
    matrix: YcbcrMatrix::Bt601,
    range: YcbcrRange::Limited,
});
const INTERVAL: Duration = Duration::from_nanos(16_666_667);

fn main() {
    let mut seconds = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let seconds = seconds
        .next()
        .map_or(10, |arg| arg.parse().expect("a number of seconds"));
    println!("1280x720 YUYV at 60 frames/s, {seconds} s each");
    println!(
        "{:<22} {:>7} {:>6} {:>13} {:>18}",
        "way", "frames", "lost", "us per frame", "% of a core at 60"
    );
    for (way, method) in [
        ("copied", SimulatedMethod::Copied),
        ("in place", SimulatedMethod::InPlace),
    ] {
        measure(way, method, Duration::from_secs(seconds));
    }
    measure_copy();
}

fn print(way: &str, frames: u64, lost: u64, busy: Duration) {
    let per_frame_us = busy.as_secs_f64() * 1e6 / frames.max(1) as f64;
    println!(
        "{way:<22} {frames:>7} {lost:>6} {per_frame_us:>13.0} {:>18.2}",
        per_frame_us * 60.0 / 1e4
    );
}

/// Processor time of all threads that live now.
fn busy_time() -> Duration {
    let tasks = std::fs::read_dir("/proc/self/task").expect("the system's own files");
    let busy_ns = tasks.flatten().filter_map(|task| {
        let stat = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        stat.split_whitespace().next()?.parse::<u64>().ok()
    });
    Duration::from_nanos(busy_ns.sum())
}

fn measure(way: &str, method: SimulatedMethod, length: Duration) {
    let device = SimulatedDevice::new(FORMAT, SIZE, INTERVAL, method, &[]);
    let description = CameraDescription {
        name: "scene".into(),
        role: CameraRole::Scene,
        size: SIZE,
        format: FORMAT,
    };
    let service = format!("mirrorball/bench-daemon-{}", std::process::id());
    let publisher = publish_on(&service, std::slice::from_ref(&description)).expect("shared memory");
    let setup = CameraSetup {
        description,
        device: Box::new(device.clone()),
        stamps: StampSettings {
            policy: StampPolicy::Auto,
            offset_ns: 0,
            interval_ns: 16_666_667,
        },
        response: Response::srgb(),
        tables: Tables::default(),
        latency_frames: Some(2),
        n_buffers: 48,
    };
    let settings = DaemonSettings {
        lockstep: LockstepSettings::default(),
        max_skew: Duration::from_millis(20),
    };
    let mut daemon = Daemon::start(vec![setup], settings, publisher, None).expect("threads and memory");
    let stop = Arc::new(AtomicBool::new(false));
    let clock = {
        let stop = stop.clone();
        std::thread::spawn(move || {
            // Not the first second: memory is new then.
            std::thread::sleep(Duration::from_secs(1));
            let before = (device.frames_made(), busy_time());
            std::thread::sleep(length);
            let after = (device.frames_made(), busy_time());
            stop.store(true, Ordering::Relaxed);
            (after.0 - before.0, after.1.saturating_sub(before.1))
        })
    };
    daemon.run(&stop, &mut |_| {}).expect("shared memory");
    let (frames, busy) = clock.join().expect("no panic");
    let (report, _) = daemon.finish().expect("shared memory");
    print(way, frames, report.cameras[0].losses.total(), busy);
}

/// The copy alone, between buffers that are cold in the cache.
fn measure_copy() {
    const BUFFERS: usize = 32;
    let n_bytes = FORMAT.max_bytes(SIZE);
    let from = vec![1_u8; n_bytes * BUFFERS];
    let mut to = vec![0_u8; n_bytes * BUFFERS];
    let started = Instant::now();
    for (from, to) in from.chunks_exact(n_bytes).zip(to.chunks_exact_mut(n_bytes)) {
        to.copy_from_slice(std::hint::black_box(from));
    }
    std::hint::black_box(&mut to);
    print("bare copy", BUFFERS as u64, 0, started.elapsed());
}
