//! Disks that are full, slow or broken.

use std::io::{Cursor, Seek, SeekFrom, Write};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use super::*;
use crate::frame::{Exposure, FrameMeta, PixelFormat, Size};
use crate::recording::mcap::output::Synchronise;
use crate::recording::mcap::{Ending, McapPlayer};
use crate::recording::{Pace, Repeat};
use crate::source::{CameraRole, Next, Source};

/// An output in memory, with so much room, that can be made to stand still.
#[derive(Clone)]
struct Disk {
    bytes: Arc<Mutex<Cursor<Vec<u8>>>>,
    room: u64,
    is_held: Arc<AtomicBool>,
    fails_to_synchronise: bool,
}

impl Disk {
    fn new(room: u64) -> Self {
        Self {
            bytes: Arc::default(),
            room,
            is_held: Arc::default(),
            fails_to_synchronise: false,
        }
    }

    fn bytes(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().get_ref().clone()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while self.is_held.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let mut cursor = self.bytes.lock().unwrap();
        let left = self.room.saturating_sub(cursor.position()) as usize;
        if left == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        cursor.write(&bytes[..bytes.len().min(left)])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, place: SeekFrom) -> io::Result<u64> {
        self.bytes.lock().unwrap().seek(place)
    }
}

impl Output for Disk {
    fn synchronise(&self) -> io::Result<Synchronise> {
        let fails = self.fails_to_synchronise;
        Ok(Box::new(move || {
            if fails {
                Err(io::ErrorKind::Other.into())
            } else {
                Ok(())
            }
        }))
    }

    fn cut(&mut self, n_bytes: u64) -> io::Result<()> {
        self.bytes.lock().unwrap().get_mut().truncate(n_bytes as usize);
        Ok(())
    }
}

const SIZE: Size = Size { width: 64, height: 32 };

fn camera() -> CameraDescription {
    CameraDescription {
        name: "scene".into(),
        role: CameraRole::Scene,
        size: SIZE,
        format: PixelFormat::Grey8,
    }
}

fn frame(number: u64) -> Frame {
    let exposure = Exposure {
        time_s: 0.01,
        gain: 1.0,
        white_balance: [1.0; 3],
    };
    Frame {
        meta: FrameMeta::new("scene".into(), number, number * 1000, exposure),
        size: SIZE,
        format: PixelFormat::Grey8,
        pixels: vec![number as u8; SIZE.pixels()].into(),
    }
}

fn start(disk: &Disk, options: RecorderOptions) -> Recorder {
    Recorder::start(Path::new("disk"), disk.clone(), &[camera()], options).unwrap()
}

/// Numbers and losses of the frames in a file of these bytes, and how it ends.
fn play(bytes: &[u8]) -> (Vec<(u64, u32)>, Ending) {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let mut player = McapPlayer::open(file.path(), Pace::Max, Repeat::ONCE).unwrap();
    let ending = player.ending();
    let mut played = Vec::new();
    while let Next::Frame(frame) = player.next_frame(Duration::ZERO).unwrap() {
        assert!(frame.pixels.iter().all(|&code| code == frame.meta.sequence as u8));
        played.push((frame.meta.sequence, frame.meta.lost_before));
    }
    (played, ending)
}

#[test]
fn a_full_disk_ends_the_recording_and_keeps_what_is_whole() {
    let whole = Disk::new(u64::MAX);
    let options = RecorderOptions {
        chunk_bytes: 5000,
        ..RecorderOptions::default()
    };
    let mut recorder = start(&whole, options.clone());
    let head_bytes = whole.bytes().len() as u64;
    (0..20).for_each(|number| assert_eq!(recorder.record_or_wait(frame(number)), Recorded::Queued));
    recorder.finish().unwrap();
    let n_bytes = whole.bytes().len() as u64;
    let mut most_kept = 0;
    for room in (head_bytes..n_bytes).step_by(97) {
        let disk = Disk::new(room);
        let mut recorder = start(&disk, options.clone());
        for number in 0..20 {
            recorder.record_or_wait(frame(number));
        }
        let error = recorder.finish().unwrap_err();
        let RecordError::DiskFull { kept, .. } = &error else {
            panic!("{error}")
        };
        let bytes = disk.bytes();
        assert_eq!(kept.bytes, bytes.len() as u64, "the file is cut to its whole chunks");
        if kept.frames > 0 {
            let (played, ending) = play(&bytes);
            assert_eq!(played.len() as u64, kept.frames);
            assert_eq!(ending, Ending::NoSummary);
        }
        most_kept = most_kept.max(kept.frames);
    }
    assert_eq!(most_kept, 20, "at the end only the summary has no room");
}

#[test]
fn after_an_error_frames_are_refused_and_counted() {
    let disk = Disk::new(50_000);
    let mut recorder = start(&disk, RecorderOptions::default());
    let mut number = 0;
    while recorder.is_running() {
        recorder.record(frame(number));
        number += 1;
    }
    let lost_frames = recorder.stats().lost_frames;
    assert_eq!(recorder.record(frame(number)), Recorded::Stopped);
    assert_eq!(recorder.stats().lost_frames, lost_frames + 1);
    assert!(recorder.finish().is_err());
}

#[test]
fn a_disk_that_cannot_keep_what_it_has_is_an_error() {
    let mut disk = Disk::new(u64::MAX);
    disk.fails_to_synchronise = true;
    let mut recorder = start(&disk, RecorderOptions::default());
    recorder.record(frame(1));
    let error = recorder.finish().unwrap_err();
    assert!(matches!(error, RecordError::Write { .. }), "{error}");
}

#[test]
fn a_slow_disk_holds_nobody_up_and_losses_are_written_down() {
    let disk = Disk::new(u64::MAX);
    let options = RecorderOptions {
        queue_frames: 4,
        ..RecorderOptions::default()
    };
    let mut recorder = start(&disk, options);
    disk.is_held.store(true, Ordering::Relaxed);
    let outcomes: Vec<_> = (0..1000).map(|number| recorder.record(frame(number))).collect();
    let n_lost = outcomes.iter().filter(|outcome| **outcome == Recorded::Lost).count() as u64;
    // Four wait, one is being written, and before it some went into the buffer of 64 KiB.
    assert!((1000 - 4 - 1 - 32..=1000 - 4).contains(&n_lost), "{n_lost}");
    assert_eq!(recorder.stats().lost_frames, n_lost);
    disk.is_held.store(false, Ordering::Relaxed);
    while recorder.stats().queued_frames > 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(recorder.record(frame(1000)), Recorded::Queued);
    assert_eq!(recorder.finish().unwrap().frames, 1001 - n_lost);
    let (played, ending) = play(&disk.bytes());
    assert_eq!(ending, Ending::Complete);
    assert_eq!(played.len() as u64, 1001 - n_lost);
    let lost_before: u32 = played.iter().map(|(_, lost_before)| lost_before).sum();
    assert_eq!(u64::from(lost_before), n_lost);
    let text = String::from_utf8_lossy(&disk.bytes()).into_owned();
    assert!(text.contains(r#""kind":"lost""#) && text.contains(r#""cause":"recorder_full""#));
}
