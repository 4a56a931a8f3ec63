//! The cameras of the daemon's cases: simulated webcams, and a configuration with the calibration of their sensors.

use std::fmt::Write as _;
use std::fs;

use mirrorball_driver_tests::webcam::WebcamConfig;
use mirrorball_driver_tests::webcam::scene::planckian_rgb;
use mirrorball_driver_tests::webcam::sensor::{Latency, SensorModel, SensorSettings};

use super::support::say;

/// Size of the pictures.
pub(super) const SIZE: (u32, u32) = (320, 240);
/// Frames a second that the webcams are asked for: few, as the machine is emulated and may be busy besides.
pub(super) const RATE_HZ: f64 = 15.0;
/// Name under which the daemon publishes.
pub(super) const SERVICE: &str = "drivers";
/// Where the daemon tells how it is.
pub(super) const STATUS_SOCKET: &str = "/tmp/mirrorball/status.sock";
/// Where the daemon's configuration is written.
pub(super) const CONFIG: &str = "/tmp/capture.toml";

/// A simulated webcam as a camera of the daemon.
pub(super) struct Camera {
    /// Name in the rig.
    pub(super) name: &'static str,
    /// Role in the rig.
    pub(super) role: &'static str,
    /// What is plugged in.
    pub(super) webcam: WebcamConfig,
    /// Keys of the configuration besides the usual ones.
    pub(super) keys: &'static str,
}

/// A webcam with this sensor, which wakes up with settings that are about right.
fn webcam(name: &str, sensor: SensorModel) -> WebcamConfig {
    let mut config = WebcamConfig {
        sensor,
        ..WebcamConfig::named(name)
    };
    config.ranges.white_balance_k.default = 6500;
    config
}

/// The scene camera: two frames of latency, exposures up to 2 % off.
pub(super) fn scene_camera() -> Camera {
    let latency = Latency {
        exposure_frames: 2,
        gain_frames: 2,
        white_balance_frames: 2,
    };
    let sensor = SensorModel {
        exposure_nonlinearity: 0.02,
        latency,
        ..SensorModel::default()
    };
    Camera {
        name: "scene",
        role: "scene",
        webcam: webcam("Scene camera", sensor),
        keys: "latency_frames = 2",
    }
}

/// The camera at the ball: four frames of latency, exposures off the other way, other colours, less light.
pub(super) fn ball_camera() -> Camera {
    let latency = Latency {
        exposure_frames: 4,
        gain_frames: 4,
        white_balance_frames: 4,
    };
    let sensor = SensorModel {
        exposure_nonlinearity: -0.02,
        sensor_from_scene: [[0.80, 0.15, 0.0], [0.06, 0.86, 0.04], [0.0, 0.10, 0.78]],
        white_balance_shift_mired: 12.0,
        latency,
        ..SensorModel::default()
    };
    Camera {
        name: "ball",
        role: "ball",
        webcam: webcam("Ball camera", sensor),
        keys: "latency_frames = 4",
    }
}

/// Lockstep settings of cases that are not about measuring latencies.
pub(super) const KNOWN_LATENCY: &str = "max_exposure_s = 0.03\nmeasure_latency = false";

/// Writes the configuration of the daemon.
pub(super) fn write_config(cameras: &[Camera], lockstep: &str) -> Result<(), String> {
    let mut text = format!(
        "version = 1\n[service]\nname = \"{SERVICE}\"\nmax_skew_ms = 120.0\nstatus_socket = \"{STATUS_SOCKET}\"\n[lockstep]\n{lockstep}\n"
    );
    for camera in cameras {
        text += &format!(
            "[[camera]]\nname = \"{}\"\nrole = \"{}\"\ncard = \"{}\"\nsize_px = [{}, {}]\n{}\n",
            camera.name, camera.role, camera.webcam.name, SIZE.0, SIZE.1, camera.keys
        );
        if !camera.keys.contains("rate_hz") {
            text += &format!("rate_hz = {RATE_HZ:?}\n");
        }
        if !camera.keys.contains("formats") {
            text += "formats = [\"yuyv\"]\n";
        }
        text += &tables(&camera.webcam);
    }
    fs::write(CONFIG, text).map_err(say)
}

/// The calibration of a webcam's sensor, as measured without error.
fn tables(webcam: &WebcamConfig) -> String {
    let model = &webcam.sensor;
    let settings = |exposure_100us: i32, gain: i32, white_balance_k: i32| SensorSettings {
        exposure_100us,
        gain,
        white_balance_k,
        brightness: 0,
    };
    let mut times: Vec<i32> = (0..=98).map(|eighth| (f64::from(eighth) / 8.0).exp2() as i32).collect();
    times.push(webcam.ranges.exposure_100us.maximum);
    times.dedup();
    let mut text = String::from("[camera.exposure_table]\npoints = [");
    for time in times {
        // An exposure of 1 is 10 ms.
        let _ = write!(text, "[{time}, {:e}], ", 0.01 * model.exposure(settings(time, 0, 5000)));
    }
    text += "]\n[camera.gain_table]\npoints = [";
    for gain in [0, webcam.ranges.gain.maximum] {
        let linear = model.exposure(settings(100, gain, 5000)) / model.exposure(settings(100, 0, 5000));
        let _ = write!(text, "[{gain}, {linear:?}], ");
    }
    text += "]\n[camera.white_balance_table]\ntemperatures = [";
    for kelvin in (2800..=7500).step_by(100) {
        let gains = model.white_balance_gains(settings(100, 0, kelvin));
        let _ = write!(text, "[{kelvin}, {gains:?}], ");
    }
    text += "]\n[camera.sensitivity_table]\ntemperatures = [";
    for kelvin in (2400..=8400).step_by(200) {
        let light = planckian_rgb(kelvin as f32);
        let seen = model
            .sensor_from_scene
            .map(|row| row[0] * light[0] + row[1] * light[1] + row[2] * light[2]);
        let relative = [0, 1, 2].map(|channel| model.sensitivity * seen[channel] / light[channel]);
        let _ = write!(text, "[{kelvin}, {relative:?}], ");
    }
    text + "]\n"
}
