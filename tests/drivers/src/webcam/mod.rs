//! A simulated USB webcam, plugged into this machine's kernel.
//!
//! To the kernel it is a UVC 1.1 webcam at a high-speed port: `uvcvideo` binds to it and makes `/dev/videoN`. To the
//! test it is a [`Webcam`]: a scene to look at, faults to befall it, and the truth about every frame that it took.
//!
//! ```no_run
//! use std::time::Duration;
//! use mirrorball_driver_tests::webcam::{FrameFault, Webcam, WebcamConfig};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut webcam = Webcam::plug(0, WebcamConfig::named("Scene camera"))?;
//! let node = webcam.node(Duration::from_secs(5))?;
//! // ... start capturing from `node` ...
//! webcam.befall(FrameFault::ErrorBit, 3);
//! webcam.unplug();
//! webcam.replug()?;
//! # Ok(())
//! # }
//! ```
//!
//! Sources: USB Device Class Definition for Video Devices 1.1 and its payload documents; USB 2.0, chapter 9; Linux
//! `Documentation/usb/usbip_protocol.rst`. What is left out: still pictures, status interrupts, the bus clock (SCR).

pub mod controls;
pub mod counter;
mod descriptors;
mod device;
pub mod faults;
pub mod format;
mod frames;
pub mod jpeg;
mod node;
mod noise;
mod paint;
pub mod scene;
pub mod sensor;
mod stream;
pub mod truth;

use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::usbip::vhci::{self, VhciError};
use controls::{APERTURE_PRIORITY, Control, ControlRanges, Controls};
use faults::Faults;
pub use faults::FrameFault;
use scene::{Light, Patches, Scene};
use sensor::SensorModel;
use truth::{FrameTruth, TruthLog};

/// What cannot be done with a simulated webcam.
#[derive(Debug, Error)]
pub enum WebcamError {
    /// The virtual host controller did not take it.
    #[error(transparent)]
    Plug(#[from] VhciError),
    /// No driver made a device node for it.
    #[error("no video node appeared for the webcam at port `{port}` within `{waited_s}` s")]
    NoNode {
        /// The port it is plugged into.
        port: u8,
        /// How long was waited.
        waited_s: f32,
    },
}

impl WebcamError {
    /// What to do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            WebcamError::Plug(source) => source.hint(),
            WebcamError::NoNode { .. } => "see the kernel log (dmesg.log in the results folder) for what uvcvideo says",
        }
    }
}

/// How long the kernel may take to notice an unplug; measured: some ten milliseconds.
const UNPLUG_PATIENCE: Duration = Duration::from_secs(5);

/// What is constant about a webcam.
#[derive(Clone, Debug)]
pub struct WebcamConfig {
    /// Product name; the name of the video device.
    pub name: String,
    /// Serial number.
    pub serial: String,
    /// The sensor.
    pub sensor: SensorModel,
    /// Ranges of the controls.
    pub ranges: ControlRanges,
    /// From which the noise follows.
    pub seed: u64,
}

impl WebcamConfig {
    /// A webcam of this name with an ideal sensor and common ranges; serial number and noise follow from the name.
    pub fn named(name: &str) -> Self {
        let seed = name
            .bytes()
            .fold(5381_u64, |hash, byte| hash.wrapping_mul(33) ^ u64::from(byte));
        Self {
            name: name.to_owned(),
            serial: format!("{:08x}", seed & 0xFFFF_FFFF),
            sensor: SensorModel::default(),
            ranges: ControlRanges::default(),
            seed,
        }
    }
}

/// What test and webcam share.
struct State {
    controls: Controls,
    scene: Arc<Scene>,
    /// Counts changes of the scene.
    scene_version: u64,
    light: Light,
    faults: Faults,
    truth: TruthLog,
    next_counter: u64,
}

/// A simulated webcam; dropping it pulls its plug.
pub struct Webcam {
    port: u8,
    config: WebcamConfig,
    state: Arc<Mutex<State>>,
    plugged: Option<(UnixStream, JoinHandle<()>)>,
}

impl Webcam {
    /// Plugs a webcam into a port of the virtual host controller, 0 to 14. It shows a chart of patches.
    ///
    /// # Errors
    /// [`WebcamError::Plug`].
    pub fn plug(port: u8, config: WebcamConfig) -> Result<Self, WebcamError> {
        let state = State {
            controls: Controls::new(config.ranges),
            scene: Arc::new(Scene::Patches(Patches::chart())),
            scene_version: 0,
            light: Light::default(),
            faults: Faults::default(),
            truth: TruthLog::default(),
            next_counter: 0,
        };
        let mut webcam = Self {
            port,
            config,
            state: Arc::new(Mutex::new(state)),
            plugged: None,
        };
        webcam.replug()?;
        Ok(webcam)
    }

