//! The simulated sensor: radiance × exposure × gain × white balance, a response curve, noise, and controls that act
//! some frames late. Pure: no clock, no threads.

use std::collections::VecDeque;

use super::scene::{Light, linear_to_srgb, planckian_rgb};

/// Exposure time to which sensitivity refers, in units of 100 µs: 10 ms.
pub const REFERENCE_EXPOSURE_100US: f32 = 100.0;

/// How many frames pass from a request to the first frame that shows it: 0 acts on the next frame that starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Latency {
    /// Of the exposure time.
    pub exposure_frames: usize,
    /// Of the gain.
    pub gain_frames: usize,
    /// Of the white balance.
    pub white_balance_frames: usize,
}

/// What is constant about a sensor; each camera has its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Signal (1 saturates) for radiance 1 at 10 ms and no gain.
    pub sensitivity: f32,
    /// Relative deviation of the true exposure from the one that was set: a sine over log exposure with a period of
    /// four stops, 0.02 for ±2 %. A real sensor deviates by constant delays and by row times rounded; what matters
    /// is that the ratio of two exposures is not quite what was asked for.
    pub exposure_nonlinearity: f32,
    /// True gain is 1 plus this times the control's value.
    pub gain_per_unit: f32,
    /// Rows: the sensor's red, green, blue for the scene's linear RGB. Pictures of a film see its row sums only.
    pub sensor_from_scene: [[f32; 3]; 3],
    /// By how much the webcam mistakes a colour temperature, in mired (10^6 / K); the same kelvin on two cameras is
    /// not the same colour.
    pub white_balance_shift_mired: f32,
    /// Standard deviation of the noise at no signal, at gain 1; of full scale.
    pub read_noise: f32,
    /// Standard deviation of the shot noise at full scale, at gain 1; it goes with the root of the signal.
    pub shot_noise: f32,
    /// How late controls act.
    pub latency: Latency,
}

impl Default for SensorModel {
    /// An ideal colour sensor with some noise; requests act two frames later.
    fn default() -> Self {
        Self {
            sensitivity: 1.0,
            exposure_nonlinearity: 0.0,
            gain_per_unit: 0.07,
            sensor_from_scene: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            white_balance_shift_mired: 0.0,
            read_noise: 0.002,
            shot_noise: 0.01,
            latency: Latency {
                exposure_frames: 2,
                gain_frames: 2,
                white_balance_frames: 2,
            },
        }
    }
}

/// What can be set, in the controls' units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorSettings {
    /// Exposure time in units of 100 µs.
    pub exposure_100us: i32,
    /// Gain in units of the webcam's own.
    pub gain: i32,
    /// Colour temperature taken for white, in kelvin.
    pub white_balance_k: i32,
    /// Added to the pixel codes, in half codes.
    pub brightness: i32,
}

impl SensorModel {
    /// The true exposure: time × gain, of 10 ms at gain 1, nonlinearity included.
    pub fn exposure(&self, settings: SensorSettings) -> f32 {
        let time = settings.exposure_100us.max(1) as f32 / REFERENCE_EXPOSURE_100US;
        let phase = time.log2() / 4.0 * std::f32::consts::TAU;
        time * (1.0 + self.exposure_nonlinearity * phase.sin()) * self.gain(settings)
    }

    /// Gains of the channels that make white of the set temperature neutral, green 1.
    pub fn white_balance_gains(&self, settings: SensorSettings) -> [f32; 3] {
        let mired = 1e6 / settings.white_balance_k.max(1) as f32 + self.white_balance_shift_mired;
        planckian_rgb(1e6 / mired.max(40.0)).map(f32::recip)
    }

    /// What radiance is multiplied by to become signal, for each channel of the sensor and without crosstalk.
    pub fn channel_gains(&self, settings: SensorSettings) -> [f32; 3] {
        let exposure = self.exposure(settings) * self.sensitivity;
        self.white_balance_gains(settings).map(|gain| gain * exposure)
    }

