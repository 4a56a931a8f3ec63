//! What a recording holds, found without reading its pictures.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Seek};
use std::path::Path;

use super::chunk::{bounds_in_file, read_chunk};
use super::file::{Ending, Found, McapFile};
use super::layout::{
    EVENTS_TOPIC, FORMAT_VERSION, METADATA_NAME, RIG_ATTACHMENT, camera_of_channel, frame_topic, image_topic,
};
use super::read_error::McapReadError;
use super::records::{ChannelRecord, Fields, MessageHead, Place, Step, Walker, opcode};
use crate::source::{CAMERAS_MAX, CameraDescription, CameraRole};

/// What a channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ChannelUse {
    /// What is known about the frames of the camera with this index.
    Frame(usize),
    /// Its pictures.
    Image(usize),
    /// Events.
    Events,
    /// Something that is not ours.
    Other,
}

/// A camera of a recording.
#[derive(Debug, Clone)]
pub(in crate::recording) struct SurveyedCamera {
    pub(in crate::recording) description: CameraDescription,
    /// Messages on its image channel.
    pub(super) n_frames: u64,
}

/// What a recording holds.
#[derive(Debug)]
pub(in crate::recording) struct Survey {
    pub(in crate::recording) cameras: Vec<SurveyedCamera>,
    pub(super) channels: HashMap<u16, ChannelUse>,
    /// The metadata record.
    pub(in crate::recording) metadata: BTreeMap<String, String>,
    /// Text of the rig file, if there is one.
    pub(in crate::recording) rig: Option<String>,
    pub(in crate::recording) ending: Ending,
    /// Number of messages on channels that are nowhere described.
    pub(super) n_unknown: u64,
    /// Bytes that are no records.
    pub(in crate::recording) damaged_bytes: u64,
}

impl Survey {
    /// Goes through a file from its first record to its last and checks what it must have to be played.
    pub(super) fn of(path: &Path, file: &mut McapFile) -> Result<Self, McapReadError> {
        let mut survey = Self {
            cameras: Vec::new(),
            channels: HashMap::new(),
            metadata: BTreeMap::new(),
            rig: None,
            ending: Ending::Complete,
            n_unknown: 0,
            damaged_bytes: 0,
        };
        let mut surveyor = Surveyor {
            path,
            file,
            survey: &mut survey,
            counts: BTreeMap::new(),
            last_chunk: None,
            indexes: Vec::new(),
        };
        surveyor.run()?;
        survey.check(path)?;
        file.rewind();
        Ok(survey)
    }

    /// Index of the leading camera.
    pub(super) fn leader(&self) -> Option<usize> {
        self.cameras
            .iter()
            .position(|camera| camera.description.role == CameraRole::Scene)
    }

    fn check(&self, path: &Path) -> Result<(), McapReadError> {
        let path = path.to_path_buf();
        let Some(version) = self.metadata.get("format_version") else {
            return Err(McapReadError::Foreign { path });
        };
        if *version != FORMAT_VERSION.to_string() {
            let found = version.clone();
            return Err(McapReadError::Version { path, found });
        }
        let leads = |camera: &&SurveyedCamera| camera.description.role == CameraRole::Scene;
        let n_leaders = self.cameras.iter().filter(leads).count();
        if n_leaders != 1 {
            return Err(McapReadError::Leader { path, n_leaders });
        }
        Ok(())
    }
}

/// A survey under way.
struct Surveyor<'a> {
    path: &'a Path,
    file: &'a mut McapFile,
    survey: &'a mut Survey,
    /// Messages per channel.
    counts: BTreeMap<u16, u64>,
    /// The chunk that was passed last, until it is clear what it holds.
    last_chunk: Option<Place>,
    /// Channels and numbers of messages in it, from the indexes behind it.
    indexes: Vec<(u16, u64)>,
}

