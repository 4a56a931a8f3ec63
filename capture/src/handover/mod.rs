//! Hand-over of frame sets from who makes them to who uses them: one contract, three transports.
//!
//! | transport | made by | for | when the reader is slow |
//! | --- | --- | --- | --- |
//! | [lossless] | [`lossless`] | recordings inside one process | the publisher waits; nothing is lost |
//! | [newest wins] | [`newest`] | cameras inside one process | the newest set replaces the unread one |
//! | [between processes] | [`publish_on`], [`subscribe_to`] | the daemon and the render node | the same |
//!
//! What every transport promises:
//! - sets arrive in the order in which they were published, each at most once;
//! - memory is bounded, whatever either side does;
//! - a set that was published but never reached the reader is counted in [`SubscriberStats::missed`];
//! - a publisher that wins by being newest never waits for a reader;
//! - inside one process the end of the stream, its errors and a panic of the publisher reach the reader, after every
//!   set that was published before; between processes either side may die and come back, and the other waits for it.
//!
//! Inside one process sets travel by reference. Between processes the pixels lie in shared memory: sources that write
//! into a [`Publisher::pool`] put them there themselves, all others are copied there once, and readers read them where
//! they are. A reader that keeps many frames gets copies of the next ones, so that it never holds up the exchange.
//!
//! [lossless]: lossless
//! [newest wins]: newest
//! [between processes]: publish_on

use std::time::Duration;

use crate::frame::FrameSet;
use crate::pool::{HeapPool, Pool};
use crate::source::CameraDescription;

mod error;
mod format_code;
pub mod packet;
mod pixels;
mod process;
mod service;
mod thread;
mod unborn;

pub use error::HandoverError;

/// Service that the daemon publishes on where nothing else is asked for.
pub const DEFAULT_SERVICE: &str = "mirrorball/frames";

/// Readers one service may have at a time.
pub const READERS_MAX: usize = 4;

/// Longest wait in one call, so that every deadline can be computed.
const TIMEOUT_MAX: Duration = Duration::from_secs(365 * 24 * 3600);

/// The sending end. Dropping it ends the stream.
#[derive(Debug)]
pub struct Publisher {
    transport: PublisherTransport,
    stats: PublisherStats,
}

#[derive(Debug)]
enum PublisherTransport {
    Lossless(thread::LosslessPublisher),
    Newest(thread::NewestPublisher),
    Process(Box<process::ProcessPublisher>),
}

/// The receiving end.
#[derive(Debug)]
pub struct Subscriber {
    transport: SubscriberTransport,
    stats: SubscriberStats,
    /// Publisher and number of the set received last.
    last: Option<(PublisherId, u64)>,
}

#[derive(Debug)]
enum SubscriberTransport {
    Lossless(thread::LosslessSubscriber),
    Newest(thread::NewestSubscriber),
    Process(Box<process::ProcessSubscriber>),
}

/// Tells publishers apart; inside one process there is only one.
type PublisherId = u128;

/// A set on its way, with the running number its publisher gave it.
#[derive(Debug)]
struct NumberedSet {
    publisher: PublisherId,
    number: u64,
    set: FrameSet,
}

/// What a transport found when asked for a set.
#[derive(Debug)]
enum Arrival {
    Set(NumberedSet),
    TimedOut,
    Ended,
}

/// Where a published set went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PublishOutcome {
    /// To this many readers.
    Delivered {
        /// Number of readers.
        n_readers: usize,
    },
    /// To nobody; a reader may come later.
    NoReader,
    /// To nobody; the only reader has been dropped and none can come.
    Closed,
}

/// What [`Subscriber::receive`] found.
#[derive(Debug, Clone)]
pub enum Received {
    /// The next set, or the newest one.
    Set(FrameSet),
    /// No set within the timeout; between processes perhaps because there is no publisher.
    TimedOut,
    /// There will be no more sets. Only inside one process; every later call says so again.
    Ended,
}

/// What a publisher has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PublisherStats {
    /// Sets published, whether there was a reader or not.
    pub published: u64,
    /// Of these, sets that went to nobody.
    pub unread: u64,
}

/// What a subscriber has seen so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SubscriberStats {
    /// Sets received.
    pub received: u64,
    /// Sets the publisher replaced by newer ones before they were received. Between processes they are counted from the
    /// first set received on, anew for each publisher.
    pub missed: u64,
    /// How often another publisher has taken over: the daemon was restarted, and its clock and counts may have been
    /// too.
    pub publisher_changes: u64,
}

/// Makes the lossless transport inside one process, with room for `capacity` sets (at least one).
///
/// The publisher waits while there is no room; it never drops a set.
#[must_use]
pub fn lossless(capacity: usize) -> (Publisher, Subscriber) {
    let (publisher, subscriber) = thread::lossless(capacity.max(1));
    (
        Publisher::new(PublisherTransport::Lossless(publisher)),
        Subscriber::new(SubscriberTransport::Lossless(subscriber), Some((0, 0))),
    )
}

/// Makes the newest-wins transport inside one process, with room for one set.
///
/// The publisher never waits; a set that has not been received is replaced and counted as missed.
#[must_use]
pub fn newest() -> (Publisher, Subscriber) {
    let (publisher, subscriber) = thread::newest();
    (
        Publisher::new(PublisherTransport::Newest(publisher)),
        Subscriber::new(SubscriberTransport::Newest(subscriber), Some((0, 0))),
    )
}

