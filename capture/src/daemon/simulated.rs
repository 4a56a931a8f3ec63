//! A camera from memory to memory, with faults by script: for tests of the daemon and to measure what a frame costs.

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::device::{Controls, Device, Mode, OpenCamera};
use crate::frame::{BufferFlags, PixelFormat, Pixels, Size};
use crate::pool::{Lease, Pool};
use crate::v4l2::{Loss, LossCause, Raw, StreamError, Taken, V4l2Error, monotonic_ns};

/// `V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC` and `V4L2_BUF_FLAG_TSTAMP_SRC_SOE`.
const FLAGS: BufferFlags = BufferFlags(0x2000 | 0x1_0000);

/// How pictures get into the pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimulatedMethod {
    /// Each is copied there, as from buffers that the driver owns.
    Copied,
    /// They are there already, as if a driver had written them: nothing is touched.
    InPlace,
}

/// What happens instead of a frame, or to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimulatedFault {
    /// The driver drops it: a gap in the sequence numbers.
    Dropped,
    /// The driver flags its buffer as faulty.
    ErrorFlag,
    /// The sensor skips it: no gap in the numbers, one in time.
    Skipped,
    /// It comes a second time with the same number and stamp.
    Repeated,
    /// The stream breaks and has to be restarted.
    Broken,
    /// The camera is unplugged and back after so many looks for it.
    Unplugged {
        /// Looks that find nothing.
        looks: u32,
    },
}

/// A place with a simulated camera. A clone is the same place.
#[derive(Debug, Clone)]
pub struct SimulatedDevice {
    mode: Mode,
    method: SimulatedMethod,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// Faults yet to come, by the number of the frame they happen to.
    faults: VecDeque<(u64, SimulatedFault)>,
    looks_missing: u32,
    /// Frames the sensor has made, in all.
    made: u64,
}

impl SimulatedDevice {
    /// A camera with frames of an uncompressed format every `interval`, as fast as they are taken if that is zero, and
    /// with faults by the number of the frame they happen to, rising from 0.
    #[must_use]
    pub fn new(
        format: PixelFormat,
        size: Size,
        interval: Duration,
        method: SimulatedMethod,
        faults: &[(u64, SimulatedFault)],
    ) -> Self {
        let state = State {
            faults: faults.iter().copied().collect(),
            ..State::default()
        };
        Self {
            mode: Mode {
                format,
                size,
                interval_ns: u64::try_from(interval.as_nanos()).unwrap_or(u64::MAX).max(1),
                buffer_bytes: format.max_bytes(size),
                label: "simulated".to_owned(),
            },
            method,
            state: Arc::new(Mutex::new(state)),
        }
    }

    /// Frames the sensor has made so far, in whatever state they arrived.
    #[must_use]
    pub fn frames_made(&self) -> u64 {
        lock(&self.state).made
    }
}

fn lock(state: &Mutex<State>) -> std::sync::MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The name of the place in messages.
fn place() -> PathBuf {
    PathBuf::from("simulated")
}

impl Device for SimulatedDevice {
    fn open(&mut self) -> Result<Box<dyn OpenCamera>, V4l2Error> {
        let mut state = lock(&self.state);
        if state.looks_missing > 0 {
            state.looks_missing -= 1;
            return Err(V4l2Error::Unplugged { path: place() });
        }
        Ok(Box::new(OpenSimulated {
            mode: self.mode.clone(),
            method: self.method,
            picture: (0..self.mode.buffer_bytes).map(|index| (index % 251) as u8).collect(),
            lease: None,
            sequence: 0,
            next_at_ns: monotonic_ns(),
            again: None,
            state: self.state.clone(),
        }))
    }
}

struct OpenSimulated {
    mode: Mode,
    method: SimulatedMethod,
    picture: Vec<u8>,
    /// The buffer that the next picture is in.
    lease: Option<Box<dyn Lease>>,
    sequence: u32,
    /// When the next frame is made, on the monotonic clock.
    next_at_ns: u64,
    /// The frame that comes a second time.
    again: Option<Raw>,
    state: Arc<Mutex<State>>,
}

