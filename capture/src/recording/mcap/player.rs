//! Plays an MCAP recording as if it were cameras.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::chunk::{Chunk, read_chunk};
use super::file::{Ending, Found, McapFile};
use super::image::decode_image;
use super::layout::FrameRecord;
use super::read_error::McapReadError;
use super::records::{MessageHead, Step, opcode};
use super::rounds::Rounds;
use super::survey::{ChannelUse, Survey, message_head};
use crate::frame::{Frame, FrameMeta};
use crate::recording::pace::{Pace, Pacer, Repeat};
use crate::source::{CameraDescription, Next, Source, SourceError};

/// What was wrong while a recording was played.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct McapPlayerStats {
    /// Frames played, in all rounds.
    pub frames: u64,
    /// Chunks skipped because their check sum, their length or their compression is bad.
    pub bad_chunks: u64,
    /// Stretches of the file skipped because they are no records.
    pub damages: u64,
    /// Frames skipped because what is said of them or their picture is bad or missing.
    pub bad_frames: u64,
}

/// A [`Source`] over an MCAP recording.
///
/// Frames come in the order in which they were recorded, each in the format it was recorded in. When the recording is
/// repeated, time stamps and sequence numbers go on rising as if the cameras had never stopped (and it ends when 64
/// bits are used up). A chunk is read when its first frame is asked for.
///
/// Bad chunks and frames are errors for which [`SourceError::is_skippable`] is true; the frame after them is next.
/// A file that ends in the middle of a chunk is played up to that chunk; how it ends is said with the end of the first
/// round.
#[derive(Debug)]
pub struct McapPlayer {
    path: PathBuf,
    file: McapFile,
    survey: Survey,
    /// Cameras that have frames.
    cameras: Vec<CameraDescription>,
    /// For each camera of the survey its index among those that have frames.
    places: Vec<Option<usize>>,
    chunk: Option<Chunk>,
    /// For each camera a frame whose picture has not come yet.
    waiting: Vec<Option<FrameMeta>>,
    rounds: Rounds,
    pacer: Option<Pacer>,
    pace: Pace,
    repeat: Repeat,
    /// Read, but its moment has not come yet.
    read_ahead: Option<Frame>,
    has_ended: bool,
    stats: McapPlayerStats,
}

impl McapPlayer {
    /// Opens the recording at `path` and looks through it for its cameras and its end.
    ///
    /// # Errors
    ///
    /// Any [`McapReadError`] that is not skippable.
    pub fn open(path: &Path, pace: Pace, repeat: Repeat) -> Result<Self, SourceError> {
        let mut file = McapFile::open(path)?;
        let survey = Survey::of(path, &mut file)?;
        let mut cameras = Vec::with_capacity(survey.cameras.len());
        let mut places = Vec::with_capacity(survey.cameras.len());
        for camera in &survey.cameras {
            places.push((camera.n_frames > 0).then_some(cameras.len()));
            if camera.n_frames > 0 {
                cameras.push(camera.description.clone());
            }
        }
        let leader = survey.leader().expect("a survey is of a recording with a leader");
        if survey.cameras[leader].n_frames == 0 {
            return Err(SourceError::Mcap(McapReadError::NoLeaderFrame {
                path: path.to_path_buf(),
                leader: survey.cameras[leader].description.name.to_string(),
            }));
        }
        Ok(Self {
            path: path.to_path_buf(),
            file,
            rounds: Rounds::new(&cameras),
            waiting: vec![None; cameras.len()],
            survey,
            cameras,
            places,
            chunk: None,
            pacer: None,
            pace,
            repeat,
            read_ahead: None,
            has_ended: false,
            stats: McapPlayerStats::default(),
        })
    }

    /// How the file ends.
    #[must_use]
    pub fn ending(&self) -> Ending {
        self.survey.ending
    }

    /// Text of the rig file that was recorded with the frames, if it was.
    #[must_use]
    pub fn rig(&self) -> Option<&str> {
        self.survey.rig.as_deref()
    }

