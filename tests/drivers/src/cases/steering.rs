//! Controls reach the sensor when they should, and the pixels are what sensor and light make them.

use std::sync::Arc;
use std::time::Instant;

use mirrorball_driver_tests::raw_camera::{
    EXPOSURE_MODE, EXPOSURE_TIME, GAIN, RawCamera, WHITE_BALANCE, WHITE_BALANCE_AUTO,
};
use mirrorball_driver_tests::webcam::WebcamConfig;
use mirrorball_driver_tests::webcam::controls::Control;
use mirrorball_driver_tests::webcam::scene::{Film, Light, LinearPicture, Scene};
use mirrorball_driver_tests::webcam::sensor::{Latency, SensorModel};

use super::support::{Bench, Known, YUYV, ensure, grey_card_yuv, say, test_picture};

/// Difference between measured and predicted mean code: rounding of the integer conversion, noise of some thousand pixels.
const CODE_TOLERANCE: f64 = 0.6;

/// Manual mode, 10 ms, white balance for neutral light.
fn set_manual(camera: &RawCamera) -> Result<(), String> {
    for (id, value) in [
        (EXPOSURE_MODE, 1),
        (EXPOSURE_TIME, 100),
        (WHITE_BALANCE_AUTO, 0),
        (WHITE_BALANCE, 6500),
    ] {
        camera
            .set_control(id, value)
            .map_err(|error| format!("control {id:#x} = {value}: {error}"))?;
    }
    Ok(())
}

fn config(latency: Latency) -> WebcamConfig {
    let sensor = SensorModel {
        exposure_nonlinearity: 0.02,
        latency,
        ..SensorModel::default()
    };
    WebcamConfig {
        sensor,
        ..WebcamConfig::named("Webcam")
    }
}

/// Luma of the grey card in a frame against that of the model with the settings in force.
fn check_pixels(bench: &Bench, known: &Known) -> Result<(), String> {
    let model = bench.webcam.sensor();
    let signal = known.truth.white_signal.map(|channel| 0.18 * channel);
    let [r, g, b] = signal.map(|channel| f64::from(model.code(channel, known.truth.settings)));
    let wanted = 16.0 + (0.299 * r + 0.587 * g + 0.114 * b) * 219.0 / 255.0;
    let [found, ..] = grey_card_yuv(&known.frame, bench.size);
    ensure((found - wanted).abs() < CODE_TOLERANCE, || {
        format!(
            "frame {}: luma {found:.2}, the model says {wanted:.2}: {:?}",
            known.truth.counter, known.truth
        )
    })
}

pub(super) fn controls_act_after_their_latency() -> Result<(), String> {
    let latency = Latency {
        exposure_frames: 2,
        gain_frames: 4,
        white_balance_frames: 3,
    };
    let mut bench = Bench::open(0, config(latency), (320, 240), YUYV)?;
    set_manual(&bench.camera)?;
    bench.start()?;
    bench.known_frames(8)?;
    bench.camera.set_control(EXPOSURE_TIME, 40).map_err(say)?;
    bench.camera.set_control(GAIN, 20).map_err(say)?;
    bench.camera.set_control(WHITE_BALANCE, 3000).map_err(say)?;
    let frames = bench.known_frames(20)?;
    for known in &frames {
        check_pixels(&bench, known)?;
    }
    let all = bench.webcam.truth();
    let act = |pick: fn(&mirrorball_driver_tests::webcam::sensor::SensorSettings) -> i32, value: i32| {
        let asked = all.iter().position(|frame| pick(&frame.requested) == value);
        let in_force = all.iter().position(|frame| pick(&frame.settings) == value);
        asked.zip(in_force).map(|(asked, in_force)| in_force - asked)
    };
    let found = (
        act(|s| s.exposure_100us, 40),
        act(|s| s.gain, 20),
        act(|s| s.white_balance_k, 3000),
    );
    ensure(found == (Some(2), Some(4), Some(3)), || {
        format!("latencies of 2, 4, 3 frames expected, found {found:?}")
    })?;
    // 3000 K taken for white in neutral light: the card turns blue.
    let last = &frames[frames.len() - 1];
    let [_, u, v] = grey_card_yuv(&last.frame, bench.size);
    ensure(u > 140.0 && v < 120.0, || {
        format!("a blue cast expected, found u {u:.1} v {v:.1}")
    })
}

