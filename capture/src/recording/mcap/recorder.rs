//! Records frames on a thread of its own: whoever gives frames never waits, and what has no room is counted.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ::mcap::{Compression, McapError};
use crossbeam_channel::{Sender, TrySendError, bounded};

use super::error::RecordError;
use super::layout::{COUNT_MAX, EventKind, RecordingEvent};
use super::output::Output;
use super::threads::{Item, MIN_SYNC_INTERVAL, Note, Shared, Threads, WritingThread, start_threads};
use super::writer::{FileContents, McapWriter};
use crate::frame::Frame;
use crate::source::{CAMERAS_MAX, CameraDescription, NAME_MAX_BYTES};

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ChunkCompression {
    /// Not at all: the fastest, for raw video.
    #[default]
    None,
    /// LZ4: about two thirds of the size of raw video, for half the speed.
    Lz4,
}

/// What a recording holds besides frames, and how it is written.
#[derive(Debug, Clone)]
pub struct RecorderOptions {
    /// Text of the rig file, kept as the attachment `rig.toml`.
    pub rig: Option<String>,
    /// Text of the daemon's configuration, kept as the attachment `capture.toml`.
    pub config: Option<String>,
    /// How chunks are compressed.
    pub compression: ChunkCompression,
    /// A chunk ends with the frame that makes it this long, in bytes before compression.
    pub chunk_bytes: u64,
    /// How much time of a recording a power cut may take, above 0; a crash of the program takes no more either.
    pub sync_interval: Duration,
    /// Frames that may wait to be written, at least 1.
    pub queue_frames: usize,
    /// Bytes of pixels that may wait to be written; one frame always may.
    pub queue_bytes: u64,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            rig: None,
            config: None,
            compression: ChunkCompression::None,
            chunk_bytes: 8 << 20,
            sync_interval: Duration::from_secs(1),
            queue_frames: 128,
            queue_bytes: 512 << 20,
        }
    }
}

/// What became of a frame given to a [`Recorder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recorded {
    /// It waits to be written.
    Queued,
    /// It is lost, which the recording will say.
    Lost,
    /// It is lost: the recording has failed; [`Recorder::finish`] says why.
    Stopped,
}

/// What a recorder has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RecorderStats {
    /// Frames written.
    pub frames: u64,
    /// Of these, frames that a power cut can no longer take.
    pub safe_frames: u64,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Frames that wait to be written.
    pub queued_frames: u64,
    /// Their pixels, in bytes.
    pub queued_bytes: u64,
    /// Frames that were given and will not be in the recording.
    pub lost_frames: u64,
    /// Events that were given while thousands already waited, and will not be in the recording.
    pub lost_events: u64,
    /// Time since the recording began, in seconds.
    pub elapsed_s: f64,
}

impl RecorderStats {
    /// Megabytes (10^6 bytes) per second since the recording began.
    #[must_use]
    pub fn mean_mb_per_s(&self) -> f64 {
        self.bytes as f64 / 1e6 / self.elapsed_s.max(1e-9)
    }
}

/// Writes frames of 1 to 16 cameras into an MCAP file.
///
/// Frames wait as they are: their pixels are shared, so a pool that they come from must have as many buffers more.
/// Dropped without [`Self::finish`], it ends the recording just as well and logs what goes wrong.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    cameras: Vec<Track>,
    /// What could not be handed to the writing thread yet.
    pending: Vec<Note>,
    sender: Option<Sender<Item>>,
    threads: Option<Threads>,
    shared: Arc<Shared>,
    queue_bytes: u64,
    lost_frames: u64,
    lost_events: u64,
    started: Instant,
}

/// A camera, and how far its frames have come.
#[derive(Debug)]
struct Track {
    description: CameraDescription,
    /// Time stamp and sequence number of the last frame queued.
    last: Option<(u64, u64)>,
    /// Frames lost since.
    lost: u32,
}

/// Most notes that wait; more are dropped and counted, which only a stopped disk and a giver of events without end can bring about.
const PENDING_MAX: usize = 4096;

