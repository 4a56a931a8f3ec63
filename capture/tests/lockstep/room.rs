//! A simulated room and the cameras that look at it.

use mirrorball_capture::lockstep::LockstepCamera;
use mirrorball_capture::lockstep::tables::{
    ExposureTableConfig, GainTableConfig, SensitivityTableConfig, Tables, TablesConfig, TemperatureTable,
    WhiteBalanceTableConfig,
};
use mirrorball_capture::{ControlKind, ControlRange, ControlRanges, ControlValues};

pub(crate) const WIDTH: usize = 64;
pub(crate) const HEIGHT: usize = 48;
pub(crate) const PIXELS: usize = WIDTH * HEIGHT;

/// Numbers that look random, the same each time (Steele, Lea and Flood 2014, SplitMix64).
pub(crate) struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Evenly from 0 to 1.
    pub(crate) fn even(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// About normal, standard deviation 1: the sum of four 16-bit numbers.
    pub(crate) fn normal(&mut self) -> f64 {
        let bits = self.next();
        let sum: u64 = (0..4).map(|part| (bits >> (16 * part)) & 0xffff).sum();
        (sum as f64 / 65536.0 - 2.0) * 3_f64.sqrt()
    }
}

/// sRGB codes of the 24 patches of the X-Rite ColorChecker.
const CHECKER: [[u8; 3]; 24] = [
    [115, 82, 68],
    [194, 150, 130],
    [98, 122, 157],
    [87, 108, 67],
    [133, 128, 177],
    [103, 189, 170],
    [214, 126, 44],
    [80, 91, 166],
    [193, 90, 99],
    [94, 60, 108],
    [157, 188, 64],
    [224, 163, 46],
    [56, 61, 150],
    [70, 148, 73],
    [175, 54, 60],
    [231, 199, 31],
    [187, 86, 149],
    [8, 133, 161],
    [243, 243, 242],
    [200, 200, 200],
    [160, 160, 160],
    [122, 122, 121],
    [85, 85, 85],
    [52, 52, 52],
];

pub(crate) const PATCHES: usize = CHECKER.len();

pub(crate) fn srgb_decode(code: u8) -> f64 {
    let value = f64::from(code) / 255.0;
    if value <= 0.040_45 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// What there is to see: patches, each pixel in a shade of its own.
pub(crate) struct Room {
    pub(crate) patch: Vec<usize>,
    pub(crate) shade: Vec<f64>,
    reflectance: [[f64; 3]; PATCHES],
}

impl Room {
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let patch = (0..PIXELS).map(|_| {
            // A third of the room is wall: a grey of the checker.
            let among = if random.even() < 0.33 { 19.0..23.0 } else { 0.0..24.0 };
            (among.start + (among.end - among.start) * random.even()) as usize
        });
        let patch: Vec<usize> = patch.collect();
        Self {
            shade: (0..PIXELS).map(|_| (0.8 * random.normal()).exp2()).collect(),
            patch,
            reflectance: CHECKER.map(|codes| codes.map(srgb_decode)),
        }
    }

    /// Radiance of each patch under black-body light of a temperature.
    pub(crate) fn radiance(&self, light: Light) -> [[f64; 3]; PATCHES] {
        let colour = TemperatureTable::black_body()
            .gains(light.kelvin)
            .map(|gain| 1.0 / gain);
        let level = 100.0 * light.level_ev.exp2();
        self.reflectance
            .map(|rgb| std::array::from_fn(|channel| level * colour[channel] * rgb[channel]))
    }
}

/// The light in the room at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Light {
    pub(crate) level_ev: f64,
    pub(crate) kelvin: f64,
}

/// What makes one model of camera differ from another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Model {
    pub(crate) latency_frames: u32,
    pub(crate) interval_ns: f64,
    pub(crate) phase_ns: f64,
    /// Red, green and blue of the sensor from those of the light; rows add up to 1.
    pub(crate) matrix: [[f64; 3]; 3],
    pub(crate) sensitivity: [f64; 3],
    /// What the camera takes one kelvin for.
    pub(crate) kelvin_scale: f64,
    pub(crate) kelvin_range: (i64, i64, i64),
    pub(crate) gain_steps: i64,
    pub(crate) noise: f64,
}

pub(crate) const SCENE: Model = Model {
    latency_frames: 2,
    interval_ns: 33.333e6,
    phase_ns: 0.0,
    matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    sensitivity: [1.0, 1.0, 1.0],
    kelvin_scale: 1.0,
    kelvin_range: (2500, 8000, 10),
    gain_steps: 100,
    noise: 0.01,
};

pub(crate) const PROBE: Model = Model {
    latency_frames: 4,
    interval_ns: 33.340e6,
    phase_ns: 9e6,
    matrix: [[0.97, 0.03, 0.0], [0.02, 0.96, 0.02], [0.0, 0.04, 0.96]],
    sensitivity: [0.75, 0.9, 1.05],
    kelvin_scale: 0.9,
    kelvin_range: (2800, 6500, 25),
    gain_steps: 32,
    noise: 0.015,
};

impl Model {
    /// Seconds really exposed: 2 % off the straight line, up and down every three steps.
    pub(crate) fn time_s(&self, value: i64) -> f64 {
        let time_s = value as f64 * 1e-4;
        time_s * (1.0 + 0.02 * (std::f64::consts::TAU * (time_s * 1e3).log2() / 3.0).sin())
    }

    pub(crate) fn gain(&self, value: i64) -> f64 {
        (4.0 * value as f64 / self.gain_steps as f64).exp2()
    }

