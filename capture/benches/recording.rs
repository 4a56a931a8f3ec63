//! Two cameras of 1280×720, recorded to disk.
//!
//! `cargo bench -p mirrorball-capture --bench recording [-- SECONDS FRAMES_PER_SECOND FOLDER]`
//!
//! Each camera gives raw frames (NV12) at the given rate (60) for the given time (10 s) from a fixed stock of buffers,
//! as a driver would. A file is ended after a minute and removed when the next one is, so that ten minutes do not need
//! 100 GB; the next file is begun before the last one ends, so that nothing is lost by that.

#![expect(clippy::print_stdout, reason = "the figures are what the program is for")]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mirrorball_capture::recording::mcap::{Recorded, Recorder, RecorderOptions, RecorderStats};
use mirrorball_capture::{
    CameraDescription, CameraRole, Exposure, Frame, FrameMeta, HeapPool, PixelFormat, Pool, Size, Ycbcr, YcbcrMatrix,
    YcbcrRange,
};

const SIZE: Size = Size {
    width: 1280,
    height: 720,
};
const FORMAT: PixelFormat = PixelFormat::Nv12(Ycbcr {
    matrix: YcbcrMatrix::Bt709,
    range: YcbcrRange::Limited,
});
const FILE_TIME: Duration = Duration::from_secs(60);

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with("--")).collect();
    let number = |index: usize, default: f64| args.get(index).map_or(default, |text| text.parse().expect("a number"));
    let (seconds, rate_hz) = (number(0, 10.0), number(1, 60.0));
    let folder = args.get(2).map_or_else(std::env::temp_dir, PathBuf::from);
    let mut run = Run::new(&folder);
    let interval = Duration::from_secs_f64(0.5 / rate_hz);
    let started = Instant::now();
    for number in 0u32.. {
        let due = interval * number;
        if due.as_secs_f64() >= seconds {
            break;
        }
        std::thread::sleep(due.saturating_sub(started.elapsed()));
        run.give(number);
    }
    run.next_file(false);
    run.print(started.elapsed());
}

/// A run over several files.
struct Run {
    folder: PathBuf,
    cameras: Vec<CameraDescription>,
    pool: HeapPool,
    recorder: Option<Recorder>,
    file_started: Instant,
    ending: Option<std::thread::JoinHandle<RecorderStats>>,
    n_files: u32,
    given: u64,
    no_buffer: u64,
    lost: u64,
    most_waiting: u64,
    longest_give: Duration,
    frames: u64,
    bytes: u64,
}

impl Run {
    fn new(folder: &Path) -> Self {
        let camera = |name: &str, role| CameraDescription {
            name: name.into(),
            role,
            size: SIZE,
            format: FORMAT,
        };
        let cameras = vec![camera("scene", CameraRole::Scene), camera("probe", CameraRole::Ball)];
        // As many as may wait, and some that are being filled or written.
        let mut pool = HeapPool::new(RecorderOptions::default().queue_frames + 16, FORMAT.max_bytes(SIZE));
        fill(&mut pool);
        let mut run = Self {
            folder: folder.to_path_buf(),
            cameras,
            pool,
            recorder: None,
            file_started: Instant::now(),
            ending: None,
            n_files: 0,
            given: 0,
            no_buffer: 0,
            lost: 0,
            most_waiting: 0,
            longest_give: Duration::ZERO,
            frames: 0,
            bytes: 0,
        };
        run.next_file(true);
        run
    }

    fn give(&mut self, number: u32) {
        if self.file_started.elapsed() >= FILE_TIME && number.is_multiple_of(2) {
            self.next_file(true);
        }
        self.given += 1;
        let Some(mut lease) = self.pool.lease() else {
            self.no_buffer += 1;
            return;
        };
        lease.bytes_mut()[..4].copy_from_slice(&number.to_le_bytes());
        let exposure = Exposure {
            time_s: 0.008,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let camera = &self.cameras[number as usize % 2];
        let sequence = u64::from(number / 2) + 1;
        let frame = Frame {
            meta: FrameMeta::new(camera.name.clone(), sequence, sequence * 1_000_000, exposure),
            size: SIZE,
            format: FORMAT,
            pixels: lease.freeze(FORMAT.max_bytes(SIZE)),
        };
        let recorder = self.recorder.as_mut().expect("there is a file while frames are given");
        let started = Instant::now();
        let recorded = recorder.record(frame);
        self.longest_give = self.longest_give.max(started.elapsed());
        self.lost += u64::from(recorded != Recorded::Queued);
        self.most_waiting = self.most_waiting.max(recorder.stats().queued_frames);
    }

    /// Ends the file beside the frames that go on, and begins the next one.
    fn next_file(&mut self, begin: bool) {
        let last = self.recorder.take();
        if begin {
            let path = self.path(self.n_files);
            let _ = std::fs::remove_file(&path);
            let recorder = Recorder::create(&path, &self.cameras, RecorderOptions::default());
            self.recorder = Some(recorder.expect("a folder with room"));
            self.file_started = Instant::now();
            self.n_files += 1;
        }
        self.wait_for_ending();
        if let Some(last) = last {
            let path = self.path(self.n_files - 1 - u32::from(begin));
            self.ending = Some(std::thread::spawn(move || {
                let stats = last.finish().expect("a disk with room");
                std::fs::remove_file(path).expect("the file is there");
                stats
            }));
        }
        if !begin {
            self.wait_for_ending();
        }
    }

    fn wait_for_ending(&mut self) {
        if let Some(ending) = self.ending.take() {
            let stats = ending.join().expect("finishing does not panic");
            self.frames += stats.frames;
            self.bytes += stats.bytes;
        }
    }

    fn path(&self, number: u32) -> PathBuf {
        self.folder
            .join(format!("mirrorball-bench-{}-{number}.mcap", std::process::id()))
    }

    fn print(&self, elapsed: Duration) {
        let seconds = elapsed.as_secs_f64();
        println!(
            "2 × 1280×720 NV12 to `{}`, {} files",
            self.folder.display(),
            self.n_files
        );
        println!("time             {seconds:.1} s, until all was written and synchronised");
        println!(
            "given            {} frames, {:.1} per second and camera",
            self.given,
            self.given as f64 / seconds / 2.0
        );
        println!(
            "written          {} frames, {:.1} MB/s",
            self.frames,
            self.bytes as f64 / 1e6 / seconds
        );
        println!(
            "lost             {} by the recorder, {} for want of a buffer",
            self.lost, self.no_buffer
        );
        println!("most waiting     {} frames", self.most_waiting);
        println!("longest giving   {:.3} ms", self.longest_give.as_secs_f64() * 1e3);
    }
}

/// Fills all buffers with something that does not compress to nothing.
fn fill(pool: &mut HeapPool) {
    let mut leases: Vec<_> = std::iter::from_fn(|| pool.lease()).collect();
    let mut state = 1u32;
    for lease in &mut leases {
        for byte in lease.bytes_mut() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *byte = 96 + (state >> 28) as u8;
        }
    }
}