    /// Number of frames in one round, of all cameras together, those in bad chunks included where they can be told.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        self.survey.cameras.iter().map(|camera| camera.n_frames).sum()
    }

    /// What was played and skipped so far.
    #[must_use]
    pub fn stats(&self) -> McapPlayerStats {
        self.stats
    }

    /// The next frame of any round.
    fn read_next(&mut self) -> Result<Option<Frame>, McapReadError> {
        while !self.has_ended {
            let Some(mut frame) = self.read_in_round()? else {
                self.end_round();
                continue;
            };
            let index = self.index_of(&frame);
            self.rounds.check(index, &frame.meta).map_err(|reason| {
                self.stats.bad_frames += 1;
                self.bad_frame(index, frame.meta.timestamp_ns, reason)
            })?;
            if !self.rounds.shift(index, &mut frame.meta) {
                self.has_ended = true;
                break;
            }
            self.stats.frames += 1;
            return Ok(Some(frame));
        }
        Ok(None)
    }

    fn end_round(&mut self) {
        if self.rounds.round() == 0 {
            self.say_how_it_ends();
        }
        self.waiting.fill(None);
        self.file.rewind();
        // A round without a single good frame would be followed by more of its kind, for ever.
        self.has_ended = !self.rounds.has_frames() || !self.repeat.has_round(self.rounds.round() + 1);
        self.rounds.begin_next();
    }

    fn say_how_it_ends(&self) {
        let path = self.path.display();
        match self.survey.ending {
            Ending::Complete => {}
            Ending::NoSummary => tracing::warn!("recording `{path}` was broken off; all that was written was played"),
            Ending::CutOff {
                lost_bytes,
                lost_frames,
            } => tracing::warn!(
                "recording `{path}` ends in the middle of a record: its last {lost_bytes} bytes with at least \
                 {lost_frames} frames were not played"
            ),
        }
        if self.survey.n_unknown > 0 {
            let n_unknown = self.survey.n_unknown;
            tracing::warn!("recording `{path}` has {n_unknown} messages on channels that it does not describe");
        }
    }

    /// The next frame as it was recorded; none at the end of the file.
    fn read_in_round(&mut self) -> Result<Option<Frame>, McapReadError> {
        loop {
            if self.chunk.is_some() {
                if let Some(frame) = self.read_in_chunk()? {
                    return Ok(Some(frame));
                }
                self.chunk = None;
            }
            match self.file.next().map_err(|source| self.read_error(source))? {
                Found::Record(place) if place.opcode == opcode::CHUNK => {
                    match read_chunk(self.file.walker(), place).map_err(|source| self.read_error(source))? {
                        Ok(chunk) => self.chunk = Some(chunk),
                        Err(reason) => {
                            self.waiting.fill(None);
                            self.stats.bad_chunks += 1;
                            return Err(McapReadError::BadChunk {
                                path: self.path.clone(),
                                offset: place.start,
                                n_bytes: place.n_bytes,
                                reason,
                            });
                        }
                    }
                }
                Found::Record(_) => {}
                Found::Damage { from, to } => {
                    self.waiting.fill(None);
                    self.stats.damages += 1;
                    return Err(McapReadError::Damage {
                        path: self.path.clone(),
                        from,
                        to,
                    });
                }
                Found::End { .. } => return Ok(None),
            }
        }
    }

    fn read_in_chunk(&mut self) -> Result<Option<Frame>, McapReadError> {
        while let Some(chunk) = &mut self.chunk {
            let walker = chunk.walker();
            let head = match walker.step() {
                Ok(Step::Record(place)) => message_head(walker, place),
                Ok(Step::End | Step::Broken) => return Ok(None),
                Err(error) => Err(error),
            };
            // A chunk lies in memory, where reading does not fail.
            let Some(head) = head.unwrap_or(None) else {
                continue;
            };
            if let Some(frame) = self.take_message(head)? {
                return Ok(Some(frame));
            }
        }
        Ok(None)
    }

    fn take_message(&mut self, head: MessageHead) -> Result<Option<Frame>, McapReadError> {
        let channel = self.survey.channels.get(&head.channel).copied();
        let place = |index: usize| self.places.get(index).copied().flatten();
        match channel {
            Some(ChannelUse::Frame(index)) => {
                if let Some(index) = place(index) {
                    self.take_frame_record(index, head)?;
                }
                Ok(None)
            }
            Some(ChannelUse::Image(index)) => match place(index) {
                Some(index) => self.take_image(index, head).map(Some),
                None => Ok(None),
            },
            Some(ChannelUse::Events | ChannelUse::Other) | None => Ok(None),
        }
    }

    fn take_frame_record(&mut self, index: usize, head: MessageHead) -> Result<(), McapReadError> {
        let lonely = self.waiting[index].take();
        let json = self.message_data(head);
        match FrameRecord::parse(&json, &self.cameras[index]) {
            Ok(meta) => self.waiting[index] = Some(meta),
            Err(reason) => {
                self.stats.bad_frames += 1;
                return Err(self.bad_frame(index, head.log_time_ns, reason));
            }
        }
        match lonely {
            Some(meta) => {
                self.stats.bad_frames += 1;
                Err(self.bad_frame(index, meta.timestamp_ns, "its picture is missing".to_owned()))
            }
            None => Ok(()),
        }
    }

    fn take_image(&mut self, index: usize, head: MessageHead) -> Result<Frame, McapReadError> {
        let camera = &self.cameras[index];
        let meta = self.waiting[index]
            .take()
            .filter(|meta| meta.timestamp_ns == head.log_time_ns);
        let picture = match meta {
            Some(meta) => decode_image(self.message_data(head), camera).map(|pixels| (meta, pixels)),
            None => Err("what is known about it is missing or bad".to_owned()),
        };
        match picture {
            Ok((meta, pixels)) => Ok(Frame {
                meta,
                size: camera.size,
                format: camera.format,
                pixels,
            }),
            Err(reason) => {
                self.stats.bad_frames += 1;
                Err(self.bad_frame(index, head.log_time_ns, reason))
            }
        }
    }

    fn message_data(&self, head: MessageHead) -> bytes::Bytes {
        let chunk = self.chunk.as_ref().expect("messages come from a chunk");
        chunk.slice(head.data_start, head.data_bytes)
    }

    fn index_of(&self, frame: &Frame) -> usize {
        let index = self.cameras.iter().position(|camera| camera.name == frame.meta.camera);
        index.expect("frames are made for cameras of this list")
    }

    fn bad_frame(&self, index: usize, timestamp_ns: u64, reason: String) -> McapReadError {
        McapReadError::BadFrame {
            path: self.path.clone(),
            camera: self.cameras[index].name.to_string(),
            timestamp_ns,
            reason,
        }
    }

    fn read_error(&self, source: io::Error) -> McapReadError {
        McapReadError::Read {
            path: self.path.clone(),
            source,
        }
    }
}

impl Source for McapPlayer {
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
        let timestamp_ns = frame.meta.timestamp_ns;
        let pacer = self.pacer.get_or_insert_with(|| Pacer::new(self.pace, timestamp_ns));
        if pacer.wait_for(timestamp_ns, timeout) {
            Ok(Next::Frame(frame))
        } else {
            self.read_ahead = Some(frame);
            Ok(Next::TimedOut)
        }
    }
}
