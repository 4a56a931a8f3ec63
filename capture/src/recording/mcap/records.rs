//! The records of an MCAP file, or of a chunk in one, believed no further than they can be checked.
//!
//! A record is one byte that says what it is, eight bytes of length and that many bytes of content.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek};

/// What a record is.
pub(super) mod opcode {
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// Bytes before the content of a record.
pub(super) const RECORD_HEAD_BYTES: u64 = 9;

/// Bytes of a message before its data.
pub(super) const MESSAGE_HEAD_BYTES: u64 = 22;

/// Most bytes of a record that is read for what it says: metadata, channels, our JSON, attachments.
pub(super) const SMALL_RECORD_MAX_BYTES: u64 = 16 << 20;

/// A record and where its content lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) opcode: u8,
    /// First byte of the content.
    pub(super) start: u64,
    /// Bytes of content.
    pub(super) n_bytes: u64,
}

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// A record whose content lies whole within the bounds.
    Record(Place),
    /// The bounds, right after a record.
    End,
    /// Something that is no whole record.
    Broken,
}

/// Goes from record to record between two bounds, reading no more than asked for.
#[derive(Debug)]
pub(super) struct Walker<R> {
    input: R,
    /// Where the input stands, if known.
    stands_at: Option<u64>,
    next: u64,
    end: u64,
}

impl<R: Read + Seek> Walker<R> {
    /// Walks from `start` to `end`, in bytes of the input.
    pub(super) fn new(input: R, start: u64, end: u64) -> Self {
        Self {
            input,
            stands_at: None,
            next: start,
            end,
        }
    }

    /// Where the next record begins.
    pub(super) fn position(&self) -> u64 {
        self.next
    }

    /// Where the walk ends.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Goes on from `position` instead.
    pub(super) fn jump_to(&mut self, position: u64) {
        self.next = position;
    }

    /// The next record; after [`Step::Broken`] the same again.
    pub(super) fn step(&mut self) -> io::Result<Step> {
        let left = self.end.saturating_sub(self.next);
        if left == 0 {
            return Ok(Step::End);
        }
        if left < RECORD_HEAD_BYTES {
            return Ok(Step::Broken);
        }
        let mut head = [0; RECORD_HEAD_BYTES as usize];
        self.read_at(self.next, &mut head)?;
        let [opcode, length @ ..] = head;
        let n_bytes = u64::from_le_bytes(length);
        // There is no record 0; a disk that lost its power may leave zeros.
        if opcode == 0 || n_bytes > left - RECORD_HEAD_BYTES {
            return Ok(Step::Broken);
        }
        let start = self.next + RECORD_HEAD_BYTES;
        self.next = start + n_bytes;
        Ok(Step::Record(Place { opcode, start, n_bytes }))
    }

    /// Reads bytes at `position`.
    pub(super) fn read_at(&mut self, position: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.seek_to(position)?;
        self.input.read_exact(bytes)?;
        self.stands_at = Some(position + bytes.len() as u64);
        Ok(())
    }

    /// Reads `n_bytes` at `position`; takes memory only for what is there.
    pub(super) fn read_vec(&mut self, position: u64, n_bytes: u64) -> io::Result<Vec<u8>> {
        self.seek_to(position)?;
        let mut bytes = Vec::new();
        let n_read = (&mut self.input).take(n_bytes).read_to_end(&mut bytes)?;
        if n_read as u64 != n_bytes {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.stands_at = Some(position + n_bytes);
        Ok(bytes)
    }

    /// Reads the content of a record that says something; none if it is too long to be one of ours.
    pub(super) fn read_small(&mut self, place: Place) -> io::Result<Option<Vec<u8>>> {
        if place.n_bytes > SMALL_RECORD_MAX_BYTES {
            return Ok(None);
        }
        self.read_vec(place.start, place.n_bytes).map(Some)
    }

    /// Reads the head of a message: its channel and its time; none if the record is too short.
    pub(super) fn read_message_head(&mut self, place: Place) -> io::Result<Option<MessageHead>> {
        if place.n_bytes < MESSAGE_HEAD_BYTES {
            return Ok(None);
        }
        let mut head = [0; MESSAGE_HEAD_BYTES as usize];
        self.read_at(place.start, &mut head)?;
        Ok(MessageHead::parse(&head, place))
    }

    fn seek_to(&mut self, position: u64) -> io::Result<()> {
        match self.stands_at.take() {
            // Short steps stay in the buffer of a buffered input.
            Some(stands_at) => {
                let step = i64::try_from(i128::from(position) - i128::from(stands_at)).map_err(io::Error::other)?;
                self.input.seek_relative(step)
            }
            None => self.input.seek(io::SeekFrom::Start(position)).map(drop),
        }
    }

    /// The input, to be used for something else in between.
    pub(super) fn input(&mut self) -> &mut R {
        self.stands_at = None;
        &mut self.input
    }
}

/// Channel and time of a message, and where its data lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MessageHead {
    pub(super) channel: u16,
    pub(super) log_time_ns: u64,
    pub(super) data_start: u64,
    pub(super) data_bytes: u64,
}

