//! The two transports inside one process, on crossbeam's queues. No lock and no `unsafe` of our own.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, SendError, Sender, TrySendError};
use crossbeam_queue::ArrayQueue;

use super::{Arrival, HandoverError, NumberedSet, PublishOutcome};

/// What goes through the lossless channel.
#[derive(Debug)]
enum Message {
    Set(NumberedSet),
    Failed(HandoverError),
}

#[derive(Debug)]
pub(super) struct LosslessPublisher {
    sender: Sender<Message>,
    /// Holds a token while the reader lives.
    reader_lives: std::sync::Weak<()>,
}

#[derive(Debug)]
pub(super) struct LosslessSubscriber {
    receiver: Receiver<Message>,
    _lives: Arc<()>,
}

pub(super) fn lossless(capacity: usize) -> (LosslessPublisher, LosslessSubscriber) {
    let (sender, receiver) = crossbeam_channel::bounded(capacity);
    let lives = Arc::new(());
    (
        LosslessPublisher {
            sender,
            reader_lives: Arc::downgrade(&lives),
        },
        LosslessSubscriber {
            receiver,
            _lives: lives,
        },
    )
}

impl LosslessPublisher {
    pub(super) fn publish(&self, set: NumberedSet) -> PublishOutcome {
        match self.sender.send(Message::Set(set)) {
            Ok(()) => PublishOutcome::Delivered { n_readers: 1 },
            Err(SendError(_)) => PublishOutcome::Closed,
        }
    }

    pub(super) fn fail(&self, error: HandoverError) -> Result<(), HandoverError> {
        match self.sender.send(Message::Failed(error)) {
            Ok(()) | Err(SendError(Message::Set(_))) => Ok(()),
            Err(SendError(Message::Failed(error))) => Err(error),
        }
    }

    pub(super) fn count_readers(&self) -> usize {
        self.reader_lives.strong_count()
    }
}

impl Drop for LosslessPublisher {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // If the reader is gone too there is nobody left to tell.
            let _ = self.sender.send(Message::Failed(HandoverError::PublisherPanicked));
        }
    }
}

impl LosslessSubscriber {
    pub(super) fn receive(&mut self, timeout: Duration) -> Result<Arrival, HandoverError> {
        match self.receiver.recv_timeout(timeout) {
            Ok(Message::Set(set)) => Ok(Arrival::Set(set)),
            Ok(Message::Failed(error)) => Err(error),
            Err(RecvTimeoutError::Timeout) => Ok(Arrival::TimedOut),
            Err(RecvTimeoutError::Disconnected) => Ok(Arrival::Ended),
        }
    }
}

/// What both ends of the newest-wins transport see.
#[derive(Debug)]
struct Shared {
    /// The newest set that was not received yet.
    slot: ArrayQueue<NumberedSet>,
    /// Why the stream has ended, if not as it should.
    failure: ArrayQueue<HandoverError>,
}

#[derive(Debug)]
pub(super) struct NewestPublisher {
    shared: Arc<Shared>,
    /// Rung after every change of the slot; with room for one ring, which is enough to wake the reader.
    bell: Sender<()>,
}

#[derive(Debug)]
pub(super) struct NewestSubscriber {
    shared: Arc<Shared>,
    bell: Receiver<()>,
}

pub(super) fn newest() -> (NewestPublisher, NewestSubscriber) {
    let shared = Arc::new(Shared {
        slot: ArrayQueue::new(1),
        failure: ArrayQueue::new(1),
    });
    let (ring, bell) = crossbeam_channel::bounded(1);
    (
        NewestPublisher {
            shared: shared.clone(),
            bell: ring,
        },
        NewestSubscriber { shared, bell },
    )
}

impl NewestPublisher {
    pub(super) fn publish(&self, set: NumberedSet) -> PublishOutcome {
        // The set that is pushed out is missed; the reader sees the gap in the numbers.
        drop(self.shared.slot.force_push(set));
        match self.bell.try_send(()) {
            Ok(()) | Err(TrySendError::Full(())) => PublishOutcome::Delivered { n_readers: 1 },
            Err(TrySendError::Disconnected(())) => PublishOutcome::Closed,
        }
    }

    pub(super) fn fail(&self, error: HandoverError) -> Result<(), HandoverError> {
        if self.count_readers() == 0 {
            return Err(error);
        }
        self.shared.failure.push(error)
    }

    pub(super) fn count_readers(&self) -> usize {
        // The other end holds the only other share.
        Arc::strong_count(&self.shared) - 1
    }
}

impl Drop for NewestPublisher {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // An error that is there already came first and is the one to tell.
            let _ = self.shared.failure.push(HandoverError::PublisherPanicked);
        }
    }
}

impl NewestSubscriber {
    pub(super) fn receive(&mut self, timeout: Duration) -> Result<Arrival, HandoverError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(set) = self.shared.slot.pop() {
                return Ok(Arrival::Set(set));
            }
            match self.bell.recv_deadline(deadline) {
                Ok(()) => {}
                Err(RecvTimeoutError::Timeout) => return Ok(Arrival::TimedOut),
                Err(RecvTimeoutError::Disconnected) => return self.finish(),
            }
        }
    }

    /// The publisher is gone: what it left behind is the last set, then its error, then the end.
    fn finish(&self) -> Result<Arrival, HandoverError> {
        if let Some(set) = self.shared.slot.pop() {
            return Ok(Arrival::Set(set));
        }
        match self.shared.failure.pop() {
            Some(error) => Err(error),
            None => Ok(Arrival::Ended),
        }
    }
}
