//! From radiance to codes and back: exposure, noise, clipping, response.

use super::{camera::Camera, probe_picture::RadiancePicture};
use image::{Rgb, RgbImage};
use std::f64::consts::PI;

/// Settings in force when a picture is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Exposure time in seconds.
    pub exposure_s: f64,
    /// Analogue gain, 1 is none.
    pub gain: f64,
    /// White-balance gains of red, green and blue.
    pub white_balance: [f64; 3],
}

impl Exposure {
    /// Returns the same settings with another exposure time.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self {
            exposure_s: factor * self.exposure_s,
            ..self
        }
    }
}

/// Normally distributed numbers: SplitMix64 (Steele, Lea, Flood 2014) and the transform of Box and Muller (1958).
#[derive(Clone, Debug)]
pub struct Noise {
    state: u64,
}

impl Noise {
    /// Starts a sequence; every seed gives another one.
    pub fn new(seed: u64) -> Self {
        Self {
            state: seed.wrapping_mul(0xD6E8_FEB8_6659_FD93),
        }
    }

    /// Returns the next number, of mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        let (a, b) = (self.uniform(), self.uniform());
        (-2.0 * (1.0 - a).ln()).sqrt() * (2.0 * PI * b).cos()
    }

    /// Returns the next number of 0 to 1, 1 excluded.
    fn uniform(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

impl Camera {
    /// Takes the picture: signal, shot and read noise, gain, clipping, response, 8 bits.
    ///
    /// # Panics
    /// When the picture is not of the camera's size.
    pub fn expose(&self, picture: &RadiancePicture, exposure: &Exposure, noise: &mut Noise) -> RgbImage {
        assert_eq!(picture.size_px, self.size_px, "a picture of this camera");
        let photometry = &self.photometry;
        let read_noise = photometry.read_noise_e / photometry.full_well_e;
        RgbImage::from_fn(self.size_px[0], self.size_px[1], |column, row| {
            let per_radiance = photometry.sensitivity * exposure.exposure_s * self.vignetting(column, row);
            let radiance = picture.at(column, row);
            Rgb([0, 1, 2].map(|channel| {
                let signal = per_radiance * f64::from(radiance[channel]);
                let sigma = (signal / photometry.full_well_e + read_noise * read_noise).sqrt();
                let amplified = exposure.gain * exposure.white_balance[channel] * (signal + sigma * noise.normal());
                (255.0 * encoded(amplified.clamp(0.0, 1.0)) + 0.5).floor() as u8
            }))
        })
    }

    /// Returns the radiance that the codes of a picture stand for; where it clips, the least that does.
    ///
    /// # Panics
    /// When the picture is not of the camera's size.
    pub fn develop(&self, picture: &RgbImage, exposure: &Exposure) -> RadiancePicture {
        assert_eq!(
            [picture.width(), picture.height()],
            self.size_px,
            "a picture of this camera"
        );
        let pixels = picture.enumerate_pixels().map(|(column, row, pixel)| {
            let per_radiance = self.photometry.sensitivity * exposure.exposure_s * self.vignetting(column, row);
            [0, 1, 2].map(|channel| {
                let amplified = decoded(f64::from(pixel.0[channel]) / 255.0);
                (amplified / (exposure.gain * exposure.white_balance[channel] * per_radiance)) as f32
            })
        });
        RadiancePicture {
            size_px: self.size_px,
            pixels: pixels.collect(),
        }
    }
}

/// The sRGB curve (IEC 61966-2-1).
fn encoded(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// The inverse of the sRGB curve.
fn decoded(code: f64) -> f64 {
    if code <= 0.040_45 {
        code / 12.92
    } else {
        ((code + 0.055) / 1.055).powf(2.4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::SimulatedRig;

    fn fisheye() -> Camera {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/fisheye/recording/rig.toml");
        SimulatedRig::load(path.as_ref())
            .unwrap()
            .probe_camera()
            .unwrap()
            .clone()
    }

    const EXPOSURE: Exposure = Exposure {
        exposure_s: 0.01,
        gain: 2.0,
        white_balance: [1.0, 1.2, 1.5],
    };

    #[test]
    fn noise_has_the_variance_of_electrons() {
        let camera = fisheye();
        let flat = RadiancePicture {
            size_px: camera.size_px,
            pixels: vec![[0.5; 3]; (camera.size_px[0] * camera.size_px[1]) as usize],
        };
        let developed = camera.develop(&camera.expose(&flat, &EXPOSURE, &mut Noise::new(3)), &EXPOSURE);
        let n = developed.pixels.len() as f64;
        for channel in 0..3 {
            let mean = developed.pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>() / n;
            let squares = developed.pixels.iter().map(|p| (f64::from(p[channel]) - mean).powi(2));
            let electrons = 0.5 * 40.0 * 0.01 * 20_000.0_f64;
            let shot_and_read = 0.5 * (electrons + 25.0).sqrt() / electrons;
            // A code is about 1 % wide there; its rounding adds a twelfth of its square.
            let sigma = (squares.sum::<f64>() / n).sqrt();
            assert!((mean - 0.5).abs() < 1e-3, "{mean}");
            assert!((sigma / shot_and_read - 1.0).abs() < 0.1, "{sigma} {shot_and_read}");
        }
    }

    #[test]
    fn the_curve_and_its_inverse_agree_and_seeds_differ() {
        for code in 0..=255 {
            let code = f64::from(code) / 255.0;
            assert!((encoded(decoded(code)) - code).abs() < 1e-6);
        }
        assert_ne!(Noise::new(1).normal(), Noise::new(2).normal());
    }
}