impl Recorder {
    /// Creates the file `path` and starts the threads that write it.
    ///
    /// # Errors
    ///
    /// [`RecordError`] if the file exists or cannot be created, or a camera cannot be recorded.
    pub fn create(path: &Path, cameras: &[CameraDescription], options: RecorderOptions) -> Result<Self, RecordError> {
        check_cameras(cameras)?;
        let file = File::create_new(path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => RecordError::Exists {
                path: path.to_path_buf(),
            },
            _ => RecordError::Create {
                path: path.to_path_buf(),
                source,
            },
        })?;
        synchronise_folder_of(path);
        Self::start(path, file, cameras, options)
    }

    /// Records to any output; `path` is only for messages.
    pub(super) fn start<O: Output>(
        path: &Path,
        output: O,
        cameras: &[CameraDescription],
        options: RecorderOptions,
    ) -> Result<Self, RecordError> {
        let create_error = |source| RecordError::Create {
            path: path.to_path_buf(),
            source,
        };
        let synchronise = output.synchronise().map_err(create_error)?;
        let contents = FileContents {
            rig: options.rig,
            config: options.config,
            compression: match options.compression {
                ChunkCompression::None => None,
                ChunkCompression::Lz4 => Some(Compression::Lz4),
            },
        };
        let writer =
            McapWriter::start(output, cameras, &contents).map_err(|error| create_error(system_error(error)))?;
        let shared = Arc::new(Shared::default());
        let (sender, items) = bounded(options.queue_frames.max(1));
        let writing = WritingThread {
            path: path.to_path_buf(),
            writer,
            items,
            shared: shared.clone(),
            chunk_bytes: options.chunk_bytes,
            chunk_time: options.sync_interval.max(MIN_SYNC_INTERVAL),
        };
        let threads = start_threads(writing, synchronise)?;
        let track = |description: &CameraDescription| Track {
            description: description.clone(),
            last: None,
            lost: 0,
        };
        Ok(Self {
            path: path.to_path_buf(),
            cameras: cameras.iter().map(track).collect(),
            pending: Vec::new(),
            sender: Some(sender),
            threads: Some(threads),
            shared,
            queue_bytes: options.queue_bytes,
            lost_frames: 0,
            lost_events: 0,
            started: Instant::now(),
        })
    }

    /// Makes room for one more camera, for instance one that was plugged in late.
    ///
    /// # Errors
    ///
    /// [`RecordError::Camera`] if there are too many or its name is taken or too long.
    pub fn add_camera(&mut self, camera: &CameraDescription) -> Result<(), RecordError> {
        let mut cameras: Vec<_> = self.cameras.iter().map(|track| track.description.clone()).collect();
        cameras.push(camera.clone());
        check_cameras(&cameras)?;
        self.cameras.push(Track {
            description: camera.clone(),
            last: None,
            lost: 0,
        });
        self.pending.push(Note::Camera(camera.clone()));
        Ok(())
    }

    /// Cameras whose frames are recorded.
    pub fn cameras(&self) -> impl Iterator<Item = &CameraDescription> {
        self.cameras.iter().map(|track| &track.description)
    }

    /// Gives a frame to be written. Never waits.
    pub fn record(&mut self, frame: Frame) -> Recorded {
        match self.admit(&frame) {
            Ok(index) => match self.queue(index, frame) {
                Ok(()) => Recorded::Queued,
                Err(Rejected::Full(frame)) => self.lose(&frame, "recorder_full"),
                Err(Rejected::Stopped) => self.stopped(),
            },
            Err(cause) => self.lose(&frame, cause),
        }
    }

    /// Gives a frame to be written, and waits until there is room for it: for sources that can wait.
    pub fn record_or_wait(&mut self, mut frame: Frame) -> Recorded {
        loop {
            let index = match self.admit(&frame) {
                Ok(index) => index,
                Err(cause) => return self.lose(&frame, cause),
            };
            match self.queue(index, frame) {
                Ok(()) => return Recorded::Queued,
                Err(Rejected::Full(back)) => frame = *back,
                Err(Rejected::Stopped) => return self.stopped(),
            }
            std::thread::sleep(WAIT_FOR_ROOM);
        }
    }

    /// Writes an event, after the frames given before it. Never waits: without room it goes with the next frame.
    pub fn event(&mut self, event: RecordingEvent) {
        if self.pending.len() < PENDING_MAX {
            self.pending.push(Note::Event(event));
        } else {
            self.lost_events += 1;
        }
        self.send_pending();
    }

    /// What was done so far; cheap.
    #[must_use]
    pub fn stats(&self) -> RecorderStats {
        let load = |number: &AtomicU64| number.load(Ordering::Relaxed);
        RecorderStats {
            frames: load(&self.shared.written_frames),
            safe_frames: load(&self.shared.safe_frames),
            bytes: load(&self.shared.finished_bytes),
            queued_frames: load(&self.shared.queued_frames),
            queued_bytes: load(&self.shared.queued_bytes),
            lost_frames: self.lost_frames,
            lost_events: self.lost_events,
            elapsed_s: self.started.elapsed().as_secs_f64(),
        }
    }

    /// True if writing goes on; false after an error, which [`Self::finish`] returns.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.threads
            .as_ref()
            .is_some_and(|threads| !threads.writing.is_finished())
    }

    /// Writes what still waits, ends the file and returns what was done.
    ///
    /// # Errors
    ///
    /// [`RecordError`] if writing has failed at any time; it says what of the recording is safe.
    pub fn finish(mut self) -> Result<RecorderStats, RecordError> {
        let result = self.end();
        result.map(|()| self.stats())
    }

    fn end(&mut self) -> Result<(), RecordError> {
        let Some(threads) = self.threads.take() else {
            return Ok(());
        };
        if let Some(sender) = self.sender.take() {
            let notes = std::mem::take(&mut self.pending);
            // It fails only if the thread has ended, and then says why itself.
            let _ = sender.send(Item { notes, frame: None });
        }
        let written = threads.writing.join();
        // It ends with the writing thread and has nothing more to say.
        let _ = threads.synchronising.join();
        let path = self.path.clone();
        let kept = written.map_err(|_| RecordError::Panicked { path })??;
        match self.shared.sync_error.pop() {
            Some(source) => Err(RecordError::Write {
                path: self.path.clone(),
                kept,
                source,
            }),
            None => Ok(()),
        }
    }

    /// Index of the frame's camera, or why the frame cannot be recorded.
    fn admit(&self, frame: &Frame) -> Result<usize, &'static str> {
        let meta = &frame.meta;
        let index = self
            .cameras
            .iter()
            .position(|track| track.description.name == meta.camera);
        let Some(index) = index else {
            return Err("unknown_camera");
        };
        let track = &self.cameras[index];
        let is_described = frame.size == track.description.size && frame.format == track.description.format;
        if !is_described || !frame.format.admits(frame.size, frame.pixels.len()) {
            return Err("other_format");
        }
        let is_later = |(timestamp_ns, sequence)| meta.timestamp_ns > timestamp_ns && meta.sequence > sequence;
        if !track.last.is_none_or(is_later) || meta.timestamp_ns.max(meta.sequence) > COUNT_MAX {
            return Err("out_of_order");
        }
        let factors = [meta.exposure.time_s, meta.exposure.gain];
        let mut factors = factors.iter().chain(&meta.exposure.white_balance).chain(&meta.residual);
        if !factors.all(|value| value.is_finite() && *value > 0.0) {
            return Err("bad_exposure");
        }
        Ok(index)
    }

    fn queue(&mut self, index: usize, mut frame: Frame) -> Result<(), Rejected> {
        let Some(sender) = &self.sender else {
            return Err(Rejected::Stopped);
        };
        let n_bytes = frame.pixels.len() as u64;
        let queued_bytes = self.shared.queued_bytes.load(Ordering::Relaxed);
        if queued_bytes > 0 && queued_bytes + n_bytes > self.queue_bytes {
            return Err(Rejected::Full(Box::new(frame)));
        }
        let track = &mut self.cameras[index];
        let place = (frame.meta.timestamp_ns, frame.meta.sequence);
        let lost_before = frame.meta.lost_before;
        frame.meta.lost_before = lost_before.saturating_add(track.lost);
        self.shared.queued_frames.fetch_add(1, Ordering::Relaxed);
        self.shared.queued_bytes.fetch_add(n_bytes, Ordering::Relaxed);
        let item = Item {
            notes: std::mem::take(&mut self.pending),
            frame: Some(frame),
        };
        match sender.try_send(item) {
            Ok(()) => {
                track.last = Some(place);
                track.lost = 0;
                Ok(())
            }
            Err(TrySendError::Full(Item { notes, frame })) => {
                self.pending = notes;
                self.shared.take_from_queue(n_bytes);
                let mut frame = frame.expect("the item that comes back is the one that was sent");
                frame.meta.lost_before = lost_before;
                Err(Rejected::Full(Box::new(frame)))
            }
            Err(TrySendError::Disconnected(_)) => {
                self.shared.take_from_queue(n_bytes);
                Err(Rejected::Stopped)
            }
        }
    }

    fn send_pending(&mut self) {
        let Some(sender) = &self.sender else { return };
        let notes = std::mem::take(&mut self.pending);
        match sender.try_send(Item { notes, frame: None }) {
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(item)) => self.pending = item.notes,
        }
    }

    fn stopped(&mut self) -> Recorded {
        self.lost_frames += 1;
        Recorded::Stopped
    }

    /// Counts a frame as lost; what was lost before it is lost as well.
    fn lose(&mut self, frame: &Frame, cause: &'static str) -> Recorded {
        self.lost_frames += 1;
        let meta = &frame.meta;
        let track = self
            .cameras
            .iter_mut()
            .find(|track| track.description.name == meta.camera);
        if let Some(track) = track {
            track.lost = track.lost.saturating_add(1).saturating_add(meta.lost_before);
        }
        for note in &mut self.pending {
            if let Note::Event(RecordingEvent {
                camera,
                kind: EventKind::Lost { frames, cause: other },
                ..
            }) = note
                && camera.as_deref() == Some(&*meta.camera)
                && other == cause
            {
                *frames += 1;
                return Recorded::Lost;
            }
        }
        self.event(RecordingEvent {
            timestamp_ns: meta.timestamp_ns,
            camera: Some(meta.camera.to_string()),
            kind: EventKind::Lost {
                frames: 1,
                cause: cause.to_owned(),
            },
        });
        Recorded::Lost
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!("{error}");
        }
    }
}