    /// Signal of the three channels for a reflectance under a light, before saturation at 1.
    pub fn signal(&self, reflectance: [f32; 3], light: Light, settings: SensorSettings) -> [f32; 3] {
        let light = light.radiance();
        let radiance = [0, 1, 2].map(|channel| reflectance[channel] * light[channel]);
        let gains = self.channel_gains(settings);
        [0, 1, 2].map(|channel| {
            let row = self.sensor_from_scene[channel];
            gains[channel] * (row[0] * radiance[0] + row[1] * radiance[1] + row[2] * radiance[2])
        })
    }

    /// Response of the sensor to white light: the sums of the matrix's rows.
    pub fn white_response(&self) -> [f32; 3] {
        self.sensor_from_scene.map(|row| row.iter().sum())
    }

    /// Pixel code from 0 to 255 for a signal, not rounded.
    pub fn code(&self, signal: f32, settings: SensorSettings) -> f32 {
        let encoded = 255.0 * linear_to_srgb(signal.clamp(0.0, 1.0));
        (encoded + settings.brightness as f32 / 2.0).clamp(0.0, 255.0)
    }

    /// Standard deviation of the code for a signal; 0 where the sensor saturates.
    pub fn code_noise(&self, signal: f32, settings: SensorSettings) -> f32 {
        if signal >= 1.0 {
            return 0.0;
        }
        let gain = self.gain(settings);
        let read = self.read_noise * gain;
        let shot = self.shot_noise * self.shot_noise * gain * signal;
        let noise = (read * read + shot).sqrt();
        (self.code(signal + noise, settings) - self.code(signal, settings)).abs()
    }

    fn gain(&self, settings: SensorSettings) -> f32 {
        1.0 + self.gain_per_unit * settings.gain as f32
    }
}

/// Settings on their way from request to effect.
#[derive(Clone, Debug)]
pub struct DelayedSettings {
    latency: Latency,
    requested: VecDeque<SensorSettings>,
}

impl DelayedSettings {
    /// Settings that act as late as `latency` says. At the start of a stream `settings` are in force.
    pub fn new(latency: Latency, settings: SensorSettings) -> Self {
        let most = latency
            .exposure_frames
            .max(latency.gain_frames)
            .max(latency.white_balance_frames);
        Self {
            latency,
            requested: vec![settings; most + 1].into(),
        }
    }

    /// A frame begins, with these settings asked for by now: the settings in force for it. Brightness acts at once.
    pub fn begin_frame(&mut self, requested: SensorSettings) -> SensorSettings {
        self.requested.pop_back();
        self.requested.push_front(requested);
        SensorSettings {
            exposure_100us: self.requested[self.latency.exposure_frames].exposure_100us,
            gain: self.requested[self.latency.gain_frames].gain,
            white_balance_k: self.requested[self.latency.white_balance_frames].white_balance_k,
            brightness: requested.brightness,
        }
    }
}

