//! Delays and chances for the tests of this module, the same in every run.

/// SplitMix64 (Steele, Lea, Flood 2014).
pub(super) struct Chance(u64);

impl Chance {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Even over 0 to 1, without 1.
    pub(super) fn fraction(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Delays from capture to arrival: two exponential ones, so that hardly a frame comes at once, with the jitter as the
/// mean of their sum; 2 % of them 2 to 4 ms longer.
pub(super) struct Delays {
    chance: Chance,
    jitter_ns: f64,
}

impl Delays {
    pub(super) fn new(seed: u64, jitter_ns: f64) -> Self {
        Self {
            chance: Chance::new(seed),
            jitter_ns,
        }
    }

    pub(super) fn next_ns(&mut self) -> u64 {
        let mut exponential_ns = || -(1.0 - self.chance.fraction()).ln() * self.jitter_ns / 2.0;
        let mut delay_ns = exponential_ns() + exponential_ns();
        if self.chance.fraction() < 0.02 {
            delay_ns += 2e6 + 2e6 * self.chance.fraction();
        }
        delay_ns as u64
    }
}
