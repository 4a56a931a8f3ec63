//! JPEGs put together from rows of blocks.
//!
//! Encoding 1280 × 720 takes ten frames' time under emulation. A restart marker after every row of blocks makes the
//! rows independent of each other (ITU-T T.81, F.1.1.5.2 and B.2.4.4): the counter's row can be changed and all others
//! kept, and a scene of patches needs only a few different rows, encoded once and repeated.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageError};

use super::counter::{BLOCK_PX, CONTRAST_LUMA, bits};

/// Quality of the pictures on the scale of libjpeg.
const QUALITY: u8 = 85;

/// Pixels of one row of blocks: RGB, as wide as the picture and 8 high.
pub(super) type BlockRow<'a> = &'a [u8];

/// A picture in JPEG, ready for its counter.
#[derive(Clone, Debug)]
pub(super) struct CountedJpeg {
    /// All before the entropy-coded data; the last segment but one is the comment with the counter.
    header: Vec<u8>,
    scan_header_bytes: usize,
    /// Coefficient of a bright block, quantised.
    amplitude: i32,
    /// Blocks in a row of the picture.
    blocks: usize,
    /// Everything behind the counter's row.
    tail: Vec<u8>,
}

impl CountedJpeg {
    /// Encodes a picture of `width` pixels whose rows of blocks are `rows[order[0]]`, `rows[order[1]]` and so on. The first
    /// of them will be the counter's.
    ///
    /// # Errors
    /// What the encoder refuses.
    ///
    /// # Panics
    /// When the width is not a multiple of 8, or there is no row.
    pub(super) fn encode(width: usize, rows: &[BlockRow<'_>], order: &[usize]) -> Result<Self, ImageError> {
        assert!(width.is_multiple_of(BLOCK_PX) && !order.is_empty(), "whole blocks");
        let encoded = rows
            .iter()
            .map(|row| encode_row(width, row))
            .collect::<Result<Vec<_>, _>>()?;
        let (header, luma_quantiser) = header(&encoded[0], width, order.len() * BLOCK_PX);
        let scan_header_bytes = segments(&header).last().map_or(0, |(_, start, end)| end - start);
        let mut tail = Vec::new();
        for (index, row) in order.iter().enumerate().skip(1) {
            tail.extend([0xFF, 0xD0 + ((index - 1) % 8) as u8]);
            let jpeg = &encoded[*row];
            tail.extend_from_slice(&jpeg[data_start(jpeg)..jpeg.len() - 2]);
        }
        tail.extend([0xFF, 0xD9]);
        // A uniform block of luma 128 + c has the coefficient 8 c.
        let amplitude = (8 * i32::from(CONTRAST_LUMA) + luma_quantiser / 2) / luma_quantiser;
        Ok(Self {
            header,
            scan_header_bytes,
            amplitude,
            blocks: width / BLOCK_PX,
            tail,
        })
    }

    /// Writes the picture with a counter to `out`.
    pub(super) fn write(&self, counter: u64, out: &mut Vec<u8>) {
        out.clear();
        out.extend_from_slice(&self.header);
        let at = out.len() - self.scan_header_bytes - COUNTER_BYTES;
        out[at..at + COUNTER_BYTES].copy_from_slice(&counter.to_be_bytes());
        for byte in self.counter_row(counter).finish() {
            out.push(byte);
            // A zero after 0xFF tells it from a marker.
            if byte == 0xFF {
                out.push(0);
            }
        }
        out.extend_from_slice(&self.tail);
    }

    /// The counter's row of blocks; behind the counter it is grey.
    fn counter_row(&self, counter: u64) -> BitWriter {
        let mut row = BitWriter::default();
        let mut previous = 0;
        let signs = bits(counter).into_iter().flat_map(|bit| [if bit { 1 } else { -1 }, 0]);
        for sign in signs.chain(std::iter::repeat(0)).take(self.blocks) {
            let coefficient = sign * self.amplitude;
            row.luma_difference(coefficient - previous);
            previous = coefficient;
            // End of block of the luma; then for each chroma channel difference 0 and end of block (tables K.3 to K.6).
            row.push(0b1010, 4);
            row.push(0b0000, 4);
            row.push(0b0000, 4);
        }
        row
    }
}

fn encode_row(width: usize, row: BlockRow<'_>) -> Result<Vec<u8>, ImageError> {
    let mut jpeg = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
    encoder.encode(row, width as u32, BLOCK_PX as u32, ExtendedColorType::Rgb8)?;
    Ok(jpeg)
}

/// The segments of a JPEG up to the scan: (marker, where the segment begins, where it ends). The encoder is ours to
/// choose, so it is known to write such.
fn segments(jpeg: &[u8]) -> impl Iterator<Item = (u8, usize, usize)> + '_ {
    let mut at = 2;
    let mut done = false;
    std::iter::from_fn(move || {
        if done {
            return None;
        }
        let (marker, start) = (jpeg[at + 1], at);
        at += 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        done = marker == START_OF_SCAN;
        Some((marker, start, at))
    })
}

