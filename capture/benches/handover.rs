//! Hand-over of 1080p NV12 frames to another process, beside a plain copy through a Unix socket in the same run.
//!
//! `cargo bench -p mirrorball-capture --bench handover [-- SECONDS]`
//!
//! A parent process sends 60 frames a second, by turns through the hand-over and through the socket; a child receives
//! them and touches one byte of every page, as a reader would. The latency is the time from when the picture is in the
//! sender's hands to when its last byte can be read by the reader. `copied` includes the copy of the picture into
//! shared memory, for drivers that cannot write there themselves.

#![expect(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use mirrorball_capture::handover::{self, publish_on, subscribe_to};
use mirrorball_capture::{
    CameraDescription, CameraRole, Exposure, Frame, FrameMeta, FrameSet, PixelFormat, Received, Size, Ycbcr,
    YcbcrMatrix, YcbcrRange,
};

const SIZE: Size = Size {
    width: 1920,
    height: 1080,
};
const FORMAT: PixelFormat = PixelFormat::Nv12(Ycbcr {
    matrix: YcbcrMatrix::Bt709,
    range: YcbcrRange::Limited,
});
const INTERVAL: Duration = Duration::from_nanos(16_666_667);
const PAGE_BYTES: usize = 4096;

/// How a frame goes over; the number travels as its sequence number modulo 3.
const WAYS: [&str; 3] = ["in place", "copied", "Unix socket"];

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with("--")).collect();
    match args.as_slice() {
        [role, service, socket] if role == "read" => read(service, socket),
        [seconds] => send(seconds.parse().expect("a number of seconds")),
        _ => send(10),
    }
}

fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    u64::try_from(since.expect("a clock after 1970").as_nanos()).expect("a clock before 2554")
}

fn send(seconds: u64) {
    let service = format!("mirrorball/bench-{}", std::process::id());
    let socket = std::env::temp_dir().join(format!("mirrorball-bench-{}", std::process::id()));
    let listener = UnixListener::bind(&socket).expect("a socket in the folder for temporary files");
    let camera = CameraDescription {
        name: "scene".into(),
        role: CameraRole::Scene,
        size: SIZE,
        format: FORMAT,
    };
    let mut publisher = publish_on(&service, &[camera]).expect("shared memory");
    let child = Command::new(std::env::current_exe().expect("this program's file"))
        .args(["read", &service, &socket.display().to_string()])
        .stdout(Stdio::inherit())
        .spawn()
        .expect("a second process");
    let (mut stream, _) = listener.accept().expect("the child connects");
    std::fs::remove_file(&socket).expect("the socket's file");
    while publisher.count_readers() == 0 {
        std::thread::sleep(Duration::from_millis(10));
    }
    let picture: Vec<u8> = (0..FORMAT.max_bytes(SIZE)).map(|index| (index % 251) as u8).collect();
    let mut pool = publisher.pool(4, picture.len()).expect("blocks as large as announced");
    let mut next = Instant::now();
    for sequence in 0..seconds * 60 {
        next += INTERVAL;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        if sequence % 3 == 2 {
            stream.write_all(&now_ns().to_ne_bytes()).expect("the child reads");
            stream.write_all(&picture).expect("the child reads");
            continue;
        }
        let mut lease = pool.lease().expect("a free block");
        let mut sent_ns = now_ns();
        lease.bytes_mut().copy_from_slice(&picture);
        if sequence % 3 == 0 {
            sent_ns = now_ns();
        }
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let frame = Frame {
            meta: FrameMeta::new("scene".into(), sequence, sent_ns, exposure),
            size: SIZE,
            format: FORMAT,
            pixels: lease.freeze(picture.len()),
        };
        publisher
            .publish(FrameSet { frames: vec![frame] })
            .expect("shared memory");
    }
    drop(stream);
    let mut child = child;
    child.wait().expect("the child ends");
}

fn touch_pages(pixels: &[u8]) {
    let sum: u64 = pixels.iter().step_by(PAGE_BYTES).map(|&byte| u64::from(byte)).sum();
    std::hint::black_box(sum);
}

fn read(service: &str, socket: &str) {
    let mut subscriber = subscribe_to(service).expect("shared memory");
    let mut stream = UnixStream::connect(socket).expect("the parent listens");
    let by_socket = std::thread::spawn(move || {
        let mut latencies_us = Vec::new();
        let mut picture = vec![0; FORMAT.max_bytes(SIZE)];
        let mut stamp = [0; 8];
        while stream.read_exact(&mut stamp).is_ok() && stream.read_exact(&mut picture).is_ok() {
            touch_pages(&picture);
            latencies_us.push(now_ns().saturating_sub(u64::from_ne_bytes(stamp)) as f64 / 1e3);
        }
        latencies_us
    });
    let mut latencies_us = [Vec::new(), Vec::new()];
    while !by_socket.is_finished() {
        let received = subscriber.receive(Duration::from_millis(50)).expect("shared memory");
        let Received::Set(set) = received else { continue };
        let frame = &set.frames[0];
        touch_pages(&frame.pixels);
        latencies_us[(frame.meta.sequence % 3) as usize]
            .push(now_ns().saturating_sub(frame.meta.timestamp_ns) as f64 / 1e3);
    }
    let [in_place, copied] = latencies_us;
    report(
        [in_place, copied, by_socket.join().expect("no panic")],
        subscriber.stats(),
    );
}

fn report(latencies_us: [Vec<f64>; 3], stats: handover::SubscriberStats) {
    println!(
        "1920x1080 NV12 at 60 frames/s to another process; {} missed",
        stats.missed
    );
    println!("{:<12} {:>7} {:>9} {:>9}", "way", "frames", "p50 us", "p99 us");
    let mut medians = Vec::new();
    for (way, mut us) in WAYS.iter().zip(latencies_us) {
        us.sort_by(f64::total_cmp);
        let at = |share: f64| us.get((us.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN);
        println!("{way:<12} {:>7} {:>9.0} {:>9.0}", us.len(), at(0.5), at(0.99));
        medians.push(at(0.5));
    }
    println!(
        "socket / in place {:.1}, socket / copied {:.1}",
        medians[2] / medians[0],
        medians[2] / medians[1]
    );
}
