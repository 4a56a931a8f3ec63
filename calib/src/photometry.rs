//! Photometry of a camera: from scene radiance to pixel code.

use glam::{DMat3, DVec2};
use mirrorball_capture::frame::Exposure;

use crate::{
    merge::noise::{ChannelNoise, ChannelTable},
    response::ResponseCurve,
};

/// How a camera turns radiance L into codes.
///
/// `code = round(255 f(y))` and `y = clip(gain · wb[c] · S · exposure_s · V · L, 0, 1)`, where the radiance is in the
/// camera's own primaries and in the unit that the sensitivity S fixes for the whole rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Photometry {
    /// S: signal at gain 1, as a fraction of full scale, per second and unit of radiance.
    pub sensitivity: f64,
    /// v1 and v2 of the vignetting `V = 1 + v1 r² + v2 r⁴`.
    pub vignetting: [f64; 2],
    /// Electrons at full scale and gain 1.
    pub full_well_e: f64,
    /// Standard deviation of the read noise in electrons.
    pub read_noise_e: f64,
    /// Code to linear signal.
    pub response: ResponseCurve,
    /// Camera's linear RGB to the rig's common linear RGB.
    pub color: DMat3,
}

impl Photometry {
    /// V at a pixel: the fraction of the light that reaches the sensor there, 1 at the picture's centre.
    ///
    /// r is the distance from the picture's centre `((W-1)/2, (H-1)/2)` over half the diagonal.
    #[must_use]
    pub fn vignetting_at(&self, pixel: DVec2, size_px: [u32; 2]) -> f64 {
        let size = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1]));
        let s = (pixel - 0.5 * (size - 1.0)).length_squared() / (0.25 * size.length_squared());
        1.0 + s * (self.vignetting[0] + s * self.vignetting[1])
    }

    /// Linear signal y of red, green and blue per unit of radiance in the middle of the picture, before clipping:
    /// `gain · wb[c] · S · exposure_s`.
    #[must_use]
    pub fn signal_per_radiance(&self, exposure: &Exposure) -> [f64; 3] {
        exposure
            .white_balance
            .map(|white_balance| exposure.gain * white_balance * self.sensitivity * exposure.time_s)
    }

    /// What decides the noise of red, green and blue at an exposure: gain and white balance multiply electrons.
    #[must_use]
    pub fn channel_noise(&self, exposure: &Exposure) -> [ChannelNoise; 3] {
        let signal = self.signal_per_radiance(exposure);
        std::array::from_fn(|channel| ChannelNoise {
            signal_per_radiance: signal[channel],
            signal_per_electron: exposure.gain * exposure.white_balance[channel] / self.full_well_e,
            read_noise_e: self.read_noise_e,
            code_noise: 0.0,
        })
    }

    /// Variance of the radiance that one pixel of this code tells, for red, green and blue, in the camera's own primaries,
    /// where `vignetting` (above 0) of the light arrives: shot noise, read noise and rounding.
    ///
    /// At a clipped code, the variance of the bound that it stands for. For many pixels make a
    /// [`VarianceTable`](crate::merge::noise::VarianceTable).
    #[must_use]
    pub fn radiance_variance(&self, code: u8, exposure: &Exposure, vignetting: f64) -> [f32; 3] {
        self.channel_noise(exposure).map(|noise| {
            let sample = ChannelTable::new(&self.response, &noise).sample(code, vignetting as f32);
            sample.variance_at(sample.radiance)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photometry() -> Photometry {
        Photometry {
            sensitivity: 40.0,
            vignetting: [-0.12, 0.02],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response: ResponseCurve::srgb(),
            color: DMat3::IDENTITY,
        }
    }

    #[test]
    fn vignetting_is_1_in_the_middle_and_reaches_half_the_diagonal() {
        let photometry = photometry();
        assert_eq!(photometry.vignetting_at(DVec2::new(319.5, 239.5), [640, 480]), 1.0);
        // The outer corner of the corner pixel is half a diagonal away.
        let corner = photometry.vignetting_at(DVec2::new(-0.5, -0.5), [640, 480]);
        assert!((corner - (1.0 - 0.12 + 0.02)).abs() < 1e-12);
        let half = photometry.vignetting_at(DVec2::new(319.5 + 200.0, 239.5), [640, 480]);
        assert!((half - (1.0 - 0.12 * 0.25 + 0.02 * 0.0625)).abs() < 1e-12);
    }

    #[test]
    fn signal_is_gain_times_white_balance_times_sensitivity_times_time() {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 2.0,
            white_balance: [1.5, 1.0, 1.25],
        };
        let signal = photometry().signal_per_radiance(&exposure);
        for (found, expected) in signal.into_iter().zip([1.2, 0.8, 1.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
    }
}