pub(super) fn light_changes_the_pixels() -> Result<(), String> {
    let latency = Latency {
        exposure_frames: 2,
        gain_frames: 2,
        white_balance_frames: 2,
    };
    let mut bench = Bench::open(0, config(latency), (320, 240), YUYV)?;
    set_manual(&bench.camera)?;
    bench.start()?;
    bench.known_frames(6)?;
    for (level_ev, temperature_k) in [(-2.0, 6504.0), (1.0, 6504.0), (0.0, 3200.0)] {
        let light = Light {
            level_ev,
            temperature_k,
        };
        bench.webcam.set_light(light);
        let frames = bench.known_frames(8)?;
        for known in &frames {
            check_pixels(&bench, known)?;
        }
        ensure(frames[7].truth.light == light, || {
            format!("eight frames after the light changed: {:?}", frames[7].truth)
        })?;
    }
    Ok(())
}

pub(super) fn a_film_is_played() -> Result<(), String> {
    let mut bench = Bench::open(0, WebcamConfig::named("Webcam"), (320, 240), YUYV)?;
    set_manual(&bench.camera)?;
    let picture = test_picture();
    let pictures = vec![
        LinearPicture::from_recorded(&picture, 1.0),
        LinearPicture::from_recorded(&picture, 4.0),
    ];
    let film = Film {
        pictures: Arc::new(pictures),
        rate_hz: 3.0,
        start: Instant::now(),
    };
    bench.webcam.set_scene(Scene::Film(film));
    bench.start()?;
    bench.known_frames(4)?;
    let mut shown = [0, 0];
    for known in bench.known_frames(40)? {
        // The middle of the picture: red 128, green 128, blue 90; two stops darker in the second picture.
        let at = (120 * 320 + 160) * 2;
        let luma = known.frame.bytes[at];
        let wanted = [119.0, 68.0][known.truth.picture_index];
        ensure((f64::from(luma) - wanted).abs() < 8.0, || {
            format!("luma {luma}, {wanted} expected: {:?}", known.truth)
        })?;
        shown[known.truth.picture_index] += 1;
    }
    ensure(shown[0] > 5 && shown[1] > 5, || {
        format!("both pictures of the film should be shown, found {shown:?}")
    })
}

pub(super) fn the_automatics_work_behind_our_back() -> Result<(), String> {
    let mut bench = Bench::streaming()?;
    set_manual(&bench.camera)?;
    bench.webcam.set_light(Light {
        level_ev: 2.0,
        temperature_k: 3200.0,
    });
    bench.known_frames(8)?;
    ensure(bench.webcam.control(Control::ExposureTime) == 100, || {
        "the exposure moved in manual mode".to_owned()
    })?;
    bench.webcam.switch_automatics_on();
    bench.known_frames(30)?;
    let exposure_100us = bench.webcam.control(Control::ExposureTime);
    let white_balance_k = bench.webcam.control(Control::WhiteBalance);
    ensure(exposure_100us < 60, || {
        format!("the exposure should fall from 100, it is {exposure_100us}")
    })?;
    ensure(white_balance_k < 3400, || {
        format!("the white balance should near 3200 K, it is {white_balance_k}")
    })?;
    // The driver's own copy of the mode still says manual: only exposure and white balance are read afresh.
    let mode = bench.camera.control(EXPOSURE_MODE).map_err(say)?;
    let read_back = bench.camera.control(EXPOSURE_TIME).map_err(say)?;
    println!("    the driver believes mode {mode} and exposure {read_back}; it is {exposure_100us}");
    Ok(())
}