impl Surveyor<'_> {
    fn run(&mut self) -> Result<(), McapReadError> {
        loop {
            match self.read(McapFile::next)? {
                Found::Record(place) => self.take_record(place)?,
                Found::Damage { from, to } => {
                    self.settle_last_chunk()?;
                    self.survey.damaged_bytes += to - from;
                }
                Found::End { is_complete, broken_at } => {
                    self.settle_last_chunk()?;
                    self.count();
                    self.survey.ending = self.ending(is_complete, broken_at)?;
                    return Ok(());
                }
            }
        }
    }

    fn take_record(&mut self, place: Place) -> Result<(), McapReadError> {
        if place.opcode == opcode::MESSAGE_INDEX {
            let content = self.read(|file| file.walker().read_small(place))?;
            self.indexes.extend(content.and_then(|content| parse_index(&content)));
            return Ok(());
        }
        self.settle_chunk()?;
        match place.opcode {
            opcode::CHUNK => self.last_chunk = Some(place),
            opcode::CHANNEL => {
                let content = self.read(|file| file.walker().read_small(place))?;
                self.take_channel(content.as_deref().unwrap_or_default())?;
            }
            opcode::METADATA => {
                let content = self.read(|file| file.walker().read_small(place))?;
                self.take_metadata(content.as_deref().unwrap_or_default());
            }
            opcode::ATTACHMENT => {
                let content = self.read(|file| file.walker().read_small(place))?;
                self.take_attachment(content.as_deref().unwrap_or_default());
            }
            _ => {}
        }
        Ok(())
    }

    /// The same where what follows the chunk is missing: some of its indexes may be too.
    fn settle_last_chunk(&mut self) -> Result<(), McapReadError> {
        self.indexes.clear();
        self.settle_chunk()
    }

    /// Counts what the chunk passed last holds; looks into it where the indexes do not tell.
    fn settle_chunk(&mut self) -> Result<(), McapReadError> {
        let indexes = std::mem::take(&mut self.indexes);
        let Some(place) = self.last_chunk.take() else {
            return Ok(());
        };
        let is_known = |(channel, _): &(u16, u64)| self.survey.channels.contains_key(channel);
        if indexes.is_empty() || !indexes.iter().all(is_known) {
            let mut channels = Vec::new();
            let mut counts = BTreeMap::new();
            self.read(|file| {
                walk_chunk(file, place, |walker, place| {
                    match place.opcode {
                        opcode::CHANNEL => channels.extend(walker.read_small(place)?),
                        opcode::MESSAGE => {
                            if let Some(head) = walker.read_message_head(place)? {
                                *counts.entry(head.channel).or_default() += 1;
                            }
                        }
                        _ => {}
                    }
                    Ok(())
                })
            })?;
            for channel in &channels {
                self.take_channel(channel)?;
            }
            self.add_counts(counts);
        } else {
            self.add_counts(indexes);
        }
        Ok(())
    }

    fn add_counts(&mut self, counts: impl IntoIterator<Item = (u16, u64)>) {
        for (channel, n_messages) in counts {
            *self.counts.entry(channel).or_default() += n_messages;
        }
    }

    fn take_channel(&mut self, content: &[u8]) -> Result<(), McapReadError> {
        let Some(channel) = ChannelRecord::parse(content) else {
            return Ok(());
        };
        let channel_use = if channel.topic == EVENTS_TOPIC {
            ChannelUse::Events
        } else if channel.metadata.contains_key("camera") {
            self.take_camera(&channel).map_err(|reason| McapReadError::Channel {
                path: self.path.to_path_buf(),
                topic: channel.topic.clone(),
                reason,
            })?
        } else {
            ChannelUse::Other
        };
        self.survey.channels.insert(channel.id, channel_use);
        Ok(())
    }

    fn take_camera(&mut self, channel: &ChannelRecord) -> Result<ChannelUse, String> {
        let description = camera_of_channel(&channel.metadata)?;
        let name = description.name.clone();
        let cameras = &mut self.survey.cameras;
        let index = match cameras.iter().position(|camera| camera.description.name == name) {
            Some(index) if cameras[index].description == description => index,
            Some(_) => return Err("another channel says other things of its camera".to_owned()),
            None if cameras.len() == CAMERAS_MAX => return Err(format!("there are more than {CAMERAS_MAX} cameras")),
            None => {
                cameras.push(SurveyedCamera {
                    description,
                    n_frames: 0,
                });
                cameras.len() - 1
            }
        };
        if channel.topic == frame_topic(&name) {
            Ok(ChannelUse::Frame(index))
        } else if channel.topic == image_topic(&name) {
            Ok(ChannelUse::Image(index))
        } else {
            Ok(ChannelUse::Other)
        }
    }

    fn take_metadata(&mut self, content: &[u8]) {
        let mut fields = Fields(content);
        if fields.text() == Some(METADATA_NAME)
            && let Some(metadata) = fields.text_map()
        {
            self.survey.metadata = metadata;
        }
    }

    fn take_attachment(&mut self, content: &[u8]) {
        let mut fields = Fields(content);
        let rig = (|| {
            let _times = (fields.u64()?, fields.u64()?);
            let is_rig = fields.text()? == RIG_ATTACHMENT;
            let _media_type = fields.text()?;
            let n_bytes = usize::try_from(fields.u64()?).ok()?;
            let text = std::str::from_utf8(fields.take(n_bytes)?).ok()?;
            is_rig.then(|| text.to_owned())
        })();
        if rig.is_some() {
            self.survey.rig = rig;
        }
    }

    fn count(&mut self) {
        for (channel, n_messages) in &self.counts {
            match self.survey.channels.get(channel) {
                Some(ChannelUse::Image(index)) => self.survey.cameras[*index].n_frames += n_messages,
                Some(ChannelUse::Frame(_) | ChannelUse::Events | ChannelUse::Other) => {}
                None => self.survey.n_unknown += n_messages,
            }
        }
    }

    fn ending(&mut self, is_complete: bool, broken_at: Option<u64>) -> Result<Ending, McapReadError> {
        let Some(position) = broken_at else {
            return Ok(if is_complete {
                Ending::Complete
            } else {
                Ending::NoSummary
            });
        };
        let channels = std::mem::take(&mut self.survey.channels);
        let is_frame = |channel| matches!(channels.get(&channel), Some(ChannelUse::Frame(_)));
        let lost_frames = self.read(|file| file.count_in_broken_chunk(position, is_frame));
        self.survey.channels = channels;
        Ok(Ending::CutOff {
            lost_bytes: self.file.n_bytes() - position,
            lost_frames: lost_frames?,
        })
    }

    fn read<T>(&mut self, read: impl FnOnce(&mut McapFile) -> io::Result<T>) -> Result<T, McapReadError> {
        read(self.file).map_err(|source| McapReadError::Read {
            path: self.path.to_path_buf(),
            source,
        })
    }
}