const START_OF_FRAME: u8 = 0xC0;
const START_OF_SCAN: u8 = 0xDA;
const QUANTISERS: u8 = 0xDB;
const RESTART_INTERVAL: u8 = 0xDD;
const COMMENT: u8 = 0xFE;
const COMMENT_START: &[u8] = b"frame ";
const COUNTER_BYTES: usize = 8;

/// The frame counter from the comment in a simulated webcam's JPEG; the same as in the picture, without decoding it.
pub fn commented_counter(jpeg: &[u8]) -> Option<u64> {
    let at = jpeg
        .windows(COMMENT_START.len())
        .take(2048)
        .position(|window| window == COMMENT_START)?;
    let digits = jpeg.get(at + COMMENT_START.len()..at + COMMENT_START.len() + COUNTER_BYTES)?;
    Some(u64::from_be_bytes(digits.try_into().ok()?))
}

fn data_start(jpeg: &[u8]) -> usize {
    segments(jpeg).last().map_or(0, |(_, _, end)| end)
}

/// The header of one row's JPEG made that of the whole picture; and the quantiser of the luma's first coefficient.
fn header(row: &[u8], width: usize, height: usize) -> (Vec<u8>, i32) {
    let mut header = row[..2].to_vec();
    let mut luma_quantiser = None;
    for (marker, start, end) in segments(row) {
        if marker == START_OF_SCAN {
            let [high, low] = ((width / BLOCK_PX) as u16).to_be_bytes();
            header.extend([0xFF, RESTART_INTERVAL, 0, 4, high, low]);
            header.extend([0xFF, COMMENT, 0, (2 + COMMENT_START.len() + COUNTER_BYTES) as u8]);
            header.extend(COMMENT_START);
            header.extend([0; COUNTER_BYTES]);
        }
        let at = header.len();
        header.extend_from_slice(&row[start..end]);
        if marker == START_OF_FRAME {
            header[at + 5..at + 7].copy_from_slice(&(height as u16).to_be_bytes());
        }
        if marker == QUANTISERS && luma_quantiser.is_none() {
            luma_quantiser = Some(i32::from(row[start + 5]));
        }
    }
    (header, luma_quantiser.expect("quantisers come before the scan"))
}

#[derive(Default)]
struct BitWriter {
    bytes: Vec<u8>,
    bit_count: usize,
}

impl BitWriter {
    fn push(&mut self, value: u32, count: usize) {
        for bit in (0..count).rev() {
            if self.bit_count.is_multiple_of(8) {
                self.bytes.push(0);
            }
            let last = self.bytes.last_mut().expect("a byte was pushed");
            *last |= ((value >> bit & 1) as u8) << (7 - self.bit_count % 8);
            self.bit_count += 1;
        }
    }

