//! Codes to ids, wrong bits corrected.

use super::{DictionarySize, Family, Layout};

/// The codes of a family, to look up what was read from a picture.
#[derive(Debug, Clone)]
pub struct Codebook {
    layout: Layout,
    codes: Vec<u64>,
    corrected_bits: u32,
}

/// A code that was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Match {
    /// Number of the code in its family.
    pub id: u32,
    /// Wrong bits that were corrected.
    pub hamming: u32,
    /// Quarter turns, clockwise in the picture, from the upright marker to the one that was read; 0 to 3.
    pub quarter_turns: usize,
}

impl Codebook {
    /// The codes of a family whose border is `border_bits` cells wide, see [`Layout::new`].
    #[must_use]
    pub fn new(family: Family, border_bits: u32) -> Self {
        Self {
            layout: Layout::new(family, border_bits),
            codes: family.table().codes,
            corrected_bits: corrected_bits(family),
        }
    }

    /// Where the family's cells are.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The nearest code in any of four turns, if few enough bits are wrong; of equally near ones the first.
    #[must_use]
    pub fn find(&self, read: u64) -> Option<Match> {
        // Turning what was read back is as good as turning every code.
        let mut upright = [read; 4];
        for turns in 1..4 {
            upright[4 - turns] = self.layout.turned(upright[(5 - turns) % 4]);
        }
        let mut best: Option<Match> = None;
        for (quarter_turns, &candidate) in upright.iter().enumerate() {
            for (id, &code) in self.codes.iter().enumerate() {
                let hamming = (code ^ candidate).count_ones();
                if hamming <= self.corrected_bits && best.is_none_or(|best| hamming < best.hamming) {
                    best = Some(Match {
                        id: id as u32,
                        hamming,
                        quarter_turns,
                    });
                }
            }
        }
        best
    }
}

/// Bits of a code that may be wrong and are corrected: as AprilRobotics' library does by default, less where codes are close
/// to each other (as OpenCV's `maxCorrectionBits`).
pub(super) fn corrected_bits(family: Family) -> u32 {
    match family {
        Family::Tag16h5 | Family::Aruco4x4(DictionarySize::N1000) => 0,
        Family::Aruco4x4(_) | Family::Aruco5x5(DictionarySize::N1000) | Family::Aruco6x6(DictionarySize::N1000) => 1,
        Family::Tag36h11 | Family::Tag25h9 | Family::TagStandard41h12 | Family::Aruco5x5(_) | Family::Aruco6x6(_) => 2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_found_in_every_turn_and_with_wrong_bits() {
        for family in Family::ALL {
            let book = Codebook::new(family, 1);
            for id in [0, family.codes() / 2, family.codes() - 1] {
                let mut read = family.code(id).unwrap();
                for quarter_turns in 0..4 {
                    let expected = |hamming| {
                        Some(Match {
                            id,
                            hamming,
                            quarter_turns,
                        })
                    };
                    assert_eq!(book.find(read), expected(0), "{family} {id}");
                    for hamming in 1..=corrected_bits(family) {
                        let wrong = read ^ ((1 << hamming) - 1) << 3;
                        assert_eq!(book.find(wrong), expected(hamming), "{family} {id}");
                    }
                    read = book.layout().turned(read);
                }
            }
        }
    }

    #[test]
    fn what_is_far_from_every_code_is_none() {
        let book = Codebook::new(Family::Tag36h11, 1);
        let read = Family::Tag36h11.code(7).unwrap() ^ 0b111;
        assert_eq!(book.find(read), None);
    }
}
