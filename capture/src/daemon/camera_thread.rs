//! Keeps one camera streaming, whatever happens to it: looks for it, opens it, takes its frames, starts a stream anew
//! that stands still, and looks for the camera again when it is gone.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;

use super::control_thread::{self, ControlTask};
use super::device::{Controls, Device, Mode, OpenCamera};
use super::event::{Captured, Event, OpenControls, Opened, Tally, What};
use crate::decode::is_whole_jpeg;
use crate::frame::PixelFormat;
use crate::pool::Pool;
use crate::stamps::{
    BufferStamp, Checked, Interruption, LossCause, LossLedger, StampChecker, StampKind, StampSettings,
};
use crate::v4l2::{self, Loss, Raw, StampClock, StreamError, Taken};

/// Interval between two looks for a camera that is not there.
const SEARCH_INTERVAL: Duration = Duration::from_millis(50);

/// Longest wait for a frame before the thread looks whether it should end.
const TURN: Duration = Duration::from_millis(100);

/// Silence after which a stream counts as standing still: this long, and ten frames' time at least.
const STANDSTILL: Duration = Duration::from_secs(2);

/// Restarts in a row without a frame after which the camera is closed and opened anew.
const RESTARTS_MAX: u32 = 3;

/// Pause before a restart, so that a camera in trouble is not asked without end.
const RESTART_PAUSE: Duration = Duration::from_millis(50);

/// Interval between two accounts.
const TALLY_INTERVAL: Duration = Duration::from_millis(250);

/// What the thread is told.
pub(super) struct CameraTask {
    /// Index of the camera.
    pub(super) camera: usize,
    /// Its name.
    pub(super) name: Arc<str>,
    /// Where it is.
    pub(super) device: Box<dyn Device>,
    /// How its stamps are read.
    pub(super) stamps: StampSettings,
    /// Where its frames are written.
    pub(super) pool: Box<dyn Pool>,
}

/// Starts the thread. It ends soon after `stop` is raised or the receiver of events is dropped.
///
/// # Errors
///
/// The system has no thread to give.
pub(super) fn start(task: CameraTask, events: Sender<Event>, stop: Arc<AtomicBool>) -> std::io::Result<JoinHandle<()>> {
    let checker = StampChecker::new(task.stamps);
    let mut thread = CameraThread {
        camera: task.camera,
        name: task.name,
        pool: task.pool,
        checker,
        ledger: LossLedger::new(task.stamps.interval_ns),
        opened: 0,
        restarts: 0,
        last_tally: Instant::now(),
        complaint: None,
        events,
        stop,
    };
    let mut device = task.device;
    std::thread::Builder::new()
        .name(format!("camera {}", thread.name))
        .spawn(move || thread.run(&mut *device))
}

struct CameraThread {
    camera: usize,
    name: Arc<str>,
    pool: Box<dyn Pool>,
    checker: StampChecker,
    ledger: LossLedger,
    opened: u64,
    restarts: u64,
    last_tally: Instant,
    /// Why the camera could not be opened, so that it is told once.
    complaint: Option<String>,
    events: Sender<Event>,
    stop: Arc<AtomicBool>,
}

/// Why a camera was closed, or that the thread is to end.
enum Closed {
    Because(String),
    Stop,
}

