//! The transport between processes, on iceoryx2: one service with two patterns of the same name.
//!
//! Frame sets go through *publish-subscribe* with safe overflow: the publisher owns a segment of shared memory with a
//! fixed number of packets (see [`packet`]), every reader a queue of one, in which the newest wins. An *event* wakes
//! readers that wait. Both sides open the service or create it, whoever comes first. Opening clears away what processes
//! that died have left behind, so either side may be killed and started again at any moment.

use std::fmt;
use std::time::{Duration, Instant};

use iceoryx2::port::listener::{Listener, ListenerCreateError, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::ipc_threadsafe::Service as Ipc;
use iceoryx2::service::port_factory::publish_subscribe;

use super::packet;
use super::service::{OpenService, PATIENCE, PublishingRight, cannot_open, open_service, with_patience};
use super::{Arrival, HandoverError, NumberedSet, PublishOutcome, READERS_MAX};

/// Longest sleep before looking at the queue again, should a wake-up get lost with the process that sent it.
const WAIT_SLICE: Duration = Duration::from_millis(50);

pub(super) struct ProcessPublisher {
    service_name: String,
    limit_bytes: usize,
    node: Node<Ipc>,
    sets: publish_subscribe::PortFactory<Ipc, [u8], ()>,
    port: iceoryx2::port::publisher::Publisher<Ipc, [u8], ()>,
    notifier: Notifier<Ipc>,
    /// Given back last, when the port is closed.
    _right: PublishingRight,
}

pub(super) struct ProcessSubscriber {
    service_name: String,
    port: iceoryx2::port::subscriber::Subscriber<Ipc, [u8], ()>,
    listener: Listener<Ipc>,
    _node: Node<Ipc>,
}

impl fmt::Debug for ProcessPublisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ProcessPublisher")
            .field("service_name", &self.service_name)
            .finish_non_exhaustive()
    }
}

impl fmt::Debug for ProcessSubscriber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ProcessSubscriber")
            .field("service_name", &self.service_name)
            .finish_non_exhaustive()
    }
}

impl ProcessPublisher {
    /// Opens the service for sets whose packets are at most `limit_bytes` long.
    pub(super) fn open(service_name: &str, limit_bytes: usize) -> Result<Self, HandoverError> {
        let OpenService {
            name,
            node,
            sets,
            wakeups,
        } = open_service(service_name)?;
        let right = PublishingRight::take(&name)?;
        let create = || {
            let builder = sets
                .publisher_builder()
                .initial_max_slice_len(limit_bytes)
                .max_loaned_samples(1);
            builder
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        };
        let port = with_patience(PATIENCE, create, |_| clean_up(&node))
            .map_err(|error| cannot_open(service_name, "the publisher", error))?;
        let notifier = with_patience(PATIENCE, || wakeups.notifier_builder().create(), |_| clean_up(&node))
            .map_err(|error| cannot_open(service_name, "the notifier", error))?;
        Ok(Self {
            service_name: service_name.to_owned(),
            limit_bytes,
            node,
            sets,
            port,
            notifier,
            _right: right,
        })
    }

    pub(super) fn publish(&mut self, numbered: &NumberedSet) -> Result<PublishOutcome, HandoverError> {
        let set_bytes = packet::packet_bytes_of(&numbered.set);
        if set_bytes > self.limit_bytes {
            let (service, limit_bytes) = (self.service_name.clone(), self.limit_bytes);
            return Err(HandoverError::SetTooLarge {
                service,
                set_bytes,
                limit_bytes,
            });
        }
        let mut sample = self
            .port
            .loan_slice(set_bytes)
            .map_err(|error| self.cannot("borrow memory of", error))?;
        packet::encode(&numbered.set, numbered.number, sample.payload_mut()).map_err(|source| {
            HandoverError::InvalidSet {
                service: self.service_name.clone(),
                source,
            }
        })?;
        let n_readers = sample.send().map_err(|error| self.cannot("publish on", error))?;
        self.notifier
            .notify()
            .map_err(|error| self.cannot("wake the readers of", error))?;
        Ok(if n_readers == 0 {
            PublishOutcome::NoReader
        } else {
            PublishOutcome::Delivered { n_readers }
        })
    }

    /// Clears away dead readers and counts the rest.
    pub(super) fn count_readers(&self) -> usize {
        self.node.try_cleanup_dead_nodes();
        self.sets.dynamic_config().number_of_subscribers()
    }

    fn cannot(&self, action: &'static str, error: impl std::error::Error + Send + Sync + 'static) -> HandoverError {
        HandoverError::Exchange {
            service: self.service_name.clone(),
            action,
            source: Box::new(error),
        }
    }
}

impl ProcessSubscriber {
    pub(super) fn open(service_name: &str) -> Result<Self, HandoverError> {
        let OpenService {
            node, sets, wakeups, ..
        } = open_service(service_name)?;
        let too_many = || HandoverError::TooManyReaders {
            service: service_name.to_owned(),
            n_readers: READERS_MAX,
        };
        let listener =
            with_patience(PATIENCE, || wakeups.listener_builder().create(), |_| clean_up(&node)).map_err(|source| {
                match source {
                    ListenerCreateError::ExceedsMaxSupportedListeners => too_many(),
                    other => cannot_open(service_name, "the listener", other),
                }
            })?;
        let port =
            with_patience(PATIENCE, || sets.subscriber_builder().create(), |_| clean_up(&node)).map_err(|source| {
                match source {
                    SubscriberCreateError::ExceedsMaxSupportedSubscribers => too_many(),
                    other => cannot_open(service_name, "the subscriber", other),
                }
            })?;
        Ok(Self {
            service_name: service_name.to_owned(),
            port,
            listener,
            _node: node,
        })
    }

    pub(super) fn receive(&mut self, timeout: Duration) -> Result<Arrival, HandoverError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(sample) = self.take_newest()? {
                return self.decode(&sample).map(Arrival::Set);
            }
            let remaining = deadline.saturating_duration_since(Instant::now());
            if remaining.is_zero() {
                return Ok(Arrival::TimedOut);
            }
            self.wait(remaining.min(WAIT_SLICE))?;
        }
    }

    /// The newest set in the queue; older ones, of a publisher that is gone, are let go.
    fn take_newest(&self) -> Result<Option<Sample<Ipc, [u8], ()>>, HandoverError> {
        let mut newest = None;
        while let Some(sample) = self
            .port
            .receive()
            .map_err(|error| self.cannot("receive from", error))?
        {
            newest = Some(sample);
        }
        Ok(newest)
    }

    fn decode(&self, sample: &Sample<Ipc, [u8], ()>) -> Result<NumberedSet, HandoverError> {
        let publisher = sample.origin().value();
        match packet::decode(sample.payload()) {
            Ok((number, set)) => Ok(NumberedSet { publisher, number, set }),
            Err(source) => Err(HandoverError::BadPacket {
                service: self.service_name.clone(),
                source,
            }),
        }
    }

    fn wait(&self, timeout: Duration) -> Result<(), HandoverError> {
        match self.listener.timed_wait(|_| {}, timeout) {
            // A signal may be the wish to end: the caller looks after its timeout.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(error) => Err(self.cannot("wait on", error)),
        }
    }

    fn cannot(&self, action: &'static str, error: impl std::error::Error + Send + Sync + 'static) -> HandoverError {
        HandoverError::Exchange {
            service: self.service_name.clone(),
            action,
            source: Box::new(error),
        }
    }
}

/// Frees the places of ports whose processes have died.
fn clean_up(node: &Node<Ipc>) {
    node.try_cleanup_dead_nodes();
}
