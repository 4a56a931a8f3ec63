//! Writes frames and events as MCAP, chunk by chunk, on the thread of whoever calls.

use std::collections::BTreeMap;
use std::io::{self, BufWriter};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ::mcap::records::MessageHeader;
use ::mcap::{Attachment, Compression, McapError, McapResult, WriteOptions, Writer};

use super::error::Kept;
use super::image::{encode_image, image_schema};
use super::layout::{
    CONFIG_ATTACHMENT, EVENT_SCHEMA, EVENT_SCHEMA_NAME, EVENTS_TOPIC, FRAME_SCHEMA, FRAME_SCHEMA_NAME, FrameRecord,
    RIG_ATTACHMENT, RecordingEvent, channel_metadata, file_metadata, frame_topic, image_topic,
};
use super::output::{Guarded, Output};
use crate::frame::Frame;
use crate::source::CameraDescription;

/// Room for the small writes between pictures; pictures go past it.
const BUFFER_BYTES: usize = 64 << 10;

/// What goes into the file besides frames.
#[derive(Debug, Clone, Default)]
pub(super) struct FileContents {
    /// Text of the rig file.
    pub(super) rig: Option<String>,
    /// Text of the daemon's configuration.
    pub(super) config: Option<String>,
    /// How chunks are compressed.
    pub(super) compression: Option<Compression>,
}

/// The channels of one camera.
struct CameraChannels {
    name: Arc<str>,
    frame: u16,
    image: u16,
}

/// A recording being written.
pub(super) struct McapWriter<O: Output> {
    writer: Writer<BufWriter<Guarded<O>>>,
    channels: Vec<CameraChannels>,
    events_channel: u16,
    message: Vec<u8>,
    length: Arc<AtomicU64>,
    /// Frames and bytes of messages written.
    written: Kept,
    /// What lies in whole chunks.
    finished: Kept,
}

impl<O: Output> McapWriter<O> {
    /// Begins a recording on an empty output.
    pub(super) fn start(output: O, cameras: &[CameraDescription], contents: &FileContents) -> McapResult<Self> {
        let length = Arc::new(AtomicU64::new(0));
        let output = BufWriter::with_capacity(BUFFER_BYTES, Guarded::new(output, length.clone()));
        // Chunks are ended here, between frames, so that none is torn apart.
        let options = WriteOptions::new().compression(contents.compression).chunk_size(None);
        let mut writer = options.create(output)?;
        writer.write_metadata(&file_metadata(cameras))?;
        let texts = [(RIG_ATTACHMENT, &contents.rig), (CONFIG_ATTACHMENT, &contents.config)];
        for (name, text) in texts {
            if let Some(text) = text {
                writer.attach(&attachment(name, text))?;
            }
        }
        let schema = writer.add_schema(EVENT_SCHEMA_NAME, "jsonschema", EVENT_SCHEMA.as_bytes())?;
        let events_channel = writer.add_channel(schema, EVENTS_TOPIC, "json", &BTreeMap::new())?;
        let mut recording = Self {
            writer,
            channels: Vec::with_capacity(cameras.len()),
            events_channel,
            message: Vec::new(),
            length,
            written: Kept::default(),
            finished: Kept::default(),
        };
        for camera in cameras {
            recording.add_camera(camera)?;
        }
        recording.finish_chunk()?;
        Ok(recording)
    }

    /// Makes room for the frames of one more camera.
    pub(super) fn add_camera(&mut self, camera: &CameraDescription) -> McapResult<()> {
        let metadata = channel_metadata(camera);
        let schema = self
            .writer
            .add_schema(FRAME_SCHEMA_NAME, "jsonschema", FRAME_SCHEMA.as_bytes())?;
        let frame = self
            .writer
            .add_channel(schema, &frame_topic(&camera.name), "json", &metadata)?;
        let schema = image_schema(camera.format);
        let schema = self.writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
        let image = self
            .writer
            .add_channel(schema, &image_topic(&camera.name), "protobuf", &metadata)?;
        self.channels.push(CameraChannels {
            name: camera.name.clone(),
            frame,
            image,
        });
        Ok(())
    }

    /// Writes a frame of a camera that was added.
    pub(super) fn write_frame(&mut self, frame: &Frame) -> McapResult<()> {
        let channels = self.channels.iter().find(|channels| channels.name == frame.meta.camera);
        let Some(&CameraChannels {
            frame: frame_channel,
            image,
            ..
        }) = channels
        else {
            return Ok(());
        };
        let record = FrameRecord::new(&frame.meta, frame.size, frame.format);
        self.message.clear();
        serde_json::to_writer(&mut self.message, &record).map_err(io::Error::from)?;
        self.write_message(frame_channel, frame.meta.sequence, frame.meta.timestamp_ns)?;
        encode_image(frame, &mut self.message);
        self.write_message(image, frame.meta.sequence, frame.meta.timestamp_ns)?;
        self.written.frames += 1;
        Ok(())
    }

    /// Writes an event.
    pub(super) fn write_event(&mut self, event: &RecordingEvent) -> McapResult<()> {
        self.message.clear();
        serde_json::to_writer(&mut self.message, event).map_err(io::Error::from)?;
        self.write_message(self.events_channel, 0, event.timestamp_ns)
    }

    fn write_message(&mut self, channel_id: u16, sequence: u64, timestamp_ns: u64) -> McapResult<()> {
        let header = MessageHeader {
            channel_id,
            // MCAP has 32 bits for it and uses them to tell losses; the JSON has all 64.
            sequence: (sequence & u64::from(u32::MAX)) as u32,
            log_time: timestamp_ns,
            publish_time: timestamp_ns,
        };
        self.writer.write_to_known_channel(&header, &self.message)?;
        self.written.bytes += self.message.len() as u64;
        Ok(())
    }

    /// Bytes of messages in the chunk that is open, before compression.
    pub(super) fn chunk_bytes(&self) -> u64 {
        self.written.bytes - self.finished.bytes
    }

    /// Ends the open chunk and hands it to the system: from here on it can be read, whatever comes.
    pub(super) fn finish_chunk(&mut self) -> McapResult<()> {
        self.writer.flush()?;
        self.finished = self.written;
        Ok(())
    }

    /// Frames and bytes of the file in whole chunks, right after [`Self::finish_chunk`].
    pub(super) fn kept(&self) -> Kept {
        Kept {
            frames: self.finished.frames,
            // Relaxed: written by this very thread.
            bytes: self.length.load(Ordering::Relaxed),
        }
    }

    /// Ends the recording with its summary.
    pub(super) fn finish(&mut self) -> McapResult<()> {
        self.finish_chunk()?;
        self.writer.finish()?;
        Ok(())
    }

    /// Gives up after an error: cuts the output to the first `n_bytes` and returns the system's own words.
    pub(super) fn abandon(self, n_bytes: u64, error: McapError) -> io::Error {
        let (mut guarded, _unwritten) = self.writer.into_inner().into_parts();
        let first = guarded.take_error();
        if let Err(error) = guarded.output.cut(n_bytes) {
            // The reader copes with what is left of the chunk that was not finished.
            tracing::warn!("cannot cut the recording to its whole chunks: {error}");
        }
        first.unwrap_or_else(|| io::Error::other(error))
    }
}

fn attachment<'a>(name: &str, text: &'a str) -> Attachment<'a> {
    Attachment {
        log_time: 0,
        create_time: 0,
        name: name.to_owned(),
        media_type: "application/toml".to_owned(),
        data: text.as_bytes().into(),
    }
}
