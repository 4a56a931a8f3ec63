//! A JPEG whose frame counter can be changed without encoding it anew.
//!
//! Encoding 1280 × 720 takes longer than a frame lasts under emulation. The counter's row of blocks is therefore
//! written by hand in front of the entropy-coded rest, which stays as it is while the view does. Two properties
//! make this exact: every counter's bits are equally many, as a bright and a dark block differ in the sign of their
//! coefficient only; and the row ends on grey, where the rest's prediction starts (ITU-T T.81, F.1.2.1).

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageError, RgbImage};

use super::counter::{BLOCK_PX, CONTRAST_LUMA, COUNTER_ROWS, bits};

/// Quality of the pictures on the scale of libjpeg.
const QUALITY: u8 = 85;

/// A picture in JPEG, ready for its counter.
#[derive(Clone, Debug)]
pub(super) struct CountedJpeg {
    /// All before the entropy-coded data.
    header: Vec<u8>,
    /// Coefficient of a bright block, quantised.
    amplitude: i32,
    /// Blocks in a row of the picture.
    blocks: usize,
    /// The rest's first bits, which share a byte with the last of the counter's row.
    first_bits: u8,
    /// The rest, moved to fit behind, with its stuffing and the end of the picture.
    tail: Vec<u8>,
}

impl CountedJpeg {
    /// Encodes a picture; its top rows will be the counter's.
    ///
    /// # Errors
    /// What the encoder refuses.
    ///
    /// # Panics
    /// When a side is not a multiple of 8.
    pub(super) fn encode(picture: &RgbImage) -> Result<Self, ImageError> {
        let (width, height) = picture.dimensions();
        assert!(width % 8 == 0 && height % 8 == 0, "whole blocks");
        let skipped = COUNTER_ROWS * width as usize * 3;
        let mut encoded = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut encoded, QUALITY);
        let rest = &picture.as_raw()[skipped..];
        let mut encoder = encoder;
        encoder.encode(rest, width, height - COUNTER_ROWS as u32, ExtendedColorType::Rgb8)?;

        let (data_at, luma_quantiser) = prepare_header(&mut encoded, height);
        let entropy = &encoded[data_at..encoded.len() - 2];
        // A uniform block of luma 128 + c has the coefficient 8 c.
        let amplitude = (8 * i32::from(CONTRAST_LUMA) + luma_quantiser / 2) / luma_quantiser;
        let mut jpeg = Self {
            header: encoded[..data_at].to_vec(),
            amplitude,
            blocks: width as usize / BLOCK_PX,
            first_bits: 0,
            tail: Vec::new(),
        };
        let offset_bits = jpeg.counter_row(0).bit_count % 8;
        let (first_bits, tail) = shift(&unstuff(entropy), offset_bits);
        jpeg.first_bits = first_bits;
        stuff(&tail, &mut jpeg.tail);
        jpeg.tail.extend([0xFF, 0xD9]);
        Ok(jpeg)
    }

    /// Writes the picture with a counter to `out`.
    pub(super) fn write(&self, counter: u64, out: &mut Vec<u8>) {
        out.clear();
        out.extend_from_slice(&self.header);
        let mut row = self.counter_row(counter);
        if !row.bit_count.is_multiple_of(8) {
            *row.bytes.last_mut().expect("the counter has bits") |= self.first_bits;
        }
        stuff(&row.bytes, out);
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

/// Writes the full height into the frame header; returns where the entropy-coded data begin, and the quantiser of
/// the luma's first coefficient. The encoder is ours to choose, so a header it does not write is a mistake of ours.
fn prepare_header(jpeg: &mut [u8], height: u32) -> (usize, i32) {
    let mut at = 2;
    let mut luma_quantiser = None;
    loop {
        let marker = jpeg[at + 1];
        let length = usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        match marker {
            0xDB if luma_quantiser.is_none() => luma_quantiser = Some(i32::from(jpeg[at + 5])),
            0xC0 => jpeg[at + 5..at + 7].copy_from_slice(&(height as u16).to_be_bytes()),
            0xDA => {
                return (
                    at + 2 + length,
                    luma_quantiser.expect("quantisers come before the scan"),
                );
            }
            _ => {}
        }
        at += 2 + length;
    }
}

/// Removes the zero that follows every byte 0xFF in entropy-coded data.
fn unstuff(data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(data.len());
    let mut previous = 0;
    for &byte in data {
        if !(previous == 0xFF && byte == 0) {
            out.push(byte);
        }
        previous = byte;
    }
    out
}

fn stuff(data: &[u8], out: &mut Vec<u8>) {
    for &byte in data {
        out.push(byte);
        if byte == 0xFF {
            out.push(0);
        }
    }
}

/// Moves data back by some bits, 0 to 7: what falls into the byte before, and the rest. Freed bits at the end are 1,
/// as JPEG fills them.
fn shift(data: &[u8], bits: usize) -> (u8, Vec<u8>) {
    if bits == 0 {
        return (0, data.to_vec());
    }
    let mut out = Vec::with_capacity(data.len());
    for (index, byte) in data.iter().enumerate() {
        let next = data.get(index + 1).copied().unwrap_or(0xFF);
        out.push(byte << (8 - bits) | next >> bits);
    }
    (data.first().map_or(0, |byte| byte >> bits), out)
}

#[cfg(test)]
mod tests {
    use super::super::counter;
    use super::*;

    fn gradient(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([(x / 2) as u8, (y / 2) as u8, ((x ^ y) & 0xFF) as u8])
        })
    }

    #[test]
    fn the_counter_changes_and_the_picture_stays() {
        let picture = gradient(640, 480);
        let jpeg = CountedJpeg::encode(&picture).unwrap();
        let mut plain = Vec::new();
        JpegEncoder::new_with_quality(&mut plain, QUALITY)
            .encode_image(&picture)
            .unwrap();
        let plain = image::load_from_memory(&plain).unwrap().to_rgb8();
        let mut bytes = Vec::new();
        for value in [0, 1, 0x5555, 0xAAAA, 65_535, 65_536 + 77] {
            jpeg.write(value, &mut bytes);
            let decoded = image::load_from_memory(&bytes).unwrap().to_rgb8();
            assert_eq!(decoded.dimensions(), (640, 480));
            let read = counter::read(|x, y| decoded.get_pixel(x as u32, y as u32).0[1]);
            assert_eq!(read, Some((value & 0xFFFF) as u16));
            let below = COUNTER_ROWS * 640 * 3;
            assert!(
                decoded.as_raw()[below..] == plain.as_raw()[below..],
                "the rest decodes as if encoded at once"
            );
        }
    }

    #[test]
    fn every_width_of_ours_and_every_shift_works() {
        for (width, height) in [(320, 240), (1280, 720), (328, 16), (336, 24)] {
            let jpeg = CountedJpeg::encode(&gradient(width, height)).unwrap();
            let mut bytes = Vec::new();
            jpeg.write(4711, &mut bytes);
            let decoded = image::load_from_memory(&bytes).unwrap().to_luma8();
            let read = counter::read(|x, y| decoded.get_pixel(x as u32, y as u32).0[0]);
            assert_eq!(read, Some(4711), "{width} x {height}");
        }
    }

    #[test]
    fn shifting_moves_every_bit() {
        assert_eq!(
            shift(&[0b1010_0101, 0b1100_0011], 3),
            (0b0001_0100, vec![0b1011_1000, 0b0111_1111])
        );
        assert_eq!(shift(&[1, 2], 0), (0, vec![1, 2]));
    }
}
