//! One chunk: its records, checked and decompressed.

use std::io::{self, Cursor, Read, Seek};

use bytes::Bytes;

use super::records::{ChunkHead, Place, RECORD_HEAD_BYTES, Walker};

/// Most bytes of a chunk, a bound on memory: the largest frame there can be, and some.
pub(super) const CHUNK_MAX_BYTES: u64 = 1 << 30;

/// The records of a chunk in memory.
#[derive(Debug)]
pub(super) struct Chunk {
    records: Bytes,
    walker: Walker<Cursor<Bytes>>,
}

impl Chunk {
    fn new(records: Bytes) -> Self {
        let n_bytes = records.len() as u64;
        Self {
            walker: Walker::new(Cursor::new(records.clone()), 0, n_bytes),
            records,
        }
    }

    /// Goes from record to record.
    pub(super) fn walker(&mut self) -> &mut Walker<Cursor<Bytes>> {
        &mut self.walker
    }

    /// The records as an input of their own, and their length.
    pub(super) fn input(&self) -> (Cursor<Bytes>, u64) {
        (Cursor::new(self.records.clone()), self.records.len() as u64)
    }

    /// Bytes of a record that the walker has found, not copied.
    pub(super) fn slice(&self, start: u64, n_bytes: u64) -> Bytes {
        // The walker finds only what lies within the records, and those are in memory.
        self.records.slice(start as usize..(start + n_bytes) as usize)
    }
}

/// Reads a chunk and checks it.
///
/// # Errors
///
/// If the system cannot read, its error; if the chunk is bad, what is wrong in words.
pub(super) fn read_chunk<R: Read + Seek>(file: &mut Walker<R>, place: Place) -> io::Result<Result<Chunk, String>> {
    if place.n_bytes > CHUNK_MAX_BYTES {
        return Ok(Err(format!(
            "it has {} bytes, allowed are {CHUNK_MAX_BYTES}",
            place.n_bytes
        )));
    }
    let content = Bytes::from(file.read_vec(place.start, place.n_bytes)?);
    Ok(check_chunk(&content))
}

fn check_chunk(content: &Bytes) -> Result<Chunk, String> {
    let head = ChunkHead::parse(content).ok_or("it is too short")?;
    let packed = content.slice(head.n_bytes as usize..);
    if head.compressed_bytes != packed.len() as u64 {
        return Err(format!(
            "it has {} bytes of records, its head says {}",
            packed.len(),
            head.compressed_bytes
        ));
    }
    let records = match head.compression {
        "" => packed,
        "lz4" => decompress(&packed, head.uncompressed_bytes)?,
        other => {
            return Err(format!(
                "its compression `{other}` is not supported, allowed are none and `lz4`"
            ));
        }
    };
    if records.len() as u64 != head.uncompressed_bytes {
        return Err(format!(
            "it holds {} bytes, its head says {}",
            records.len(),
            head.uncompressed_bytes
        ));
    }
    if head.crc != 0 && crc32fast::hash(&records) != head.crc {
        return Err("its check sum is wrong".to_owned());
    }
    Ok(Chunk::new(records))
}

fn decompress(packed: &[u8], expected_bytes: u64) -> Result<Bytes, String> {
    if expected_bytes > CHUNK_MAX_BYTES {
        return Err(format!(
            "it would have {expected_bytes} bytes, allowed are {CHUNK_MAX_BYTES}"
        ));
    }
    let bad = |error: io::Error| format!("it cannot be decompressed: {error}");
    let mut records = Vec::new();
    let decoder = lz4::Decoder::new(packed).map_err(bad)?;
    decoder
        .take(expected_bytes + 1)
        .read_to_end(&mut records)
        .map_err(bad)?;
    Ok(records.into())
}

/// The bounds of a chunk's records in the file, if they can be walked without reading them all.
///
/// # Errors
///
/// The system's.
pub(super) fn bounds_in_file<R: Read + Seek>(file: &mut Walker<R>, place: Place) -> io::Result<Option<(u64, u64)>> {
    let n_bytes = place.n_bytes.min(ChunkHead::MAX_BYTES);
    let content = file.read_vec(place.start, n_bytes)?;
    let head = ChunkHead::parse(&content).filter(|head| head.compression.is_empty());
    Ok(head.map(|head| (place.start + head.n_bytes, place.start + place.n_bytes)))
}

/// True if a chunk may begin at `position`: its lengths agree with each other.
///
/// # Errors
///
/// The system's.
pub(super) fn may_begin_at<R: Read + Seek>(file: &mut Walker<R>, position: u64) -> io::Result<bool> {
    let left = file.end().saturating_sub(position);
    if left < RECORD_HEAD_BYTES {
        return Ok(false);
    }
    let bytes = file.read_vec(position, left.min(RECORD_HEAD_BYTES + ChunkHead::MAX_BYTES))?;
    let (length, content) = bytes[1..].split_at(8);
    let length = u64::from_le_bytes(length.try_into().expect("split at 8"));
    let agrees = |head: ChunkHead<'_>| head.n_bytes.checked_add(head.compressed_bytes) == Some(length);
    Ok(length <= left - RECORD_HEAD_BYTES && ChunkHead::parse(content).is_some_and(agrees))
}