/// Why a frame was not queued.
enum Rejected {
    Full(Box<Frame>),
    Stopped,
}

/// How long to wait before looking for room again.
const WAIT_FOR_ROOM: Duration = Duration::from_millis(1);

fn check_cameras(cameras: &[CameraDescription]) -> Result<(), RecordError> {
    for (index, camera) in cameras.iter().enumerate() {
        let refuse = |reason| RecordError::Camera {
            camera: camera.name.to_string(),
            reason,
        };
        if camera.name.is_empty() || camera.name.len() > NAME_MAX_BYTES {
            return Err(refuse("its name has not 1 to 64 bytes"));
        }
        if cameras[..index].iter().any(|other| other.name == camera.name) {
            return Err(refuse("another camera has its name"));
        }
        if index == CAMERAS_MAX {
            return Err(refuse("it is one more than the 16 that a recording may have"));
        }
    }
    Ok(())
}

/// Makes the name of a new file as safe as its bytes.
fn synchronise_folder_of(path: &Path) {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = File::open(folder.unwrap_or(Path::new(".")));
    if let Err(error) = folder.and_then(|folder| folder.sync_all()) {
        // Some file systems cannot; the file is there all the same.
        tracing::debug!("cannot synchronise the folder of `{}`: {error}", path.display());
    }
}

fn system_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests;