/// One step of a webcam's own automatic exposure: the time that brings the mean signal towards 18 % grey, a third of
/// the way in stops each frame, as a slow webcam does. Within a tenth of grey it rests.
pub fn automatic_exposure_100us(exposure_100us: i32, mean_signal: f32) -> i32 {
    if (mean_signal / 0.18 - 1.0).abs() < 0.1 {
        return exposure_100us;
    }
    let ratio = (0.18 / mean_signal.max(1e-4)).powf(1.0 / 3.0).clamp(0.5, 2.0);
    let next = (exposure_100us as f32 * ratio).round() as i32;
    next.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SETTINGS: SensorSettings = SensorSettings {
        exposure_100us: 100,
        gain: 0,
        white_balance_k: 6504,
        brightness: 0,
    };
    const GREY: [f32; 3] = [0.18; 3];

    #[test]
    fn a_grey_card_has_the_code_of_the_response() {
        let model = SensorModel::default();
        let signal = model.signal(GREY, Light::default(), SETTINGS);
        assert!(signal.iter().all(|channel| (channel - 0.18).abs() < 1e-3), "{signal:?}");
        // sRGB of 0.18 is 0.4614.
        assert!((model.code(signal[1], SETTINGS) - 117.6).abs() < 0.2);
        assert!((model.code(7.0, SETTINGS) - 255.0).abs() < 1e-3);
        assert!(model.code_noise(7.0, SETTINGS) == 0.0 && model.code_noise(0.18, SETTINGS) > 0.5);
    }

    #[test]
    fn light_exposure_and_gain_trade_against_each_other() {
        let model = SensorModel::default();
        let bright = model.signal(
            GREY,
            Light {
                level_ev: 2.0,
                ..Light::default()
            },
            SETTINGS,
        );
        let long = model.signal(
            GREY,
            Light::default(),
            SensorSettings {
                exposure_100us: 400,
                ..SETTINGS
            },
        );
        assert!((bright[1] / long[1] - 1.0).abs() < 1e-5);
        let gained = model.signal(GREY, Light::default(), SensorSettings { gain: 10, ..SETTINGS });
        assert!((gained[1] / 0.18 - 1.7).abs() < 1e-3);
    }

    #[test]
    fn the_right_white_balance_makes_white_neutral_and_the_shift_spoils_it() {
        let light = Light {
            level_ev: 0.0,
            temperature_k: 3200.0,
        };
        let settings = SensorSettings {
            white_balance_k: 3200,
            ..SETTINGS
        };
        let neutral = SensorModel::default().signal(GREY, light, settings);
        assert!(
            neutral.iter().all(|channel| (channel - 0.18).abs() < 1e-3),
            "{neutral:?}"
        );
        let shifted = SensorModel {
            white_balance_shift_mired: 20.0,
            ..SensorModel::default()
        };
        let cast = shifted.signal(GREY, light, settings);
        assert!(cast[2] > 1.05 * cast[1], "{cast:?}");
    }

    #[test]
    fn each_control_acts_after_its_own_latency() {
        let latency = Latency {
            exposure_frames: 2,
            gain_frames: 4,
            white_balance_frames: 0,
        };
        let mut delayed = DelayedSettings::new(latency, SETTINGS);
        delayed.begin_frame(SETTINGS);
        let wanted = SensorSettings {
            exposure_100us: 50,
            gain: 9,
            white_balance_k: 3000,
            brightness: 0,
        };
        let frames: Vec<_> = (0..6).map(|_| delayed.begin_frame(wanted)).collect();
        assert_eq!(
            frames.iter().map(|frame| frame.exposure_100us).collect::<Vec<_>>(),
            [100, 100, 50, 50, 50, 50]
        );
        assert_eq!(
            frames.iter().map(|frame| frame.gain).collect::<Vec<_>>(),
            [0, 0, 0, 0, 9, 9]
        );
        assert_eq!(frames[0].white_balance_k, 3000);
    }

    #[test]
    fn the_automatic_settles_on_grey() {
        let model = SensorModel::default();
        let mut settings = SensorSettings {
            exposure_100us: 5,
            ..SETTINGS
        };
        for _ in 0..40 {
            let mean = model.signal([0.3; 3], Light::default(), settings)[1];
            settings.exposure_100us = automatic_exposure_100us(settings.exposure_100us, mean);
        }
        assert!((settings.exposure_100us - 60).abs() <= 6, "{settings:?}");
    }

    proptest! {
        #[test]
        fn the_nonlinearity_stays_within_its_bound(exposure_100us in 1..5000_i32, bound in 0.0..0.05_f32) {
            let model = SensorModel { exposure_nonlinearity: bound, ..SensorModel::default() };
            let exposure = model.exposure(SensorSettings { exposure_100us, ..SETTINGS });
            let nominal = exposure_100us as f32 / REFERENCE_EXPOSURE_100US;
            prop_assert!((exposure / nominal - 1.0).abs() <= bound + 1e-5);
        }
    }
}