impl MessageHead {
    fn parse(head: &[u8], place: Place) -> Option<Self> {
        let mut fields = Fields(head);
        let channel = fields.u16()?;
        let _sequence = fields.u32()?;
        Some(Self {
            channel,
            log_time_ns: fields.u64()?,
            data_start: place.start + MESSAGE_HEAD_BYTES,
            data_bytes: place.n_bytes - MESSAGE_HEAD_BYTES,
        })
    }
}

/// The fields of a record, taken off one by one; none once they do not fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn take(&mut self, n_bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(n_bytes)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.take(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.take(4)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.take(8)?.try_into().ok().map(u64::from_le_bytes)
    }

    pub(super) fn text(&mut self) -> Option<&'a str> {
        let n_bytes = usize::try_from(self.u32()?).ok()?;
        std::str::from_utf8(self.take(n_bytes)?).ok()
    }

    pub(super) fn text_map(&mut self) -> Option<BTreeMap<String, String>> {
        let n_bytes = usize::try_from(self.u32()?).ok()?;
        let mut entries = Fields(self.take(n_bytes)?);
        let mut map = BTreeMap::new();
        while !entries.0.is_empty() {
            map.insert(entries.text()?.to_owned(), entries.text()?.to_owned());
        }
        Some(map)
    }
}

/// A channel as its record describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChannelRecord {
    pub(super) id: u16,
    pub(super) topic: String,
    pub(super) metadata: BTreeMap<String, String>,
}

impl ChannelRecord {
    /// Reads the content of a channel record; none if it is not one.
    pub(super) fn parse(content: &[u8]) -> Option<Self> {
        let mut fields = Fields(content);
        let id = fields.u16()?;
        let _schema = fields.u16()?;
        let topic = fields.text()?.to_owned();
        let _encoding = fields.text()?;
        Some(Self {
            id,
            topic,
            metadata: fields.text_map()?,
        })
    }
}

/// What a chunk says before its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ChunkHead<'a> {
    pub(super) uncompressed_bytes: u64,
    /// Check sum of the records before compression; 0 if there is none.
    pub(super) crc: u32,
    /// Name of the compression; empty for none.
    pub(super) compression: &'a str,
    pub(super) compressed_bytes: u64,
    /// Bytes of the head itself.
    pub(super) n_bytes: u64,
}

impl<'a> ChunkHead<'a> {
    /// Most bytes of a head: every compression's name is short.
    pub(super) const MAX_BYTES: u64 = 64;

    /// Reads the first bytes of a chunk's content; none if it is no chunk.
    pub(super) fn parse(content: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(content);
        let _times = (fields.u64()?, fields.u64()?);
        let uncompressed_bytes = fields.u64()?;
        let crc = fields.u32()?;
        let compression = fields.text()?;
        let compressed_bytes = fields.u64()?;
        Some(Self {
            uncompressed_bytes,
            crc,
            compression,
            compressed_bytes,
            n_bytes: (content.len() - fields.0.len()) as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn records_are_found_and_broken_ones_told() {
        let mut bytes = vec![opcode::METADATA];
        bytes.extend(3u64.to_le_bytes());
        bytes.extend([1, 2, 3]);
        bytes.push(opcode::CHUNK);
        bytes.extend(u64::MAX.to_le_bytes());
        let n_bytes = bytes.len() as u64;
        let mut walker = Walker::new(Cursor::new(bytes), 0, n_bytes);
        let Step::Record(place) = walker.step().unwrap() else {
            panic!()
        };
        assert_eq!((place.opcode, place.start, place.n_bytes), (opcode::METADATA, 9, 3));
        assert_eq!(walker.read_small(place).unwrap().unwrap(), [1, 2, 3]);
        assert_eq!(walker.step().unwrap(), Step::Broken);
        assert_eq!(walker.step().unwrap(), Step::Broken);
        assert_eq!(walker.position(), 12);
    }

    proptest! {
        #[test]
        fn no_bytes_panic_or_go_on_for_ever(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let n_bytes = bytes.len() as u64;
            let mut walker = Walker::new(Cursor::new(&bytes), 0, n_bytes);
            let mut n_steps = 0;
            while let Step::Record(place) = walker.step().unwrap() {
                walker.read_message_head(place).unwrap();
                n_steps += 1;
            }
            prop_assert!(n_steps <= bytes.len() / 9);
            let _ = (ChannelRecord::parse(&bytes), ChunkHead::parse(&bytes), Fields(&bytes).text_map());
        }
    }
}
