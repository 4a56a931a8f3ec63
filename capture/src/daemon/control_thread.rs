//! Sets the controls of one open camera, on a thread of its own: a USB camera may take a frame's time to answer, or
//! seconds when it is in trouble, and nobody else should wait for that.
//!
//! Between requests it looks whether the values are still those that were set: of a webcam whose firmware switches an
//! automatic mode on nobody is told.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};

use super::device::Controls;
use super::event::{Event, What};
use crate::controls::ControlValues;
use crate::lockstep::Request;
use crate::v4l2::{ControlError, monotonic_ns};

/// Requests that may wait. What does not find room counts as refused, and is asked for again later.
const WAITING_MAX: usize = 4;

/// Without a request the values are looked at so often.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);

/// What the thread is told.
pub(super) struct ControlTask {
    /// Index of the camera.
    pub(super) camera: usize,
    /// Its controls.
    pub(super) controls: Box<dyn Controls>,
    /// Their values now.
    pub(super) values: ControlValues,
    /// To the hub.
    pub(super) events: Sender<Event>,
}

/// Starts the thread and returns the way to it. It ends when that is dropped, after the call it is in.
///
/// # Errors
///
/// The system has no thread to give.
pub(super) fn start(name: &str, mut task: ControlTask) -> std::io::Result<Sender<Request>> {
    let (requests, incoming) = bounded(WAITING_MAX);
    std::thread::Builder::new()
        .name(format!("controls {name}"))
        .spawn(move || task.serve(&incoming))?;
    Ok(requests)
}

impl ControlTask {
    /// Serves until nobody can ask any more, or nobody listens.
    fn serve(&mut self, incoming: &Receiver<Request>) {
        loop {
            let goes_on = match incoming.recv_timeout(LOOK_INTERVAL) {
                Ok(request) => self.answer(&request),
                Err(RecvTimeoutError::Timeout) => self.look(),
                Err(RecvTimeoutError::Disconnected) => false,
            };
            if !goes_on {
                return;
            }
        }
    }

    fn answer(&mut self, request: &Request) -> bool {
        match self.carry_out(request) {
            Ok((read_back, accepted_ns)) => {
                self.values.merge(&read_back);
                self.send(What::Applied {
                    id: request.id,
                    read_back,
                    accepted_ns,
                })
            }
            Err(error) => {
                // Of several values those before the refused one are set: what is in force has to be asked for.
                let is_told = self.controls.read().map_or(true, |values| self.found(values));
                let (id, reason) = (request.id, error.to_string());
                let is_automatic = matches!(
                    error,
                    ControlError::AutoStillOn { .. } | ControlError::AutoStays { .. } | ControlError::Refused { .. }
                );
                is_told
                    && self.send(What::Refused {
                        id,
                        reason,
                        is_automatic,
                    })
            }
        }
    }

    /// Sets the values of a request; returns what the camera has made of them, and since when.
    fn carry_out(&self, request: &Request) -> Result<(ControlValues, u64), ControlError> {
        if request.asserts_manual {
            self.controls.take_manual()?;
        }
        let begun_ns = monotonic_ns();
        let read_back = self.controls.set(&request.values)?;
        // Half of that time goes into setting the values, the other half into reading them back.
        Ok((read_back, begun_ns.midpoint(monotonic_ns())))
    }

    /// Looks whether somebody has changed the values.
    fn look(&mut self) -> bool {
        // A camera that does not answer now will be missed by those who take its frames.
        let Ok(values) = self.controls.read() else {
            return true;
        };
        values == self.values || (self.send(What::Drifted) && self.found(values))
    }

    /// Takes note of values that were read.
    fn found(&mut self, values: ControlValues) -> bool {
        self.values = values;
        let accepted_ns = monotonic_ns();
        self.send(What::Found { values, accepted_ns })
    }

    /// Tells the hub; false if it is gone.
    fn send(&self, what: What) -> bool {
        let camera = self.camera;
        self.events.send(Event { camera, what }).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::path::PathBuf;
    use std::sync::Mutex;

    use super::*;
    use crate::controls::{ControlKind, ControlRanges};
    use crate::lockstep::RequestId;
    use crate::v4l2::AutoMode;

    /// A camera whose gain is refused, and whose values are these when they are read.
    struct Stubborn(Mutex<VecDeque<i64>>);

    impl Controls for Stubborn {
        fn ranges(&self) -> ControlRanges {
            ControlRanges::default()
        }

        fn take_manual(&self) -> Result<Vec<AutoMode>, ControlError> {
            Ok(Vec::new())
        }

        fn read(&self) -> Result<ControlValues, ControlError> {
            let mut reads = self.0.lock().unwrap();
            let value = if reads.len() > 1 {
                reads.pop_front()
            } else {
                reads.front().copied()
            };
            Ok(exposure(value.unwrap()))
        }

        fn set(&self, wanted: &ControlValues) -> Result<ControlValues, ControlError> {
            match wanted.get(ControlKind::Gain) {
                None => Ok(*wanted),
                Some(_) => Err(ControlError::Missing {
                    path: PathBuf::from("stubborn"),
                    kind: ControlKind::Gain,
                }),
            }
        }
    }

    fn exposure(value: i64) -> ControlValues {
        let mut values = ControlValues::default();
        values.set(ControlKind::ExposureTime, value);
        values
    }

    fn request(values: ControlValues) -> Request {
        Request {
            id: RequestId(1),
            values,
            asserts_manual: false,
        }
    }

    #[test]
    fn after_a_refusal_it_is_told_what_was_set_before() {
        let (events, told) = bounded(8);
        let task = ControlTask {
            camera: 0,
            controls: Box::new(Stubborn(Mutex::new([7].into()))),
            values: exposure(5),
            events,
        };
        let requests = start("test", task).unwrap();
        let mut both = exposure(7);
        both.set(ControlKind::Gain, 1);
        requests.send(request(both)).unwrap();
        assert!(matches!(told.recv().unwrap().what, What::Found { values, .. } if values == exposure(7)));
        assert!(matches!(
            told.recv().unwrap().what,
            What::Refused {
                is_automatic: false,
                ..
            }
        ));
        requests.send(request(exposure(9))).unwrap();
        assert!(matches!(told.recv().unwrap().what, What::Applied { read_back, .. } if read_back == exposure(9)));
    }

    #[test]
    fn values_that_change_by_themselves_are_told_once() {
        let (events, told) = bounded(8);
        let mut task = ControlTask {
            camera: 0,
            controls: Box::new(Stubborn(Mutex::new([5, 6, 6].into()))),
            values: exposure(5),
            events,
        };
        assert!(task.look() && told.is_empty());
        assert!(task.look() && task.look());
        assert!(matches!(told.recv().unwrap().what, What::Drifted));
        assert!(matches!(told.recv().unwrap().what, What::Found { values, .. } if values == exposure(6)));
        assert!(told.is_empty());
    }
}
