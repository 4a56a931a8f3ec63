//! The daemon: drives one or more cameras, keeps their exposure and white balance in step, publishes frame sets.
//!
//! ```text
//! camera thread (one per camera) --Event--> hub --FrameSet--> publisher
//!     ^                                     |  \--Frame----> recorder
//!   Device                                  |   \-JPEG-----> meter thread --Event--> hub
//! control thread (one per open camera) <-Request
//!     \---------------------------Event---> hub
//! ```
//!
//! The **hub** is the one place where things are decided: it runs on the caller's thread and never waits for a camera,
//! a disk or a reader. Everything comes to it through one bounded queue. A camera that is unplugged, hangs or fails is
//! the business of its own thread, which looks for it until it is back; the other cameras go on.
//!
//! Frames that are missing are counted with their cause ([`crate::stamps::LossLedger`]); nothing is lost in silence.

mod camera_thread;
mod control_thread;
mod device;
mod event;
mod hub;
mod meter_thread;
mod report;
mod simulated;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};

pub use device::{Controls, Device, Mode, OpenCamera, V4l2Device};
pub use report::{CameraReport, CameraStage, Report, Skew};
pub use simulated::{SimulatedDevice, SimulatedFault, SimulatedMethod};

use crate::handover::{HandoverError, Publisher};
use crate::lockstep::LockstepSettings;
use crate::lockstep::tables::Tables;
use crate::meter::Response;
use crate::recording::mcap::Recorder;
use crate::source::CameraDescription;
use crate::stamps::StampSettings;
use camera_thread::CameraTask;
use event::Event;
use hub::Hub;

/// Events that may wait for the hub. Frames that find it full are lost as overruns: the hub is a second behind then.
const EVENTS_MAX: usize = 128;

/// Longest wait of the hub before it looks whether it should end.
const TURN: Duration = Duration::from_millis(50);

/// Interval between two reports.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// One camera of the daemon.
pub struct CameraSetup {
    /// Its name, role and size, and the format that takes the most room of those it may agree to.
    pub description: CameraDescription,
    /// Where it is.
    pub device: Box<dyn Device>,
    /// How its stamps are read.
    pub stamps: StampSettings,
    /// What its pixel codes mean.
    pub response: Response,
    /// What its controls do.
    pub tables: Tables,
    /// Frames between a request and its effect, if known; else it is measured.
    pub latency_frames: Option<u32>,
    /// Buffers of frames that are neither free nor in use by anybody else; more than the driver has.
    pub n_buffers: usize,
}

/// What the daemon is told besides its cameras.
#[derive(Debug, Clone)]
pub struct DaemonSettings {
    /// How exposure and white balance are decided.
    pub lockstep: LockstepSettings,
    /// Largest difference in time between frames of one set.
    pub max_skew: Duration,
}

/// Why the daemon cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// Frames cannot be handed over.
    #[error(transparent)]
    Handover(#[from] HandoverError),
    /// The lockstep cannot do what it is told.
    #[error("cannot keep the cameras in step")]
    Lockstep(#[from] crate::lockstep::LockstepError),
    /// A thread cannot be started.
    #[error("cannot start a thread for camera `{camera}`")]
    StartThread {
        /// Name of the camera.
        camera: String,
        /// What the system said.
        #[source]
        source: std::io::Error,
    },
}

impl DaemonError {
    /// True if the user's input is to blame (exit code 2), false if the program has failed (exit code 1).
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Handover(error) => error.is_bad_input(),
            Self::Lockstep(_) => true,
            Self::StartThread { .. } => false,
        }
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Handover(error) => error.hint(),
            Self::Lockstep(error) => error.hint(),
            Self::StartThread { .. } => "free memory or raise the limit on threads",
        }
    }
}

/// Cameras at work.
pub struct Daemon {
    hub: Hub,
    events: Receiver<Event>,
    threads: Vec<JoinHandle<()>>,
    stop: StopOnDrop,
}

/// Tells the threads to end, at the latest when the daemon is dropped.
struct StopOnDrop(Arc<AtomicBool>);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        // The flag guards no other data.
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Daemon {
    /// Starts a thread for each camera. Cameras need not be there yet.
    ///
    /// # Errors
    ///
    /// [`DaemonError`] if the pools or threads cannot be had, or the settings are wrong.
    pub fn start(
        cameras: Vec<CameraSetup>,
        settings: DaemonSettings,
        publisher: Publisher,
        recorder: Option<Recorder>,
    ) -> Result<Self, DaemonError> {
        let (sender, events) = bounded(EVENTS_MAX);
        let stop = StopOnDrop(Arc::new(AtomicBool::new(false)));
        let mut tasks = Vec::with_capacity(cameras.len());
        let mut tracks = Vec::with_capacity(cameras.len());
        for (camera, setup) in cameras.into_iter().enumerate() {
            let buffer_bytes = setup.description.format.max_bytes(setup.description.size);
            tasks.push(CameraTask {
                camera,
                name: setup.description.name.clone(),
                device: setup.device,
                stamps: setup.stamps,
                pool: publisher.pool(setup.n_buffers, buffer_bytes)?,
            });
            tracks.push(hub::CameraTrack::new(
                setup.description,
                setup.response,
                setup.tables,
                setup.latency_frames,
                setup.stamps.interval_ns,
            ));
        }
        let hub = Hub::new(tracks, settings, publisher, recorder, sender.clone())?;
        let mut threads = Vec::with_capacity(tasks.len());
        for task in tasks {
            let camera = task.name.to_string();
            let started = camera_thread::start(task, sender.clone(), stop.0.clone());
            threads.push(started.map_err(|source| DaemonError::StartThread { camera, source })?);
        }
        Ok(Self {
            hub,
            events,
            threads,
            stop,
        })
    }

    /// Works until `stop` is raised; `on_report` is told once a second how things stand.
    ///
    /// # Errors
    ///
    /// [`DaemonError`] if frames cannot be handed over any more.
    pub fn run(&mut self, stop: &AtomicBool, on_report: &mut dyn FnMut(&Report)) -> Result<(), DaemonError> {
        let mut last_report = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            match self.events.recv_timeout(TURN) {
                Ok(event) => self.hub.take(event)?,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
            if last_report.elapsed() >= REPORT_INTERVAL {
                last_report = Instant::now();
                on_report(&self.hub.report());
            }
        }
        Ok(())
    }

    /// Stops the cameras, gives their buffers back, hands over what was still under way and ends the recording.
    ///
    /// # Errors
    ///
    /// [`DaemonError`] if the last frames cannot be handed over.
    pub fn finish(mut self) -> Result<(Report, Option<Recorder>), DaemonError> {
        self.stop.0.store(true, Ordering::Relaxed);
        while self.threads.iter().any(|thread| !thread.is_finished()) {
            if let Ok(event) = self.events.recv_timeout(TURN) {
                self.hub.take(event)?;
            }
        }
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                tracing::error!("the thread of a camera has panicked; please report it");
            }
        }
        while let Ok(event) = self.events.try_recv() {
            self.hub.take(event)?;
        }
        self.hub.finish()
    }
}
