//! The threads behind a recorder: one writes, one synchronises.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ::mcap::McapError;
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use crossbeam_queue::ArrayQueue;

use super::error::{Kept, RecordError};
use super::layout::RecordingEvent;
use super::output::{Output, Synchronise};
use super::writer::McapWriter;
use crate::frame::Frame;
use crate::source::CameraDescription;

/// The running threads.
#[derive(Debug)]
pub(super) struct Threads {
    pub(super) writing: JoinHandle<Result<Kept, RecordError>>,
    pub(super) synchronising: JoinHandle<()>,
}

/// What travels to the writing thread.
pub(super) struct Item {
    pub(super) notes: Vec<Note>,
    pub(super) frame: Option<Frame>,
}

/// What goes into the file besides frames.
#[derive(Debug)]
pub(super) enum Note {
    Camera(CameraDescription),
    Event(RecordingEvent),
}

/// What the threads tell each other. The numbers guard no other data, so all loads and stores are relaxed.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) written_frames: AtomicU64,
    pub(super) queued_frames: AtomicU64,
    pub(super) queued_bytes: AtomicU64,
    pub(super) finished_frames: AtomicU64,
    pub(super) finished_bytes: AtomicU64,
    pub(super) safe_frames: AtomicU64,
    pub(super) sync_error: ArrayQueue<io::Error>,
}

impl Default for Shared {
    fn default() -> Self {
        Self {
            written_frames: AtomicU64::new(0),
            queued_frames: AtomicU64::new(0),
            queued_bytes: AtomicU64::new(0),
            finished_frames: AtomicU64::new(0),
            finished_bytes: AtomicU64::new(0),
            safe_frames: AtomicU64::new(0),
            sync_error: ArrayQueue::new(1),
        }
    }
}

impl Shared {
    /// A frame of `n_bytes` has left the queue, or never got in.
    pub(super) fn take_from_queue(&self, n_bytes: u64) {
        self.queued_frames.fetch_sub(1, Ordering::Relaxed);
        self.queued_bytes.fetch_sub(n_bytes, Ordering::Relaxed);
    }

    fn tell_finished(&self, kept: Kept) {
        self.finished_frames.store(kept.frames, Ordering::Relaxed);
        self.finished_bytes.store(kept.bytes, Ordering::Relaxed);
    }
}

/// Shortest interval between two synchronisations.
pub(super) const MIN_SYNC_INTERVAL: Duration = Duration::from_millis(10);

/// The thread that writes.
pub(super) struct WritingThread<O: Output> {
    pub(super) path: PathBuf,
    pub(super) writer: McapWriter<O>,
    pub(super) items: Receiver<Item>,
    pub(super) shared: Arc<Shared>,
    pub(super) chunk_bytes: u64,
    pub(super) chunk_time: Duration,
}

/// Starts both threads.
pub(super) fn start_threads<O: Output>(
    writing: WritingThread<O>,
    synchronise: Synchronise,
) -> Result<Threads, RecordError> {
    let shared = writing.shared.clone();
    let interval = writing.chunk_time;
    let (stop, stopped) = bounded::<()>(0);
    let thread = |name: &str| std::thread::Builder::new().name(name.to_owned());
    let synchronising = thread("record sync")
        .spawn(move || keep_synchronised(synchronise, &shared, &stopped, interval))
        .map_err(RecordError::StartThread)?;
    let run = move || {
        let result = writing.run();
        drop(stop);
        result
    };
    let writing = thread("record").spawn(run).map_err(RecordError::StartThread)?;
    Ok(Threads { writing, synchronising })
}

impl<O: Output> WritingThread<O> {
    fn run(mut self) -> Result<Kept, RecordError> {
        let mut kept = self.writer.kept();
        match self.write_all(&mut kept) {
            Ok(()) => Ok(kept),
            Err(error) => {
                let source = self.writer.abandon(kept.bytes, error);
                self.shared.written_frames.store(kept.frames, Ordering::Relaxed);
                self.shared.finished_bytes.store(kept.bytes, Ordering::Relaxed);
                let path = self.path;
                Err(match source.kind() {
                    io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                        RecordError::DiskFull { path, kept, source }
                    }
                    _ => RecordError::Write { path, kept, source },
                })
            }
        }
    }

    /// Writes until the giver ends; `kept` follows what lies in whole chunks.
    fn write_all(&mut self, kept: &mut Kept) -> Result<(), McapError> {
        self.finish_chunk(kept)?;
        let mut chunk_started = Instant::now();
        loop {
            let rest = self.chunk_time.saturating_sub(chunk_started.elapsed());
            match self.items.recv_timeout(rest) {
                Ok(item) => self.write_item(item)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            let is_due = chunk_started.elapsed() >= self.chunk_time;
            if is_due || self.writer.chunk_bytes() >= self.chunk_bytes {
                chunk_started = Instant::now();
                if self.writer.chunk_bytes() > 0 {
                    self.finish_chunk(kept)?;
                }
            }
            if let Some(error) = self.shared.sync_error.pop() {
                return Err(McapError::Io(error));
            }
        }
        self.finish_chunk(kept)?;
        self.writer.finish()?;
        *kept = self.writer.kept();
        self.shared.tell_finished(*kept);
        Ok(())
    }

    fn write_item(&mut self, item: Item) -> Result<(), McapError> {
        for note in item.notes {
            match note {
                Note::Camera(camera) => self.writer.add_camera(&camera)?,
                Note::Event(event) => self.writer.write_event(&event)?,
            }
        }
        if let Some(frame) = item.frame {
            self.shared.take_from_queue(frame.pixels.len() as u64);
            self.writer.write_frame(&frame)?;
            self.shared.written_frames.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn finish_chunk(&mut self, kept: &mut Kept) -> Result<(), McapError> {
        self.writer.finish_chunk()?;
        *kept = self.writer.kept();
        self.shared.tell_finished(*kept);
        Ok(())
    }
}

/// Synchronises again and again, beside the thread that writes, so that a slow disk does not hold that up.
fn keep_synchronised(mut synchronise: Synchronise, shared: &Shared, stopped: &Receiver<()>, interval: Duration) {
    let mut safe_bytes = 0;
    loop {
        let is_last = stopped.recv_timeout(interval) == Err(RecvTimeoutError::Disconnected);
        let finished_bytes = shared.finished_bytes.load(Ordering::Relaxed);
        let finished_frames = shared.finished_frames.load(Ordering::Relaxed);
        if finished_bytes != safe_bytes {
            if let Err(error) = synchronise() {
                // Only this thread pushes, and only once.
                shared.sync_error.force_push(error);
                return;
            }
            safe_bytes = finished_bytes;
            shared.safe_frames.store(finished_frames, Ordering::Relaxed);
        }
        if is_last {
            return;
        }
    }
}
