//! The webcam's frames, one after the other: settings in force, light, fault, pixels, truth.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

use super::controls::{Control, Controls};
use super::faults::FrameFault;
use super::format::{Encoding, Mode};
use super::jpeg::CountedJpeg;
use super::paint::{Painter, Pixels, View, stamp_yuyv};
use super::scene::{Light, Scene};
use super::sensor::{DelayedSettings, SensorModel, SensorSettings, automatic_exposure_100us};
use super::truth::{Fate, FrameTruth};
use super::{State, lock};

/// What a coded picture depends on, besides its counter.
#[derive(Clone, Copy, PartialEq)]
struct JpegKey {
    settings: SensorSettings,
    light: Light,
    scene_version: u64,
    picture_index: usize,
    size: (usize, usize),
}

/// A frame as the sensor takes it.
struct Exposure {
    counter: u64,
    requested: SensorSettings,
    scene: Arc<Scene>,
    key: JpegKey,
    fault: Option<FrameFault>,
}

/// The sensor with what makes pictures of it.
pub(super) struct Frames {
    state: Arc<Mutex<State>>,
    model: SensorModel,
    painter: Painter,
    jpeg: Option<(JpegKey, CountedJpeg)>,
    delayed: DelayedSettings,
}

impl Frames {
    pub(super) fn new(model: SensorModel, seed: u64, state: Arc<Mutex<State>>) -> Self {
        let settings = settings(&lock(&state).controls);
        let delayed = DelayedSettings::new(model.latency, settings);
        Self {
            state,
            model,
            painter: Painter::new(seed),
            jpeg: None,
            delayed,
        }
    }

    /// A stream begins: what is set now is in force.
    pub(super) fn begin_stream(&mut self) {
        let settings = settings(&lock(&self.state).controls);
        self.delayed = DelayedSettings::new(self.model.latency, settings);
    }

    /// Takes the next frame and paints it into `picture`. Returns its fault and its time.
    pub(super) fn take(&mut self, mode: Mode, picture: &mut Vec<u8>) -> (Option<FrameFault>, u64) {
        let exposure = self.expose(mode);
        if exposure.fault != Some(FrameFault::LostInSensor) {
            self.paint(mode, &exposure, picture);
        }
        let start_ns = monotonic_ns();
        let fate = exposure.fault.map_or(Fate::Sent, Fate::Faulty);
        self.log(&exposure, start_ns, fate);
        (exposure.fault, start_ns)
    }

    /// The next frame's time has come while the last is still on its way: it is lost.
    pub(super) fn overrun(&mut self, mode: Mode) {
        let exposure = self.expose(mode);
        self.log(&exposure, monotonic_ns(), Fate::Overrun);
    }

    fn expose(&mut self, mode: Mode) -> Exposure {
        let mut state = lock(&self.state);
        let requested = settings(&state.controls);
        let counter = state.next_counter;
        state.next_counter += 1;
        let scene = Arc::clone(&state.scene);
        let key = JpegKey {
            settings: self.delayed.begin_frame(requested),
            light: state.light,
            scene_version: state.scene_version,
            picture_index: scene.index_at(Instant::now()),
            size: (mode.width, mode.height),
        };
        let view = view(&scene, key, &self.model);
        run_automatics(&mut state.controls, view);
        let fault = state.faults.next_frame();
        drop(state);
        Exposure {
            counter,
            requested,
            scene,
            key,
            fault,
        }
    }

    fn paint(&mut self, mode: Mode, exposure: &Exposure, picture: &mut Vec<u8>) {
        let size = (mode.width, mode.height);
        let view = view(&exposure.scene, exposure.key, &self.model);
        match mode.encoding {
            Encoding::Yuyv => {
                self.painter.paint(view, Pixels::Yuyv, size, picture);
                stamp_yuyv(picture, mode.width, exposure.counter);
            }
            Encoding::Mjpeg => {
                if self.jpeg.as_ref().is_none_or(|(key, _)| *key != exposure.key) {
                    let rows = self.painter.paint_block_rows(view, size);
                    self.jpeg = Some((exposure.key, rows.encode(mode.width)));
                }
                let (_, jpeg) = self.jpeg.as_ref().expect("it was made above");
                jpeg.write(exposure.counter, picture);
            }
        }
    }

    fn log(&self, exposure: &Exposure, start_ns: u64, fate: Fate) {
        let key = exposure.key;
        lock(&self.state).truth.push(FrameTruth {
            counter: exposure.counter,
            start_ns,
            settings: key.settings,
            requested: exposure.requested,
            exposure: self.model.exposure(key.settings),
            white_signal: self.model.signal([1.0; 3], key.light, key.settings),
            light: key.light,
            picture_index: key.picture_index,
            fate,
        });
    }
}

fn view<'a>(scene: &'a Scene, key: JpegKey, model: &'a SensorModel) -> View<'a> {
    View {
        scene,
        picture_index: key.picture_index,
        light: key.light,
        model,
        settings: key.settings,
    }
}

fn settings(controls: &Controls) -> SensorSettings {
    SensorSettings {
        exposure_100us: controls.get(Control::ExposureTime),
        gain: controls.get(Control::Gain),
        white_balance_k: controls.get(Control::WhiteBalance),
        brightness: controls.get(Control::Brightness),
    }
}

/// The webcam's own automatics, one step a frame: exposure towards grey, white balance towards the light.
fn run_automatics(controls: &mut Controls, view: View<'_>) {
    if controls.exposure_is_automatic() {
        let present = controls.get(Control::ExposureTime);
        // From the exposure on its way, not the one in force: a controller that ignored its own delay would swing.
        let ratio = present as f32 / view.settings.exposure_100us.max(1) as f32;
        let wanted = automatic_exposure_100us(present, view.mean_signal() * ratio);
        controls.set(Control::ExposureTime, wanted);
    }
    if controls.white_balance_is_automatic() {
        let present = controls.get(Control::WhiteBalance);
        let wanted = view.light.temperature_k.round() as i32;
        // A webcam rests when it is near enough; a picture that creeps for ever looks alive.
        if wanted.abs_diff(present) > 60 {
            controls.set(Control::WhiteBalance, present + (wanted - present) / 3);
        }
    }
}

/// The clock of the driver's time stamps.
pub(super) fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.cast_unsigned() * 1_000_000_000 + now.tv_nsec.cast_unsigned()
}