    /// Pulls the plug, in the middle of whatever goes on, and waits until the kernel has noticed: its node is gone.
    pub fn unplug(&mut self) {
        if let Some((socket, thread)) = self.plugged.take() {
            // The socket may be closed already by the kernel.
            let _ = socket.shutdown(Shutdown::Both);
            // The thread owns nothing that a panic could leave half done; its message is on standard error.
            let _ = thread.join();
            let deadline = Instant::now() + UNPLUG_PATIENCE;
            while self.has_node() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }

    /// Plugs in again, into the same port, after unplugging if need be. Controls are at their defaults then.
    ///
    /// # Errors
    /// [`WebcamError::Plug`].
    pub fn replug(&mut self) -> Result<(), WebcamError> {
        self.unplug();
        self.lock().controls.reset();
        let socket = vhci::attach(self.port)?;
        let ours = socket.try_clone().map_err(|source| VhciError::Attach {
            port: self.port,
            source,
        })?;
        let device = device::Device::new(socket, &self.config, Arc::clone(&self.state));
        self.plugged = Some((ours, std::thread::spawn(move || device.run())));
        Ok(())
    }

    /// Waits for the device node that pictures come from, `/dev/videoN`. N may be another after a replug.
    ///
    /// # Errors
    /// [`WebcamError::NoNode`] when there is none in time.
    pub fn node(&self, patience: Duration) -> Result<PathBuf, WebcamError> {
        let deadline = Instant::now() + patience;
        loop {
            if let Some(node) = node::find(self.port) {
                return Ok(node);
            }
            if Instant::now() >= deadline {
                return Err(WebcamError::NoNode {
                    port: self.port,
                    waited_s: patience.as_secs_f32(),
                });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether there is a device node for it now.
    pub fn has_node(&self) -> bool {
        node::find(self.port).is_some()
    }

    /// Shows it another scene, from the next frame on.
    pub fn set_scene(&self, scene: Scene) {
        let mut state = self.lock();
        state.scene = Arc::new(scene);
        state.scene_version += 1;
    }

    /// Changes the light, from the next frame on.
    pub fn set_light(&self, light: Light) {
        self.lock().light = light;
    }

    /// Lets a fault befall the next `n_frames` frames.
    pub fn befall(&self, fault: FrameFault, n_frames: usize) {
        self.lock().faults.befall(fault, n_frames);
    }

    /// Stops sending pictures, or goes on. Controls still answer.
    pub fn hang(&self, hangs: bool) {
        self.lock().faults.hangs = hangs;
    }

    /// Makes the frame interval longer than agreed by this factor; 1 is as agreed.
    pub fn slow_down(&self, factor: f64) {
        self.lock().faults.slowness = factor.max(0.1);
    }

    /// Makes the webcam refuse to set a control, with a request error code of UVC (1 to 8); `None` ends it.
    pub fn stall_control(&self, control: Control, error_code: Option<u8>) {
        self.lock().controls.stall(control, error_code);
    }

    /// Switches both automatics on as a webcam's firmware might: nobody is told.
    pub fn switch_automatics_on(&self) {
        let mut state = self.lock();
        state.controls.set(Control::ExposureMode, APERTURE_PRIORITY);
        state.controls.set(Control::WhiteBalanceAuto, 1);
    }

    /// The value of a control inside the webcam, whatever driver and program believe.
    pub fn control(&self, control: Control) -> i32 {
        self.lock().controls.get(control)
    }

    /// The truth about the frame that shows these 16 bits of its counter (see [`counter`]).
    pub fn truth_of(&self, shown_counter: u16) -> Option<FrameTruth> {
        self.lock().truth.find(shown_counter)
    }

    /// The truth about all frames, oldest first; at most the last 65536.
    pub fn truth(&self) -> Vec<FrameTruth> {
        self.lock().truth.frames()
    }

    /// The sensor.
    pub fn sensor(&self) -> &SensorModel {
        &self.config.sensor
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

impl Drop for Webcam {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// The state, also after a thread panicked while it held it: all of it is plain values.
fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