impl OpenSimulated {
    fn raw(&self, pixels: Pixels) -> Raw {
        Raw {
            bytes_used: u32::try_from(pixels.len()).unwrap_or(u32::MAX),
            pixels,
            sequence: self.sequence,
            dropped_before: 0,
            timestamp_ns: self.next_at_ns,
            dequeued_ns: monotonic_ns(),
            flags: FLAGS,
        }
    }

    /// The next picture, in a buffer of `pool`; none if the pool is empty.
    fn picture(&mut self, pool: &mut dyn Pool) -> Option<Pixels> {
        let n_bytes = self.picture.len();
        let mut lease = self.lease.take().or_else(|| pool.lease())?;
        match self.method {
            SimulatedMethod::Copied => lease.bytes_mut()[..n_bytes].copy_from_slice(&self.picture),
            SimulatedMethod::InPlace => {
                // A driver that writes in place needs the next buffer before it gives this one away.
                self.lease = Some(pool.lease()?);
            }
        }
        Some(lease.freeze(n_bytes))
    }

    fn loss(&self, cause: LossCause) -> Taken {
        Taken::Lost(Loss {
            cause,
            sequence: Some(self.sequence),
            dropped_before: 0,
            dequeued_ns: monotonic_ns(),
        })
    }

    /// Lets time pass to the next frame; false if that is later than the timeout.
    fn wait(&mut self, timeout: Duration) -> bool {
        let now_ns = monotonic_ns();
        let is_endless = self.mode.interval_ns <= 1;
        if is_endless {
            self.next_at_ns = now_ns;
            return true;
        }
        let wait = Duration::from_nanos(self.next_at_ns.saturating_sub(now_ns));
        std::thread::sleep(wait.min(timeout));
        wait <= timeout
    }

    fn advance(&mut self) {
        self.sequence = self.sequence.wrapping_add(1);
        self.next_at_ns += self.mode.interval_ns;
    }
}

impl OpenCamera for OpenSimulated {
    fn mode(&self) -> Mode {
        self.mode.clone()
    }

    fn controls(&self) -> Option<Box<dyn Controls>> {
        None
    }

    fn start(&mut self, _pool: &mut dyn Pool) -> Result<(), StreamError> {
        Ok(())
    }

    fn next(&mut self, pool: &mut dyn Pool, timeout: Duration) -> Result<Taken, StreamError> {
        if let Some(again) = self.again.take() {
            return Ok(Taken::Frame(again));
        }
        if !self.wait(timeout) {
            return Ok(Taken::TimedOut);
        }
        let fault = {
            let mut state = lock(&self.state);
            let number = state.made;
            state.made += 1;
            let is_due = state.faults.front().is_some_and(|(at, _)| *at <= number);
            if is_due {
                state.faults.pop_front().map(|(_, fault)| fault)
            } else {
                None
            }
        };
        let taken = match fault {
            Some(SimulatedFault::Dropped) => Taken::TimedOut,
            Some(SimulatedFault::Skipped) => {
                self.next_at_ns += self.mode.interval_ns;
                return Ok(Taken::TimedOut);
            }
            Some(SimulatedFault::ErrorFlag) => self.loss(LossCause::ErrorFlag),
            Some(SimulatedFault::Broken) => {
                self.advance();
                let source = io::Error::from_raw_os_error(libc::EIO);
                return Err(StreamError::Failed { path: place(), source });
            }
            Some(SimulatedFault::Unplugged { looks }) => {
                lock(&self.state).looks_missing = looks;
                return Err(StreamError::Unplugged { path: place() });
            }
            Some(SimulatedFault::Repeated) | None => match self.picture(pool) {
                Some(pixels) => {
                    let raw = self.raw(pixels);
                    if fault.is_some() {
                        self.again = Some(raw.clone());
                    }
                    Taken::Frame(raw)
                }
                None => self.loss(LossCause::Overrun),
            },
        };
        self.advance();
        Ok(taken)
    }

    fn restart(&mut self) -> Result<(), StreamError> {
        self.sequence = 0;
        Ok(())
    }
}