/// Channel and number of messages of an index.
fn parse_index(content: &[u8]) -> Option<(u16, u64)> {
    /// Bytes of one entry: time and place.
    const ENTRY_BYTES: u64 = 16;
    let mut fields = Fields(content);
    Some((fields.u16()?, u64::from(fields.u32()?) / ENTRY_BYTES))
}

/// Something whose records can be walked.
pub(super) trait ReadSeek: Read + Seek {}

impl<T: Read + Seek> ReadSeek for T {}

/// Goes through the records of a chunk. One without compression is walked in the file, so that its pictures are not
/// read, and its check sum not either; a bad one ends where it is bad.
pub(super) fn walk_chunk(
    file: &mut McapFile,
    place: Place,
    mut visit: impl FnMut(&mut Walker<&mut dyn ReadSeek>, Place) -> io::Result<()>,
) -> io::Result<()> {
    let mut walk = |input: &mut dyn ReadSeek, start, end| {
        let mut walker = Walker::new(input, start, end);
        while let Step::Record(place) = walker.step()? {
            visit(&mut walker, place)?;
        }
        Ok(())
    };
    if let Some((start, end)) = bounds_in_file(file.walker(), place)? {
        return walk(file.walker().input(), start, end);
    }
    match read_chunk(file.walker(), place)? {
        Ok(chunk) => {
            let (mut input, end) = chunk.input();
            walk(&mut input, 0, end)
        }
        // Whoever plays the file is told.
        Err(_) => Ok(()),
    }
}

/// The head of a message, if the record is one.
pub(super) fn message_head<R: Read + Seek>(walker: &mut Walker<R>, place: Place) -> io::Result<Option<MessageHead>> {
    if place.opcode == opcode::MESSAGE {
        walker.read_message_head(place)
    } else {
        Ok(None)
    }
}
