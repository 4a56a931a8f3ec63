//! How well one 8-bit sample knows the radiance: shot noise, read noise, quantisation, and the ends of the scale.
//!
//! A camera counts N electrons with variance N and adds read noise of standard deviation r. With F electrons at full scale
//! and gain 1, and g the total gain of a channel (gain times white balance), the signal is `y = g N / F`, so
//!
//! ```text
//! var(y) = (g / F) y + (g r / F)² + q²/12
//! ```
//!
//! with q the width of the code on the scale of y (Granados et al. 2010, "Optimal HDR reconstruction with linear digital
//! cameras", without dark current; uniform quantisation error: Widrow 1956). Where a response is flat, in a soft
//! shoulder say, q is wide and the sample counts for little.

use mirrorball_capture::frame::Exposure;

use super::{Clipping, Sample};
use crate::{photometry::Photometry, response::ResponseCurve};

/// Number of codes of an 8-bit pixel.
const CODES: usize = 256;

/// Steps of √y in which the variance of quantisation is tabulated: that of a code of a square-root response, so that
/// neither the dark nor the bright end is coarse.
const ROOT_STEPS: usize = 255;

/// What the codes of one channel of one picture say about radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelTable {
    /// Linear signal per unit of radiance in the middle of the picture.
    signal_per_radiance: f32,
    /// Variance of the signal per unit of signal: shot noise.
    shot: f32,
    /// Linear signal of every code; where the scale ends, the value that bounds the light.
    signal: [f32; CODES],
    /// Variance of the signal of every code that does not depend on the light: read noise and quantisation.
    floor: [f32; CODES],
    /// The same by √y.
    floor_by_root: [f32; ROOT_STEPS + 1],
    /// The first code that stands for everything above it.
    clipped_from: u8,
    /// The last code that stands for everything below it.
    black_to: u8,
}

/// What decides the noise of one channel of one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelNoise {
    /// Linear signal y, a fraction of full scale, per unit of radiance in the middle of the picture; above 0.
    pub signal_per_radiance: f64,
    /// g / F: signal per electron, above 0.
    pub signal_per_electron: f64,
    /// Standard deviation of the read noise in electrons, 0 or more.
    pub read_noise_e: f64,
    /// Standard deviation, in codes, of what happens after encoding (compression, scanning) beside the rounding itself; 0
    /// or more.
    pub code_noise: f64,
}

impl ChannelTable {
    /// What the codes say, given the response and the noise.
    #[must_use]
    pub fn new(response: &ResponseCurve, noise: &ChannelNoise) -> Self {
        let clipped_from = response.first_clipped_code();
        let black_to = response.last_black_code();
        let read = (noise.signal_per_electron * noise.read_noise_e).powi(2);
        let per_code = 1.0 / 12.0 + noise.code_noise.powi(2);
        let floor_of = |code: u8| read + per_code * response.code_width(code.clamp(black_to, clipped_from)).powi(2);
        let signal_of = |code: u8| {
            if code >= clipped_from {
                // Rounding: the code begins half a code below its own signal.
                0.5 * (response.linear_from_code(clipped_from - 1) + response.linear_from_code(clipped_from))
            } else {
                response.linear_from_code(code)
            }
        };
        Self {
            signal_per_radiance: noise.signal_per_radiance as f32,
            shot: noise.signal_per_electron as f32,
            signal: std::array::from_fn(|code| signal_of(code as u8) as f32),
            floor: std::array::from_fn(|code| floor_of(code as u8) as f32),
            floor_by_root: std::array::from_fn(|step| {
                let y = (step as f64 / ROOT_STEPS as f64).powi(2);
                floor_of(response.encode(y)) as f32
            }),
            clipped_from,
            black_to,
        }
    }

    /// What `code` says, at a pixel that receives the fraction `vignetting` (above 0) of the light.
    #[must_use]
    pub fn sample(&self, code: u8, vignetting: f32) -> Sample {
        let at = usize::from(code);
        self.scaled(self.signal[at], self.floor[at], self.clipping(code), vignetting)
    }

    /// What a linear signal says that was interpolated between pixels; as uncertain as one pixel, because neighbours share
    /// what they cannot know.
    ///
    /// `signal` is 0 to 1; `clipping` is what the pixels it came from say.
    #[must_use]
    pub fn sample_of_signal(&self, signal: f32, clipping: Clipping, vignetting: f32) -> Sample {
        let root = signal.clamp(0.0, 1.0).sqrt() * ROOT_STEPS as f32 + 0.5;
        self.scaled(signal, self.floor_by_root[root as usize], clipping, vignetting)
    }

    /// Whether a code is at an end of the scale.
    #[must_use]
    pub fn clipping(&self, code: u8) -> Clipping {
        if code >= self.clipped_from {
            Clipping::Above
        } else if code <= self.black_to {
            Clipping::Below
        } else {
            Clipping::None
        }
    }

    fn scaled(&self, signal: f32, floor: f32, clipping: Clipping, vignetting: f32) -> Sample {
        let per_signal = 1.0 / (self.signal_per_radiance * vignetting);
        Sample {
            radiance: signal * per_signal,
            shot: self.shot * per_signal,
            floor: floor * per_signal * per_signal,
            clipping,
        }
    }
}

/// What the codes of one picture say about radiance in the camera's own primaries: made once per camera and exposure, read
/// once per pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct VarianceTable {
    channels: [ChannelTable; 3],
}