    /// The bytes; what is left of the last is filled with ones, as JPEG has it.
    fn finish(mut self) -> Vec<u8> {
        while !self.bit_count.is_multiple_of(8) {
            self.push(1, 1);
        }
        self.bytes
    }

    /// The difference of a luma coefficient to the last block's (T.81, F.1.2.1.1 and table K.3).
    fn luma_difference(&mut self, difference: i32) {
        const CODES: [(u32, usize); 12] = [
            (0b00, 2),
            (0b010, 3),
            (0b011, 3),
            (0b100, 3),
            (0b101, 3),
            (0b110, 3),
            (0b1110, 4),
            (0b1_1110, 5),
            (0b11_1110, 6),
            (0b111_1110, 7),
            (0b1111_1110, 8),
            (0b1_1111_1110, 9),
        ];
        let size = (i32::BITS - difference.unsigned_abs().leading_zeros()) as usize;
        let (code, length) = CODES[size];
        self.push(code, length);
        // Negative differences are written as one less, in as many bits.
        let bits = if difference < 0 { difference - 1 } else { difference };
        self.push(bits.cast_unsigned() & ((1 << size) - 1), size);
    }
}

#[cfg(test)]
mod tests {
    use super::super::counter;
    use super::*;
    use image::RgbImage;

    fn gradient(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([(x / 2) as u8, (y / 2) as u8, ((x ^ y) & 0xFF) as u8])
        })
    }

    fn encode(picture: &RgbImage) -> CountedJpeg {
        let width = picture.width() as usize;
        let rows: Vec<&[u8]> = picture.as_raw().chunks_exact(width * BLOCK_PX * 3).collect();
        let order: Vec<usize> = (0..rows.len()).collect();
        CountedJpeg::encode(width, &rows, &order).unwrap()
    }

    #[test]
    fn the_counter_changes_and_the_picture_stays() {
        let picture = gradient(640, 480);
        let jpeg = encode(&picture);
        let mut plain = Vec::new();
        JpegEncoder::new_with_quality(&mut plain, QUALITY)
            .encode_image(&picture)
            .unwrap();
        let plain = image::load_from_memory(&plain).unwrap().to_rgb8();
        let mut bytes = Vec::new();
        for value in [0, 1, 0x5555, 0xAAAA, 65_535, 65_536 + 77] {
            jpeg.write(value, &mut bytes);
            assert_eq!(commented_counter(&bytes), Some(value));
            let decoded = image::load_from_memory(&bytes).unwrap().to_rgb8();
            assert_eq!(decoded.dimensions(), (640, 480));
            let read = counter::read(|x, y| decoded.get_pixel(x as u32, y as u32).0[1]);
            assert_eq!(read, Some((value & 0xFFFF) as u16));
            let below = BLOCK_PX * 640 * 3;
            assert!(
                decoded.as_raw()[below..] == plain.as_raw()[below..],
                "the rest decodes as if encoded at once"
            );
        }
    }

    #[test]
    fn rows_are_repeated_as_ordered() {
        let rows = [vec![50_u8; 336 * 8 * 3], vec![200_u8; 336 * 8 * 3]];
        let rows = rows.each_ref().map(Vec::as_slice);
        let jpeg = CountedJpeg::encode(336, &rows, &[0, 1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1]).unwrap();
        let mut bytes = Vec::new();
        jpeg.write(4711, &mut bytes);
        let decoded = image::load_from_memory(&bytes).unwrap().to_luma8();
        let read = counter::read(|x, y| decoded.get_pixel(x as u32, y as u32).0[0]);
        assert_eq!(read, Some(4711));
        let shown: Vec<bool> = (1..12)
            .map(|row| decoded.get_pixel(100, row * 8 + 4).0[0] > 128)
            .collect();
        assert_eq!(
            shown,
            [true, false, true, true, false, false, false, false, false, false, true]
        );
    }
}