/// Opens the sending end between processes, with room for frames of `cameras`.
///
/// Readers may be there already or come later. What dead processes have left behind is cleared away first.
///
/// # Errors
///
/// [`HandoverError`] if the name is not allowed, shared memory cannot be had, or another process publishes there.
pub fn publish_on(service: &str, cameras: &[CameraDescription]) -> Result<Publisher, HandoverError> {
    let frame_bytes = |camera: &CameraDescription| camera.format.max_bytes(camera.size);
    let block_bytes = cameras.iter().map(frame_bytes).max().unwrap_or(1);
    let publisher = process::ProcessPublisher::open(service, block_bytes)?;
    Ok(Publisher::new(PublisherTransport::Process(Box::new(publisher))))
}

/// Opens the receiving end between processes.
///
/// There need not be a publisher: receiving times out until one comes.
///
/// # Errors
///
/// [`HandoverError`] if the name is not allowed, shared memory cannot be had, or there are too many readers.
pub fn subscribe_to(service: &str) -> Result<Subscriber, HandoverError> {
    let subscriber = process::ProcessSubscriber::open(service)?;
    Ok(Subscriber::new(
        SubscriberTransport::Process(Box::new(subscriber)),
        None,
    ))
}

impl Publisher {
    fn new(transport: PublisherTransport) -> Self {
        Self {
            transport,
            stats: PublisherStats::default(),
        }
    }

    /// Hands a set over. Waits for room if the transport is lossless, else never.
    ///
    /// # Errors
    ///
    /// [`HandoverError`], only between processes, if the set is invalid or shared memory fails.
    pub fn publish(&mut self, set: FrameSet) -> Result<PublishOutcome, HandoverError> {
        let number = self.stats.published + 1;
        let numbered = NumberedSet {
            publisher: 0,
            number,
            set,
        };
        let outcome = match &mut self.transport {
            PublisherTransport::Lossless(publisher) => publisher.publish(numbered),
            PublisherTransport::Newest(publisher) => publisher.publish(numbered),
            PublisherTransport::Process(publisher) => publisher.publish(&numbered)?,
        };
        self.stats.published = number;
        match outcome {
            PublishOutcome::Delivered { .. } => {}
            PublishOutcome::NoReader | PublishOutcome::Closed => self.stats.unread += 1,
        }
        Ok(outcome)
    }

    /// A pool for a source to write frames into: in shared memory where readers in other processes see them without a
    /// copy, else `n_buffers` on the heap. Buffers are `buffer_bytes` long.
    ///
    /// # Errors
    ///
    /// [`HandoverError::FrameTooLarge`] if the publisher was opened for smaller frames.
    pub fn pool(&self, n_buffers: usize, buffer_bytes: usize) -> Result<Box<dyn Pool>, HandoverError> {
        match &self.transport {
            PublisherTransport::Lossless(_) | PublisherTransport::Newest(_) => {
                Ok(Box::new(HeapPool::new(n_buffers, buffer_bytes)))
            }
            PublisherTransport::Process(publisher) => Ok(Box::new(publisher.pool(buffer_bytes)?)),
        }
    }

    /// Ends the stream with an error, which reaches the reader after all sets before it.
    ///
    /// Between processes there is nobody to take an error: there it is given back.
    ///
    /// # Errors
    ///
    /// The error itself, if the transport cannot carry it or the reader is gone.
    pub fn fail(self, error: HandoverError) -> Result<(), HandoverError> {
        match self.transport {
            PublisherTransport::Lossless(publisher) => publisher.fail(error),
            PublisherTransport::Newest(publisher) => publisher.fail(error),
            PublisherTransport::Process(_) => Err(error),
        }
    }

    /// Counts the readers. Between processes this clears away dead ones first and reads the file system: for once a
    /// second, not for every frame.
    #[must_use]
    pub fn count_readers(&self) -> usize {
        match &self.transport {
            PublisherTransport::Lossless(publisher) => publisher.count_readers(),
            PublisherTransport::Newest(publisher) => publisher.count_readers(),
            PublisherTransport::Process(publisher) => publisher.count_readers(),
        }
    }

    /// What was published so far.
    #[must_use]
    pub fn stats(&self) -> PublisherStats {
        self.stats
    }
}

impl Subscriber {
    fn new(transport: SubscriberTransport, last: Option<(PublisherId, u64)>) -> Self {
        Self {
            transport,
            stats: SubscriberStats::default(),
            last,
        }
    }

    /// Waits up to `timeout` (a year at most) for the next set, or for the newest one where the newest wins.
    ///
    /// # Errors
    ///
    /// After an error for which [`HandoverError::is_skippable`] is true receiving can go on.
    pub fn receive(&mut self, timeout: Duration) -> Result<Received, HandoverError> {
        let timeout = timeout.min(TIMEOUT_MAX);
        let arrival = match &mut self.transport {
            SubscriberTransport::Lossless(subscriber) => subscriber.receive(timeout)?,
            SubscriberTransport::Newest(subscriber) => subscriber.receive(timeout)?,
            SubscriberTransport::Process(subscriber) => subscriber.receive(timeout)?,
        };
        match arrival {
            Arrival::Set(numbered) => Ok(Received::Set(self.count(numbered))),
            Arrival::TimedOut => Ok(Received::TimedOut),
            Arrival::Ended => Ok(Received::Ended),
        }
    }

    /// What was received so far.
    #[must_use]
    pub fn stats(&self) -> SubscriberStats {
        self.stats
    }

    fn count(&mut self, numbered: NumberedSet) -> FrameSet {
        self.stats.received += 1;
        match self.last {
            Some((publisher, number)) if publisher == numbered.publisher => {
                self.stats.missed += numbered.number.saturating_sub(number).saturating_sub(1);
            }
            Some(_) => self.stats.publisher_changes += 1,
            None => {}
        }
        self.last = Some((numbered.publisher, numbered.number));
        numbered.set
    }
}
