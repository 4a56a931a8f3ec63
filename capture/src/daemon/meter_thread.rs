//! Measures JPEG pictures on a thread of its own: decoding takes too long for whoever hands frames on.
//!
//! The newest picture of each camera wins; those it replaces are not measured.

use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use crossbeam_queue::ArrayQueue;

use super::event::{Event, What};
use crate::decode::to_rgb8;
use crate::frame::Frame;
use crate::meter::Meter;

/// The way to the thread. It ends when this is dropped.
pub(super) struct MeterThread {
    slots: Arc<Vec<ArrayQueue<Frame>>>,
    bell: Sender<()>,
}

impl MeterThread {
    /// Starts the thread, with a meter for each camera.
    ///
    /// # Errors
    ///
    /// The system has no thread to give.
    pub(super) fn start(mut meters: Vec<Meter>, events: Sender<Event>) -> std::io::Result<Self> {
        let slots: Arc<Vec<_>> = Arc::new(meters.iter().map(|_| ArrayQueue::new(1)).collect());
        let (bell, ring) = bounded(1);
        let mine = slots.clone();
        std::thread::Builder::new()
            .name("meter".to_owned())
            .spawn(move || serve(&mut meters, &mine, &ring, &events))?;
        Ok(Self { slots, bell })
    }

    /// Hands a picture over, in place of one that was not measured yet. Never waits.
    pub(super) fn measure(&self, camera: usize, frame: Frame) {
        drop(self.slots[camera].force_push(frame));
        match self.bell.try_send(()) {
            Ok(()) | Err(TrySendError::Full(()) | TrySendError::Disconnected(())) => {}
        }
    }
}

fn serve(meters: &mut [Meter], slots: &[ArrayQueue<Frame>], ring: &Receiver<()>, events: &Sender<Event>) {
    while ring.recv().is_ok() {
        for (camera, (slot, meter)) in slots.iter().zip(&mut *meters).enumerate() {
            let Some(frame) = slot.pop() else { continue };
            let what = measure(meter, &frame);
            if events.send(Event { camera, what }).is_err() {
                return;
            }
        }
    }
}

fn measure(meter: &mut Meter, frame: &Frame) -> What {
    let sequence = frame.meta.sequence;
    let decoded = match to_rgb8(frame) {
        Ok(decoded) => decoded,
        Err(error) => {
            let reason = error.to_string();
            return What::Undecodable { sequence, reason };
        }
    };
    match meter.measure(decoded.size, decoded.format, &decoded.pixels) {
        Ok(statistics) => What::Measured {
            sequence,
            statistics: Box::new(statistics),
        },
        Err(error) => What::Undecodable {
            sequence,
            reason: error.to_string(),
        },
    }
}
