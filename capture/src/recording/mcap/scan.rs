//! Goes through all that is known about the frames of a recording, and through its events, without its pictures.

use std::io;
use std::path::Path;

use super::file::{Found, McapFile};
use super::layout::{FrameRecord, RecordingEvent};
use super::read_error::McapReadError;
use super::records::{SMALL_RECORD_MAX_BYTES, opcode};
use super::survey::{ChannelUse, Survey, message_head, walk_chunk};
use crate::frame::FrameMeta;

/// Something found in a recording.
#[derive(Debug)]
pub(in crate::recording) enum Seen {
    /// What is known about a frame of the camera with this index in the survey.
    Frame(usize, FrameMeta),
    /// A frame of this camera of which nothing can be known.
    BadFrame(usize),
    Event(RecordingEvent),
}

/// Visits every frame and event in the order of the file and returns what the file holds.
///
/// Check sums are not looked at: that takes reading the pictures.
pub(in crate::recording) fn scan(
    path: &Path,
    mut visit: impl FnMut(&Survey, Seen),
) -> Result<(Survey, u64), McapReadError> {
    let mut file = McapFile::open(path)?;
    let survey = Survey::of(path, &mut file)?;
    let n_bytes = file.n_bytes();
    let read_error = |source| McapReadError::Read {
        path: path.to_path_buf(),
        source,
    };
    loop {
        match file.next().map_err(read_error)? {
            Found::Record(place) if place.opcode == opcode::CHUNK => {
                scan_chunk(&mut file, place, &survey, &mut visit).map_err(read_error)?;
            }
            Found::Record(_) | Found::Damage { .. } => {}
            Found::End { .. } => return Ok((survey, n_bytes)),
        }
    }
}

fn scan_chunk(
    file: &mut McapFile,
    chunk: super::records::Place,
    survey: &Survey,
    visit: &mut impl FnMut(&Survey, Seen),
) -> io::Result<()> {
    walk_chunk(file, chunk, |walker, place| {
        let Some(head) = message_head(walker, place)? else {
            return Ok(());
        };
        let channel = survey.channels.get(&head.channel).copied();
        let wanted = matches!(channel, Some(ChannelUse::Frame(_) | ChannelUse::Events));
        if !wanted || head.data_bytes > SMALL_RECORD_MAX_BYTES {
            return Ok(());
        }
        let json = walker.read_vec(head.data_start, head.data_bytes)?;
        match channel {
            Some(ChannelUse::Frame(index)) => {
                let meta = FrameRecord::parse(&json, &survey.cameras[index].description);
                visit(
                    survey,
                    meta.map_or(Seen::BadFrame(index), |meta| Seen::Frame(index, meta)),
                );
            }
            Some(ChannelUse::Events) => {
                if let Ok(event) = serde_json::from_slice(&json) {
                    visit(survey, Seen::Event(event));
                }
            }
            Some(ChannelUse::Image(_) | ChannelUse::Other) | None => {}
        }
        Ok(())
    })
}
