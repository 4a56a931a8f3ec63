//! A camera for tests: photons, read noise, response, rounding.

use super::noise::ChannelNoise;
use crate::response::ResponseCurve;

/// Numbers that look random: xorshift64* (Vigna 2016).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// 0 to 1, both left out.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let bits = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 12;
        (bits as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Standard normal (Box and Muller 1958).
    pub(crate) fn normal(&mut self) -> f64 {
        let (a, b) = (self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }

    /// The code of a pixel on which `radiance` falls.
    pub(crate) fn code(&mut self, response: &ResponseCurve, noise: &ChannelNoise, radiance: f64) -> u8 {
        let y = radiance * noise.signal_per_radiance;
        let variance = noise.signal_per_electron * y + (noise.signal_per_electron * noise.read_noise_e).powi(2);
        response.encode(y + variance.sqrt() * self.normal())
    }
}

/// A camera's rendering curve: gamma 2.2, and from a knee at 0.8 of the code range a soft shoulder.
pub(crate) fn knee() -> ResponseCurve {
    knee_of(2.2)
}

/// The same with another gamma.
pub(crate) fn knee_of(gamma: f64) -> ResponseCurve {
    const KNEE: f64 = 0.8;
    let linear = |code: f64| {
        let encoded = if code <= KNEE {
            code
        } else {
            // The slope falls from 1 at the knee to a fifth at the top: the inverse of a saturating exponential.
            let t = (code - KNEE) / (1.0 - KNEE);
            KNEE - (1.0 - KNEE) / 0.8 * (1.0 - 0.8 * t).ln()
        };
        encoded.powf(gamma)
    };
    let values: Vec<f64> = (0..256)
        .map(|code| linear(f64::from(code) / 255.0) / linear(1.0))
        .collect();
    ResponseCurve::from_table(&values).expect("a curve that rises")
}