impl CameraThread {
    fn run(&mut self, device: &mut dyn Device) {
        while !self.is_stopped() {
            let reason = match device.open() {
                Ok(mut camera) => match self.serve(&mut *camera) {
                    Closed::Because(reason) => reason,
                    Closed::Stop => break,
                },
                Err(error) => with_causes(&error),
            };
            self.report_closed(reason);
            std::thread::sleep(SEARCH_INTERVAL);
        }
        self.send_tally();
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Tells why there is no camera, unless it has been told already.
    fn report_closed(&mut self, reason: String) {
        if self.complaint.as_ref() != Some(&reason) {
            self.complaint = Some(reason.clone());
            self.send(What::Closed { reason });
        }
    }

    /// Streams until the camera is gone or the thread is to end.
    fn serve(&mut self, camera: &mut dyn OpenCamera) -> Closed {
        let mode = camera.mode();
        if mode.buffer_bytes > self.pool.buffer_bytes() {
            return Closed::Because(format!(
                "{} needs buffers of {} bytes, there is room for {}",
                mode.label,
                mode.buffer_bytes,
                self.pool.buffer_bytes()
            ));
        }
        let opened = self.open_controls(camera.controls(), mode.clone());
        if let Err(error) = camera.start(&mut *self.pool) {
            return Closed::Because(with_causes(&error));
        }
        self.checker.begin_stream(mode.interval_ns);
        if self.opened > 0 {
            self.ledger.interrupted(Interruption::Unplugged, mode.interval_ns);
        }
        self.opened += 1;
        self.complaint = None;
        if !self.send(What::Opened(Box::new(opened))) {
            return Closed::Stop;
        }
        self.take_frames(camera, &mode)
    }

    /// Switches automatic modes off and starts the thread of the controls.
    fn open_controls(&mut self, controls: Option<Box<dyn Controls>>, mode: Mode) -> Opened {
        let mut opened = Opened {
            mode,
            controls: None,
            switched_off: Vec::new(),
            complaint: None,
        };
        let Some(controls) = controls else {
            return opened;
        };
        match controls.take_manual() {
            Ok(modes) => opened.switched_off = modes,
            Err(error) => opened.complaint = Some(with_causes(&error)),
        }
        let ranges = controls.ranges();
        let started = controls.read().map_err(|error| with_causes(&error)).and_then(|values| {
            let task = ControlTask {
                camera: self.camera,
                controls,
                values,
                events: self.events.clone(),
            };
            let requests = control_thread::start(&self.name, task).map_err(|error| with_causes(&error))?;
            Ok((values, requests))
        });
        match started {
            Ok((values, requests)) => {
                opened.controls = Some(OpenControls {
                    ranges,
                    values,
                    requests,
                });
            }
            Err(complaint) => opened.complaint = Some(complaint),
        }
        opened
    }

    fn take_frames(&mut self, camera: &mut dyn OpenCamera, mode: &Mode) -> Closed {
        let standstill = STANDSTILL.max(Duration::from_nanos(mode.interval_ns.saturating_mul(10)));
        let mut last_frame = Instant::now();
        let mut restarts_in_a_row = 0;
        while !self.is_stopped() {
            let trouble = match camera.next(&mut *self.pool, TURN) {
                Ok(Taken::TimedOut) if last_frame.elapsed() > standstill => {
                    format!("no frame for {:.1} s", last_frame.elapsed().as_secs_f64())
                }
                Ok(taken) => {
                    if matches!(taken, Taken::Frame(_)) {
                        last_frame = Instant::now();
                        restarts_in_a_row = 0;
                    }
                    if !self.take(taken, mode) {
                        return Closed::Stop;
                    }
                    continue;
                }
                Err(error) if error.is_restartable() => with_causes(&error),
                Err(error) => return Closed::Because(with_causes(&error)),
            };
            restarts_in_a_row += 1;
            if restarts_in_a_row > RESTARTS_MAX {
                return Closed::Because(format!("{trouble}, and {RESTARTS_MAX} restarts have not helped"));
            }
            if let Err(error) = self.restart(camera, mode, trouble) {
                return Closed::Because(with_causes(&error));
            }
            last_frame = Instant::now();
        }
        Closed::Stop
    }

    fn restart(&mut self, camera: &mut dyn OpenCamera, mode: &Mode, reason: String) -> Result<(), StreamError> {
        self.restarts += 1;
        self.send(What::Restarted { reason });
        std::thread::sleep(RESTART_PAUSE);
        camera.restart()?;
        self.checker.begin_stream(mode.interval_ns);
        self.ledger.interrupted(Interruption::StreamRestart, mode.interval_ns);
        Ok(())
    }

    /// Accounts for what the stream gave; false if nobody listens any more.
    fn take(&mut self, taken: Taken, mode: &Mode) -> bool {
        let goes_on = match taken {
            Taken::Frame(raw) => self.take_frame(raw, mode),
            Taken::Lost(loss) => {
                self.take_loss(&loss);
                true
            }
            Taken::ControlChanged(change) => match change.switched_on() {
                Some(auto_mode) => self.send(What::AutoModeFound(auto_mode)),
                None => true,
            },
            Taken::TimedOut => true,
        };
        if self.last_tally.elapsed() >= TALLY_INTERVAL {
            self.send_tally();
        }
        goes_on
    }

    fn take_frame(&mut self, raw: Raw, mode: &Mode) -> bool {
        let stamp = BufferStamp {
            sequence: raw.sequence,
            stamp_ns: raw.timestamp_ns,
            kind: match raw.clock() {
                StampClock::Monotonic => StampKind::Monotonic,
                StampClock::Copied | StampClock::Unknown => StampKind::Other,
            },
            dequeued_ns: raw.dequeued_ns,
        };
        let defect = if !mode.format.admits(mode.size, raw.pixels.len()) {
            Some(LossCause::Overrun)
        } else if mode.format == PixelFormat::Mjpeg && !is_whole_jpeg(&raw.pixels) {
            Some(LossCause::BadJpeg)
        } else if self.events.is_full() {
            Some(LossCause::Overrun)
        } else {
            None
        };
        if let Some(cause) = defect {
            let sequence = self.checker.place(stamp.sequence, stamp.dequeued_ns);
            self.ledger.lost(cause, sequence);
            return true;
        }
        match self.checker.check(stamp) {
            Checked::Frame(checked) => {
                let lost_before = self.ledger.delivered(&checked);
                self.send(What::Frame(Captured {
                    sequence: checked.sequence,
                    timestamp_ns: checked.timestamp_ns,
                    lost_before,
                    flags: raw.flags,
                    pixels: raw.pixels,
                }))
            }
            Checked::BadStamp { sequence, .. } => {
                self.ledger.lost(LossCause::BadStamp, Some(sequence));
                true
            }
            Checked::Duplicate => {
                self.ledger.duplicate();
                true
            }
        }
    }

    fn take_loss(&mut self, loss: &Loss) {
        // Buffers that a failed transfer leaves empty have no number of their own, whatever the driver writes there.
        let numbered = loss.sequence.filter(|_| loss.cause != v4l2::LossCause::Empty);
        let sequence = numbered.and_then(|sequence| self.checker.place(sequence, loss.dequeued_ns));
        let cause = match loss.cause {
            v4l2::LossCause::ErrorFlag => LossCause::ErrorFrame,
            v4l2::LossCause::Short { .. } | v4l2::LossCause::Long { .. } => LossCause::ShortFrame,
            v4l2::LossCause::Empty => LossCause::ZeroLength,
            v4l2::LossCause::Overrun => LossCause::Overrun,
        };
        self.ledger.lost(cause, sequence);
    }

    fn send_tally(&mut self) {
        self.last_tally = Instant::now();
        let tally = Tally {
            delivered: self.ledger.delivered_frames(),
            losses: *self.ledger.counts(),
            duplicates: self.ledger.duplicates(),
            empty_buffers: self.ledger.empty_buffers(),
            stamps: self.checker.counters(),
            basis: self.checker.basis(),
            opened: self.opened,
            restarts: self.restarts,
        };
        self.send(What::Tally(Box::new(tally)));
    }

    /// Tells the hub; false if it is gone.
    fn send(&self, what: What) -> bool {
        let camera = self.camera;
        self.events.send(Event { camera, what }).is_ok()
    }
}

/// An error and what caused it, in one line.
fn with_causes(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        line.push_str(": ");
        line.push_str(&error.to_string());
        cause = error.source();
    }
    line
}
