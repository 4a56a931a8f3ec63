//! The frame counter in the picture: which frame of the sensor is this?
//!
//! The top 8 rows hold 20 bits, each two blocks of 8 × 8 pixels wide: a block that is bright for 1 and dark for 0,
//! then a grey one. Blocks of this size come through JPEG unharmed, whatever its quality. 16 bits count frames, 4
//! guard them.

/// Rows that the counter takes.
pub const COUNTER_ROWS: usize = 8;
/// Width of a block in pixels.
pub const BLOCK_PX: usize = 8;
/// Bits of the counter.
pub const COUNTER_BITS: usize = 20;
/// Width that the counter takes.
pub const COUNTER_WIDTH_PX: usize = COUNTER_BITS * 2 * BLOCK_PX;
/// Luma of grey blocks.
pub const GREY_LUMA: u8 = 128;
/// Difference in luma between grey and a bright or dark block.
pub const CONTRAST_LUMA: u8 = 80;

/// The bits for a counter, the most significant first; of the counter its low 16 bits are shown.
pub fn bits(counter: u64) -> [bool; COUNTER_BITS] {
    let counter = (counter & 0xFFFF) as u32;
    let word = counter << 4 | check(counter);
    std::array::from_fn(|index| word >> (COUNTER_BITS - 1 - index) & 1 == 1)
}

/// Luma of the blocks from left to right.
pub fn block_luma(counter: u64) -> impl Iterator<Item = u8> {
    bits(counter).into_iter().flat_map(|bit| {
        let luma = if bit {
            GREY_LUMA + CONTRAST_LUMA
        } else {
            GREY_LUMA - CONTRAST_LUMA
        };
        [luma, GREY_LUMA]
    })
}

/// Reads the counter, modulo 65536, from a picture's luma at (x, y); `None` where there is none or its guard fails.
pub fn read(luma: impl Fn(usize, usize) -> u8) -> Option<u16> {
    let mut word = 0_u32;
    for bit in 0..COUNTER_BITS {
        let mean = |block: usize| -> u32 {
            let centre = (2..6).flat_map(|y| (2..6).map(move |x| (x, y)));
            centre
                .map(|(x, y)| u32::from(luma((2 * bit + block) * BLOCK_PX + x, y)))
                .sum::<u32>()
                / 16
        };
        let (value, grey) = (mean(0), mean(1));
        if value.abs_diff(grey) < u32::from(CONTRAST_LUMA) / 2 {
            return None;
        }
        word = word << 1 | u32::from(value > grey);
    }
    let counter = word >> 4;
    (check(counter) == word & 0xF).then_some(counter as u16)
}

/// Reads the counter from a YUYV picture.
pub fn read_yuyv(picture: &[u8], width: usize) -> Option<u16> {
    if width < COUNTER_WIDTH_PX || picture.len() < width * 2 * COUNTER_ROWS {
        return None;
    }
    read(|x, y| picture[2 * (y * width + x)])
}

/// Four bits that an all-dark or all-bright strip does not have.
fn check(counter: u32) -> u32 {
    (counter ^ counter >> 4 ^ counter >> 8 ^ counter >> 12 ^ 0b1010) & 0xF
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_blocks(blocks: &[u8]) -> Option<u16> {
        read(|x, _| blocks[x / BLOCK_PX])
    }

    proptest! {
        #[test]
        fn what_is_shown_is_read(counter in any::<u64>()) {
            let blocks: Vec<u8> = block_luma(counter).collect();
            prop_assert_eq!(read_blocks(&blocks), Some((counter & 0xFFFF) as u16));
        }

        #[test]
        fn one_wrong_bit_is_found(counter in any::<u16>(), bit in 0..COUNTER_BITS) {
            let mut blocks: Vec<u8> = block_luma(counter.into()).collect();
            blocks[2 * bit] = 255 - blocks[2 * bit];
            prop_assert_eq!(read_blocks(&blocks), None);
        }
    }

    #[test]
    fn a_picture_without_counter_has_none() {
        assert_eq!(read(|_, _| 128), None);
        assert_eq!(read_yuyv(&[0; 16], 640), None);
    }
}
