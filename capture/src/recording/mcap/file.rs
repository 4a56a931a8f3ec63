//! An MCAP file from record to record: over damage, to wherever it ends.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use serde::Serialize;

use super::chunk::{bounds_in_file, may_begin_at};
use super::read_error::McapReadError;
use super::records::{Place, RECORD_HEAD_BYTES, Step, Walker, opcode};

/// First and last bytes of every MCAP file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// How much of a file is searched at once for the next chunk after damage.
const SEARCH_BYTES: u64 = 1 << 20;

/// How a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(tag = "how", rename_all = "snake_case")]
pub enum Ending {
    /// As it should, with its summary.
    Complete,
    /// After a whole record, without its summary: recording was broken off, nothing that was written is lost.
    NoSummary,
    /// In the middle of a record.
    CutOff {
        /// Bytes of that record, which are not played.
        lost_bytes: u64,
        /// Frames that were begun in them; only what a chunk without compression still shows.
        lost_frames: u64,
    },
}

/// What comes next in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    Record(Place),
    /// Bytes that are no records, before one that is again.
    Damage {
        from: u64,
        to: u64,
    },
    End {
        /// True if the footer and the last bytes are there.
        is_complete: bool,
        /// Where an incomplete record begins.
        broken_at: Option<u64>,
    },
}

/// The records of a file, chunks as a whole.
#[derive(Debug)]
pub(super) struct McapFile {
    walker: Walker<BufReader<File>>,
    n_bytes: u64,
    has_last_bytes: bool,
    has_data_end: bool,
    has_footer: bool,
}

impl McapFile {
    /// Opens a file and checks its first bytes.
    pub(super) fn open(path: &Path) -> Result<Self, McapReadError> {
        let open_error = |source| McapReadError::Open {
            path: path.to_path_buf(),
            source,
        };
        let mut file = BufReader::new(File::open(path).map_err(open_error)?);
        let n_bytes = file.seek(io::SeekFrom::End(0)).map_err(open_error)?;
        let mut magic = [0; MAGIC.len()];
        let n_magic = MAGIC.len() as u64;
        let mut reads_magic_at = |position| -> io::Result<bool> {
            file.seek(io::SeekFrom::Start(position))?;
            file.read_exact(&mut magic)?;
            Ok(magic == MAGIC)
        };
        if n_bytes < n_magic || !reads_magic_at(0).map_err(open_error)? {
            return Err(McapReadError::NotMcap {
                path: path.to_path_buf(),
            });
        }
        let has_last_bytes = n_bytes >= 2 * n_magic && reads_magic_at(n_bytes - n_magic).map_err(open_error)?;
        let end = if has_last_bytes { n_bytes - n_magic } else { n_bytes };
        Ok(Self {
            walker: Walker::new(file, n_magic, end),
            n_bytes,
            has_last_bytes,
            has_data_end: false,
            has_footer: false,
        })
    }

    /// Length of the file in bytes.
    pub(super) fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    /// Begins again with the first record.
    pub(super) fn rewind(&mut self) {
        self.walker.jump_to(MAGIC.len() as u64);
        self.has_data_end = false;
        self.has_footer = false;
    }

    /// Reads what the records say.
    pub(super) fn walker(&mut self) -> &mut Walker<BufReader<File>> {
        &mut self.walker
    }

    /// The next record. After the end it says so again.
    pub(super) fn next(&mut self) -> io::Result<Found> {
        match self.walker.step()? {
            Step::Record(place) => {
                self.has_data_end |= place.opcode == opcode::DATA_END;
                self.has_footer |= place.opcode == opcode::FOOTER;
                Ok(Found::Record(place))
            }
            Step::End => Ok(Found::End {
                is_complete: self.has_footer && self.has_last_bytes,
                broken_at: None,
            }),
            Step::Broken => {
                let from = self.walker.position();
                // Behind the data there is only the summary, which nothing needs.
                let next_chunk = if self.has_data_end {
                    None
                } else {
                    self.find_chunk(from + 1)?
                };
                if let Some(to) = next_chunk {
                    self.walker.jump_to(to);
                    return Ok(Found::Damage { from, to });
                }
                Ok(Found::End {
                    is_complete: false,
                    broken_at: (!self.has_data_end).then_some(from),
                })
            }
        }
    }

    /// Where the next chunk begins, from `position` on.
    fn find_chunk(&mut self, mut position: u64) -> io::Result<Option<u64>> {
        let end = self.walker.end();
        while position < end {
            let bytes = self.walker.read_vec(position, SEARCH_BYTES.min(end - position))?;
            for (offset, _) in bytes.iter().enumerate().filter(|(_, byte)| **byte == opcode::CHUNK) {
                // Most places are told apart by the length's upper bytes, without another read.
                let high = bytes.get(offset + 6..offset + 9);
                if high.is_none_or(|high| high == [0; 3]) && may_begin_at(&mut self.walker, position + offset as u64)? {
                    return Ok(Some(position + offset as u64));
                }
            }
            position += bytes.len() as u64;
        }
        Ok(None)
    }

    /// Counts the messages in an incomplete chunk that begins at `position`, as far as they can be told, on channels
    /// for which `counts` is true.
    pub(super) fn count_in_broken_chunk(&mut self, position: u64, counts: impl Fn(u16) -> bool) -> io::Result<u64> {
        let left = self.walker.end().saturating_sub(position);
        if left < RECORD_HEAD_BYTES || self.walker.read_vec(position, 1)? != [opcode::CHUNK] {
            return Ok(0);
        }
        let rest = Place {
            opcode: opcode::CHUNK,
            start: position + RECORD_HEAD_BYTES,
            n_bytes: left - RECORD_HEAD_BYTES,
        };
        let Some((start, end)) = bounds_in_file(&mut self.walker, rest)? else {
            return Ok(0);
        };
        let mut walker = Walker::new(self.walker.input(), start, end);
        let mut n_messages = 0;
        while let Step::Record(place) = walker.step()? {
            if place.opcode == opcode::MESSAGE {
                let head = walker.read_message_head(place)?;
                n_messages += u64::from(head.is_some_and(|head| counts(head.channel)));
            }
        }
        Ok(n_messages)
    }
}
