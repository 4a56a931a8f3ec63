//! Sets the controls of one open camera, on a thread of its own: a USB camera may take a frame's time to answer, or
//! seconds when it is in trouble, and nobody else should wait for that.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::device::Controls;
use super::event::{Event, What};
use crate::controls::ControlValues;
use crate::lockstep::Request;
use crate::v4l2::ControlError;

/// Requests that may wait. A camera that is slower than this is told only the newest.
const WAITING_MAX: usize = 4;

/// Starts the thread and returns the way to it. It ends when that is dropped, after the call it is in.
///
/// `last_sequence` is the number of the last frame taken from the camera, kept up to date by the thread that takes them.
///
/// # Errors
///
/// The system has no thread to give.
pub(super) fn start(
    camera: usize,
    name: &str,
    controls: Box<dyn Controls>,
    last_sequence: Arc<AtomicU64>,
    events: Sender<Event>,
) -> std::io::Result<Sender<Request>> {
    let (requests, incoming) = bounded(WAITING_MAX);
    std::thread::Builder::new()
        .name(format!("controls {name}"))
        .spawn(move || serve(camera, &*controls, &incoming, &last_sequence, &events))?;
    Ok(requests)
}

fn serve(
    camera: usize,
    controls: &dyn Controls,
    incoming: &Receiver<Request>,
    last_sequence: &AtomicU64,
    events: &Sender<Event>,
) {
    while let Ok(request) = incoming.recv() {
        let what = match carry_out(controls, &request) {
            Ok(read_back) => What::Applied {
                id: request.id,
                read_back,
                // The number alone counts; nothing else is read on its strength.
                first_sequence_after: last_sequence.load(Ordering::Relaxed) + 1,
            },
            Err(error) => What::Refused {
                id: request.id,
                reason: error.to_string(),
            },
        };
        if events.send(Event { camera, what }).is_err() {
            return;
        }
    }
}

fn carry_out(controls: &dyn Controls, request: &Request) -> Result<ControlValues, ControlError> {
    if request.asserts_manual {
        controls.take_manual()?;
    }
    controls.set(&request.values)
}