    /// Gains that the camera has for a temperature: right for its own sensor under the light it takes that for.
    pub(crate) fn white_balance(&self, kelvin: f64) -> [f64; 3] {
        let gains = TemperatureTable::black_body().gains(kelvin * self.kelvin_scale);
        let light = gains.map(|gain| 1.0 / gain);
        let raw: [f64; 3] = std::array::from_fn(|row| self.raw(light)[row] * self.sensitivity[row]);
        raw.map(|channel| raw[1] / channel)
    }

    /// Signal of a grey thing under a light, relative to a camera that sees the light as it is.
    fn relative_signal(&self, kelvin: f64) -> [f64; 3] {
        let light = TemperatureTable::black_body().gains(kelvin).map(|gain| 1.0 / gain);
        let raw = self.raw(light);
        std::array::from_fn(|channel| raw[channel] * self.sensitivity[channel] / light[channel])
    }

    pub(crate) fn raw(&self, rgb: [f64; 3]) -> [f64; 3] {
        self.matrix
            .map(|row| row.iter().zip(rgb).map(|(weight, channel)| weight * channel).sum())
    }

    pub(crate) fn ranges(&self) -> ControlRanges {
        let range = |minimum, maximum, step| ControlRange {
            minimum,
            maximum,
            step,
            default: minimum,
        };
        let mut ranges = ControlRanges::default();
        ranges.set(ControlKind::ExposureTime, range(1, 2000, 1));
        ranges.set(ControlKind::Gain, range(0, self.gain_steps, 1));
        let (low, high, step) = self.kelvin_range;
        ranges.set(ControlKind::WhiteBalanceTemperature, range(low, high, step));
        ranges
    }

    /// What a calibration finds: about twenty points per table, each off by `error` (standard deviation).
    pub(crate) fn tables(&self, error: f64, random: &mut Random) -> Tables {
        let mut off = |truth: f64| truth * (1.0 + error * random.normal());
        let mut times: Vec<i64> = (0..=20)
            .map(|at| 2000_f64.powf(f64::from(at) / 20.0).round() as i64)
            .collect();
        times.dedup();
        let times = times
            .into_iter()
            .map(|value| (value, off(self.time_s(value))))
            .collect();
        let gains = (0..=16)
            .map(|at| at * self.gain_steps / 16)
            .map(|value| (value, off(self.gain(value))))
            .collect();
        let (low, high, _) = self.kelvin_range;
        let kelvins = (0..=6).map(|at| low + (high - low) * at / 6);
        let temperatures = kelvins
            .map(|kelvin| (kelvin, self.white_balance(kelvin as f64).map(&mut off)))
            .collect();
        let lights = [2500, 3000, 3600, 4400, 5400, 6500, 8000];
        let sensitivities = lights.map(|kelvin| (kelvin, self.relative_signal(kelvin as f64).map(&mut off)));
        let config = TablesConfig {
            exposure_table: Some(ExposureTableConfig {
                unit_s: None,
                points: Some(times),
            }),
            gain_table: Some(GainTableConfig { points: gains }),
            white_balance_table: Some(WhiteBalanceTableConfig {
                temperatures: Some(temperatures),
                ..WhiteBalanceTableConfig::default()
            }),
            sensitivity: None,
            sensitivity_table: Some(SensitivityTableConfig {
                temperatures: sensitivities.to_vec(),
            }),
        };
        Tables::new(&config).expect("tables that rise")
    }

    pub(crate) fn start(&self) -> ControlValues {
        let mut values = ControlValues::default();
        values.set(ControlKind::ExposureTime, 100);
        values.set(ControlKind::Gain, 0);
        values.set(
            ControlKind::WhiteBalanceTemperature,
            4600 / self.kelvin_range.2 * self.kelvin_range.2,
        );
        values
    }

    pub(crate) fn camera(&self, tables: Tables, latency_frames: Option<u32>) -> LockstepCamera {
        LockstepCamera {
            tables,
            ranges: self.ranges(),
            values: self.start(),
            interval_ns: self.interval_ns as u64,
            latency_frames,
        }
    }

    /// The picture of the room with these values, in sRGB codes.
    pub(crate) fn picture(&self, room: &Room, light: Light, values: &ControlValues, random: &mut Random) -> Vec<u8> {
        let get = |kind| values.get(kind).expect("every control has a value");
        let scalar = self.time_s(get(ControlKind::ExposureTime)) * self.gain(get(ControlKind::Gain));
        let white_balance = self.white_balance(get(ControlKind::WhiteBalanceTemperature) as f64);
        let signals = room.radiance(light).map(|rgb| {
            let raw = self.raw(rgb);
            std::array::from_fn::<f64, 3, _>(|channel| {
                scalar * raw[channel] * self.sensitivity[channel] * white_balance[channel]
            })
        });
        let mut pixels = Vec::with_capacity(3 * PIXELS);
        for (patch, shade) in room.patch.iter().zip(&room.shade) {
            for signal in signals[*patch] {
                let signal = signal * shade;
                let noise = self.noise * (signal.min(1.0) * 0.3).sqrt() + 0.0005;
                pixels.push(srgb_encode(signal + noise * random.normal()));
            }
        }
        pixels
    }
}

fn srgb_encode(y: f64) -> u8 {
    let y = y.clamp(0.0, 1.0);
    let value = if y <= 0.003_130_8 {
        12.92 * y
    } else {
        1.055 * y.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * value).round() as u8
}