impl VarianceTable {
    /// The table of a calibrated camera's frame.
    #[must_use]
    pub fn new(photometry: &Photometry, exposure: &Exposure) -> Self {
        let noise = photometry.channel_noise(exposure);
        Self::from_channels(noise.map(|noise| ChannelTable::new(&photometry.response, &noise)))
    }

    /// A table whose channels differ in response or noise: red, green, blue.
    #[must_use]
    pub fn from_channels(channels: [ChannelTable; 3]) -> Self {
        Self { channels }
    }

    /// Red, green and blue.
    #[must_use]
    pub fn channels(&self) -> &[ChannelTable; 3] {
        &self.channels
    }

    /// What a pixel says, where `vignetting` (above 0) of the light arrives.
    #[must_use]
    pub fn sample(&self, codes: [u8; 3], vignetting: f32) -> [Sample; 3] {
        std::array::from_fn(|channel| self.channels[channel].sample(codes[channel], vignetting))
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use proptest::prelude::*;

    use super::*;
    use crate::merge::simulate::{Random, knee};

    fn photometry(response: ResponseCurve) -> Photometry {
        Photometry {
            sensitivity: 40.0,
            vignetting: [0.0, 0.0],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response,
            color: DMat3::IDENTITY,
        }
    }

    const EXPOSURE: Exposure = Exposure {
        time_s: 0.01,
        gain: 2.0,
        white_balance: [1.5, 1.0, 1.25],
    };

    #[test]
    fn variance_is_that_of_simulated_pixels() {
        let mut random = Random::new(7);
        for response in [ResponseCurve::srgb(), knee()] {
            let photometry = photometry(response);
            let table = VarianceTable::new(&photometry, &EXPOSURE);
            let vignetting = 0.8;
            for radiance in [0.03, 0.1, 0.4, 0.7] {
                for channel in 0..3 {
                    let noise = photometry.channel_noise(&EXPOSURE)[channel];
                    let n = 40_000;
                    let samples: Vec<f64> = (0..n)
                        .map(|_| random.code(&photometry.response, &noise, radiance * vignetting))
                        .map(|code| f64::from(table.channels[channel].sample(code, vignetting as f32).radiance))
                        .collect();
                    let mean = samples.iter().sum::<f64>() / f64::from(n);
                    let variance = samples.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / f64::from(n);
                    let code = photometry
                        .response
                        .encode(radiance * vignetting * noise.signal_per_radiance);
                    let expected = photometry.radiance_variance(code, &EXPOSURE, vignetting)[channel];
                    assert!((mean / radiance - 1.0).abs() < 0.01, "mean {mean} of {radiance}");
                    let ratio = variance / f64::from(expected);
                    assert!((0.9..1.1).contains(&ratio), "variance {ratio} times that of {radiance}");
                }
            }
        }
    }

    #[test]
    fn the_ends_of_the_scale_are_bounds() {
        let table = VarianceTable::new(&photometry(ResponseCurve::srgb()), &EXPOSURE);
        let green = &table.channels()[1];
        let clipped = green.sample(255, 1.0);
        let curve = ResponseCurve::srgb();
        let edge = 0.5 * (curve.linear_from_code(254) + 1.0);
        assert_eq!(clipped.clipping, Clipping::Above);
        assert!((f64::from(clipped.radiance) - edge / 0.8).abs() < 1e-6);
        assert_eq!(green.sample(254, 1.0).clipping, Clipping::None);
        assert_eq!(green.sample(1, 1.0).clipping, Clipping::None);
        assert_eq!(green.sample(0, 1.0).clipping, Clipping::Below);
        assert_eq!(green.sample(0, 1.0).radiance, 0.0);
    }

    #[test]
    fn a_response_that_ends_early_clips_early() {
        let values: Vec<f64> = (0..256)
            .map(|code| ((f64::from(code) - 16.0) / 219.0).clamp(0.0, 1.0))
            .collect();
        let curve = ResponseCurve::from_table(&values).unwrap();
        let table = VarianceTable::new(&photometry(curve), &EXPOSURE);
        let red = &table.channels()[0];
        let clipping = [0, 16, 17, 234, 235, 255].map(|code| red.clipping(code));
        use Clipping::{Above, Below, None};
        assert_eq!(clipping, [Below, Below, None, None, Above, Above]);
        assert_eq!(red.sample(255, 1.0), red.sample(235, 1.0));
    }

    #[test]
    fn a_soft_shoulder_counts_for_little() {
        let table = VarianceTable::new(&photometry(knee()), &EXPOSURE);
        let relative = |code: u8| {
            let sample = table.channels()[1].sample(code, 1.0);
            sample.floor / (sample.radiance * sample.radiance)
        };
        // Shot noise aside, a code near the top knows less about its light than one below the knee.
        assert!(
            relative(253) > 3.0 * relative(180),
            "{} {}",
            relative(253),
            relative(180)
        );
    }

    proptest! {
        #[test]
        fn a_signal_says_what_its_code_says(code in 8u8..250, vignetting in 0.3f32..1.0) {
            let table = VarianceTable::new(&photometry(ResponseCurve::srgb()), &EXPOSURE);
            let green = &table.channels()[1];
            let of_code = green.sample(code, vignetting);
            let of_signal = green.sample_of_signal(green.signal[usize::from(code)], Clipping::None, vignetting);
            prop_assert_eq!(of_code.radiance, of_signal.radiance);
            prop_assert_eq!(of_code.shot, of_signal.shot);
            prop_assert!((of_code.floor / of_signal.floor - 1.0).abs() < 0.05);
        }
    }
}
