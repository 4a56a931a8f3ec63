//! Plays an image-folder recording as if it were cameras.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::frame::{Frame, FrameMeta, PixelFormat};
use crate::recording::format::{Entry, read_frame_list};
use crate::recording::pace::{LONE_FRAME_INTERVAL_NS, Pace, Pacer, Repeat};
use crate::recording::picture::read_picture;
use crate::recording::rig::read_cameras;
use crate::source::{CameraDescription, CameraRole, Next, Source, SourceError};

/// A [`Source`] over an image-folder recording.
///
/// Frames come in the order of the frame list, which is that of time. When the recording is repeated, time stamps and
/// sequence numbers go on rising as if the cameras had never stopped (and it ends when 64 bits are used up). A picture
/// is read when it is asked for, before the wait for its moment, so that reading does not delay it.
#[derive(Debug)]
pub struct Player {
    folder: PathBuf,
    list: PathBuf,
    cameras: Vec<CameraDescription>,
    entries: Vec<Entry>,
    /// What a round adds to the sequence numbers of each camera.
    round_sequences: Vec<u64>,
    /// What a round adds to every time stamp.
    round_ns: u64,
    pacer: Pacer,
    repeat: Repeat,
    round: u64,
    position: usize,
    /// Read, but its moment has not come yet.
    read_ahead: Option<Frame>,
}

impl Player {
    /// Opens the recording in `folder` and checks its rig file and its frame list.
    ///
    /// # Errors
    ///
    /// Any [`SourceError`] but `BadFrame`: pictures are read later.
    pub fn open(folder: &Path, pace: Pace, repeat: Repeat) -> Result<Self, SourceError> {
        if !folder.is_dir() {
            return Err(SourceError::NotAFolder {
                path: folder.to_path_buf(),
            });
        }
        let rig_cameras = read_cameras(&folder.join("rig.toml"))?;
        let list = folder.join("frames.csv");
        let mut entries = read_frame_list(&list, &rig_cameras)?;
        let cameras = keep_cameras_with_frames(rig_cameras, &mut entries);
        let round_sequences = (0..cameras.len())
            .map(|index| round_sequence(&entries, index))
            .collect();
        let first_ns = entries.first().map_or(0, |entry| entry.meta.timestamp_ns);
        let round_ns = round_ns(&entries, &cameras);
        Ok(Self {
            folder: folder.to_path_buf(),
            list,
            cameras,
            entries,
            round_sequences,
            round_ns,
            pacer: Pacer::new(pace, first_ns),
            repeat,
            round: 0,
            position: 0,
            read_ahead: None,
        })
    }

    /// Number of frames in one round, of all cameras together.
    #[must_use]
    pub fn n_frames(&self) -> usize {
        self.entries.len()
    }

    /// What the frame list says of the picture at `file`; `None` when it is not in the list. Both are compared as they are
    /// written: give an absolute path if the recording was opened by one.
    #[must_use]
    pub fn meta_of(&self, file: &Path) -> Option<&FrameMeta> {
        let file = file.strip_prefix(&self.folder).ok()?;
        self.entries
            .iter()
            .find(|entry| entry.file == file)
            .map(|entry| &entry.meta)
    }

    /// What is known about the frames of one round, in the order of the frame list.
    pub(super) fn metas(&self) -> impl Iterator<Item = &FrameMeta> {
        self.entries.iter().map(|entry| &entry.meta)
    }

    /// Reads the picture of the next entry and steps on, whether it could be read or not.
    fn read_next(&mut self) -> Result<Option<Frame>, SourceError> {
        if self.position == self.entries.len() {
            if !self.repeat.has_round(self.round + 1) {
                return Ok(None);
            }
            self.position = 0;
            self.round += 1;
        }
        let entry = &self.entries[self.position];
        let Some(meta) = self.meta_in_round(entry) else {
            return Ok(None);
        };
        self.position += 1;
        let size = self.cameras[entry.camera_index].size;
        let file = self.folder.join(&entry.file);
        match read_picture(&file, size) {
            Ok(pixels) => Ok(Some(Frame {
                meta,
                size,
                format: PixelFormat::Rgb8,
                pixels: pixels.into(),
            })),
            Err(source) => Err(SourceError::BadFrame {
                camera: meta.camera.to_string(),
                sequence: meta.sequence,
                file,
                list: self.list.clone(),
                line: entry.line,
                source: Box::new(source),
            }),
        }
    }

    /// The entry's time stamp and sequence number in this round; none if the clock has run out of numbers.
    fn meta_in_round(&self, entry: &Entry) -> Option<FrameMeta> {
        let shift_ns = self.round.checked_mul(self.round_ns)?;
        let shift = self.round.checked_mul(self.round_sequences[entry.camera_index])?;
        let mut meta = entry.meta.clone();
        meta.timestamp_ns = meta.timestamp_ns.checked_add(shift_ns)?;
        meta.sequence = meta.sequence.checked_add(shift)?;
        Some(meta)
    }
}

impl Source for Player {
    fn cameras(&self) -> &[CameraDescription] {
        &self.cameras
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Next, SourceError> {
        let frame = match self.read_ahead.take() {
            Some(frame) => frame,
            None => match self.read_next()? {
                Some(frame) => frame,
                None => return Ok(Next::End),
            },
        };
        if self.pacer.wait_for(frame.meta.timestamp_ns, timeout) {
            Ok(Next::Frame(frame))
        } else {
            self.read_ahead = Some(frame);
            Ok(Next::TimedOut)
        }
    }
}

/// Leaves out the cameras that have no frame, so that nobody waits for them.
fn keep_cameras_with_frames(rig_cameras: Vec<CameraDescription>, entries: &mut [Entry]) -> Vec<CameraDescription> {
    let mut new_indices = vec![None; rig_cameras.len()];
    let mut cameras = Vec::with_capacity(rig_cameras.len());
    for (index, camera) in rig_cameras.into_iter().enumerate() {
        if entries.iter().any(|entry| entry.camera_index == index) {
            new_indices[index] = Some(cameras.len());
            cameras.push(camera);
        }
    }
    for entry in entries {
        entry.camera_index = new_indices[entry.camera_index].expect("a camera with an entry was kept");
    }
    cameras
}

/// What a round adds to the sequence numbers of a camera, so that the first frame of a round follows the last one.
fn round_sequence(entries: &[Entry], camera_index: usize) -> u64 {
    let mut sequences = entries
        .iter()
        .filter(|entry| entry.camera_index == camera_index)
        .map(|e| e.meta.sequence);
    let first = sequences.next().unwrap_or(0);
    sequences.next_back().unwrap_or(first) - first + 1
}

/// What a round adds to the time stamps: the whole recording, and one mean interval of the leading camera.
fn round_ns(entries: &[Entry], cameras: &[CameraDescription]) -> u64 {
    let leads = |entry: &&Entry| cameras[entry.camera_index].role == CameraRole::Scene;
    let mut stamps = entries.iter().filter(leads).map(|entry| entry.meta.timestamp_ns);
    let n_intervals = stamps.clone().count().saturating_sub(1) as u64;
    let first = stamps.next().unwrap_or(0);
    let leader_span_ns = stamps.next_back().unwrap_or(first) - first;
    let interval_ns = leader_span_ns
        .checked_div(n_intervals)
        .unwrap_or(LONE_FRAME_INTERVAL_NS);
    let stamp_ns = |entry: Option<&Entry>| entry.map_or(0, |entry| entry.meta.timestamp_ns);
    stamp_ns(entries.last()) - stamp_ns(entries.first()) + interval_ns
}
