//! Noise from a table: drawing each pixel's afresh would take longer than a frame lasts under emulation.

/// Entries of the table; a power of two.
const ENTRIES: usize = 8192;

/// A small generator of random numbers: xorshift64* (Vigna 2016).
#[derive(Clone, Debug)]
pub(super) struct Random(u64);

impl Random {
    /// A generator; equal seeds give equal numbers.
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next number, any of 32 bits.
    pub(super) fn draw(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32) as u32
    }
}

/// Normal deviates of standard deviation 256.
#[derive(Clone, Debug)]
pub(super) struct NoiseTable(Vec<i32>);

impl NoiseTable {
    /// A table; its mean is 0.
    pub(super) fn new(random: &mut Random) -> Self {
        let mut table: Vec<i32> = (0..ENTRIES / 2)
            .map(|_| {
                // The sum of twelve even numbers of width 1 has variance 1 and is nearly normal (central limit).
                let sum: u32 = (0..12).map(|_| random.draw() >> 16).sum();
                (sum.cast_signed() - 6 * 65_536) / 256
            })
            .collect();
        // With its negative for each entry the mean is exactly 0; a stride apart, so that neighbours are unrelated.
        let negatives: Vec<i32> = table.iter().rev().map(|deviate| -deviate).collect();
        table.extend(negatives);
        Self(table)
    }

    /// The deviate at a place; places repeat after the length of the table.
    pub(super) fn at(&self, place: usize) -> i32 {
        self.0[place % ENTRIES]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_mean_zero_and_the_deviation_it_says() {
        let table = NoiseTable::new(&mut Random::new(3));
        let sum: i32 = table.0.iter().sum();
        let variance = table.0.iter().map(|v| f64::from(v * v)).sum::<f64>() / ENTRIES as f64;
        assert_eq!(sum, 0);
        assert!((variance.sqrt() / 256.0 - 1.0).abs() < 0.03, "{variance}");
    }
}
