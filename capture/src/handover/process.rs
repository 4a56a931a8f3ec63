//! The transport between processes, on iceoryx2.
//!
//! Pixels go through one *publish-subscribe* service (see [`pixels`](super::pixels)), frame sets, which say which pixels
//! belong together, through another (see [`packet`]), where every reader has a queue of one, in which the newest wins.
//! An *event* wakes readers that wait. Both sides open the service or create it, whoever comes first. Opening clears away what processes
//! that died have left behind, so either side may be killed and started again at any moment.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::port::listener::{Listener, ListenerCreateError, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::*;
use iceoryx2::service::ipc_threadsafe::Service as Ipc;
use iceoryx2::service::port_factory::publish_subscribe;

use super::packet::{self, PacketError};
use super::pixels::{BlockCache, BlockPool, BlockStore, LENT_BLOCKS};
use super::service::{OpenService, PATIENCE, PublishingRight, cannot_open, open_service, with_patience};
use super::unborn;
use super::{Arrival, HandoverError, NumberedSet, PublishOutcome, READERS_MAX};
use crate::frame::{Frame, FrameSet};

/// Longest sleep before looking at the queue again, should a wake-up get lost with the process that sent it.
const WAIT_SLICE: Duration = Duration::from_millis(50);

/// Frames whose copies are remembered: no more can wait for their partners.
const COPIED_MAX: usize = 16;

/// Tells frames apart.
#[derive(Debug, PartialEq)]
struct FrameKey {
    camera: Arc<str>,
    sequence: u64,
    timestamp_ns: u64,
}

pub(super) struct ProcessPublisher {
    service_name: String,
    block_bytes: usize,
    blocks: BlockStore,
    /// Where pixels that came from elsewhere were copied to, for frames that are in several sets.
    copied: VecDeque<(FrameKey, u64)>,
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
    blocks: BlockCache,
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
    /// Opens the service for frames of at most `block_bytes`.
    pub(super) fn open(service_name: &str, block_bytes: usize) -> Result<Self, HandoverError> {
        let service = open_service(service_name)?;
        let node = &service.node;
        let right = PublishingRight::take(&service.name)?;
        let blocks = open_block_store(service_name, &service, block_bytes)?;
        let create = || {
            let builder = service.sets.publisher_builder().max_loaned_samples(1);
            builder
                .initial_max_slice_len(packet::PACKET_MAX_BYTES)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        };
        let port = with_patience(PATIENCE, create, |_| clean_up(node))
            .map_err(|error| cannot_open(service_name, "the publisher", error))?;
        let notifier = with_patience(
            PATIENCE,
            || service.wakeups.notifier_builder().create(),
            |_| clean_up(node),
        )
        .map_err(|error| cannot_open(service_name, "the notifier", error))?;
        Ok(Self {
            service_name: service_name.to_owned(),
            block_bytes,
            blocks,
            copied: VecDeque::with_capacity(COPIED_MAX + 1),
            port,
            notifier,
            node: service.node,
            sets: service.sets,
            _right: right,
        })
    }

    /// A pool whose buffers readers see without a copy.
    pub(super) fn pool(&self, buffer_bytes: usize) -> Result<BlockPool, HandoverError> {
        self.check_fits(buffer_bytes)?;
        Ok(self.blocks.pool(buffer_bytes))
    }

    pub(super) fn publish(&mut self, numbered: &NumberedSet) -> Result<PublishOutcome, HandoverError> {
        let mut block_numbers = Vec::with_capacity(numbered.set.frames.len());
        for frame in &numbered.set.frames {
            block_numbers.push(self.block_number(frame)?);
        }
        let mut sample = self
            .port
            .loan_slice(packet::packet_bytes(numbered.set.frames.len()))
            .map_err(|error| self.cannot("borrow memory of", error))?;
        packet::encode(
            &numbered.set,
            numbered.number,
            self.blocks.publisher(),
            &block_numbers,
            sample.payload_mut(),
        )
        .map_err(|source| HandoverError::InvalidSet {
            service: self.service_name.clone(),
            source,
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

    /// The block a frame's pixels lie in; they are copied into one if they come from elsewhere.
    fn block_number(&mut self, frame: &Frame) -> Result<u64, HandoverError> {
        if let Some(place) = frame.pixels.place()
            && place.publisher == self.blocks.publisher()
        {
            return Ok(place.number);
        }
        let key = FrameKey {
            camera: frame.meta.camera.clone(),
            sequence: frame.meta.sequence,
            timestamp_ns: frame.meta.timestamp_ns,
        };
        if let Some((_, number)) = self.copied.iter().rev().find(|(copied, _)| *copied == key) {
            return Ok(*number);
        }
        self.check_fits(frame.pixels.len())?;
        let place = self
            .blocks
            .send_copy(&frame.pixels)
            .map_err(|source| HandoverError::Exchange {
                service: self.service_name.clone(),
                action: "send pixels on",
                source,
            })?;
        self.copied.push_back((key, place.number));
        if self.copied.len() > COPIED_MAX {
            self.copied.pop_front();
        }
        Ok(place.number)
    }

    fn check_fits(&self, frame_bytes: usize) -> Result<(), HandoverError> {
        if frame_bytes <= self.block_bytes {
            return Ok(());
        }
        Err(HandoverError::FrameTooLarge {
            service: self.service_name.clone(),
            frame_bytes,
            limit_bytes: self.block_bytes,
        })
    }

    /// Clears away dead readers and counts the rest.
    pub(super) fn count_readers(&self) -> usize {
        clean_up(&self.node);
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
            node,
            sets,
            blocks,
            wakeups,
            ..
        } = open_service(service_name)?;
        let too_many = || HandoverError::TooManyReaders {
            service: service_name.to_owned(),
            n_readers: READERS_MAX,
        };
        let cannot_subscribe = |what| {
            move |error| match error {
                SubscriberCreateError::ExceedsMaxSupportedSubscribers => too_many(),
                other => cannot_open(service_name, what, other),
            }
        };
        let listener =
            with_patience(PATIENCE, || wakeups.listener_builder().create(), |_| clean_up(&node)).map_err(|source| {
                match source {
                    ListenerCreateError::ExceedsMaxSupportedListeners => too_many(),
                    other => cannot_open(service_name, "the listener", other),
                }
            })?;
        // Before the sets, so that no set is seen whose pixels are not.
        let block_port = with_patience(PATIENCE, || blocks.subscriber_builder().create(), |_| clean_up(&node))
            .map_err(cannot_subscribe("the subscriber of pixels"))?;
        let port = with_patience(PATIENCE, || sets.subscriber_builder().create(), |_| clean_up(&node))
            .map_err(cannot_subscribe("the subscriber"))?;
        Ok(Self {
            service_name: service_name.to_owned(),
            port,
            blocks: BlockCache::new(block_port),
            listener,
            _node: node,
        })
    }

    pub(super) fn receive(&mut self, timeout: Duration) -> Result<Arrival, HandoverError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(numbered) = self.take_newest()? {
                return Ok(Arrival::Set(numbered));
            }
            let remaining = deadline.saturating_duration_since(Instant::now());
            if remaining.is_zero() {
                return Ok(Arrival::TimedOut);
            }
            self.wait(remaining.min(WAIT_SLICE))?;
        }
    }

    /// The newest set in the queue, if its pixels are still there; older ones, of a publisher that is gone, are let
    /// go.
    fn take_newest(&mut self) -> Result<Option<NumberedSet>, HandoverError> {
        let mut newest = None;
        while let Some(sample) = self
            .port
            .receive()
            .map_err(|error| self.cannot("receive from", error))?
        {
            newest = Some(sample);
        }
        let Some(sample) = newest else {
            return Ok(None);
        };
        self.blocks
            .fill()
            .map_err(|error| self.cannot("receive pixels from", error))?;
        let record = packet::decode(sample.payload()).map_err(|source| self.bad_packet(source))?;
        let publisher = sample.origin().value();
        let number = record.number;
        let set = self.assemble(&record)?;
        Ok(set.map(|set| NumberedSet { publisher, number, set }))
    }

    /// Puts pixels and records together; none if pixels are missing, because newer ones have pushed them out.
    fn assemble(&self, record: &packet::SetRecord) -> Result<Option<FrameSet>, HandoverError> {
        let mut frames = Vec::with_capacity(record.frames.len());
        for frame in &record.frames {
            let Some(pixels) = self.blocks.find(record.place_of(frame)) else {
                return Ok(None);
            };
            if pixels.len() != frame.pixel_bytes {
                return Err(self.bad_packet(PacketError::Pixels {
                    found_bytes: pixels.len(),
                    expected_bytes: frame.pixel_bytes,
                }));
            }
            frames.push(Frame {
                meta: frame.meta.clone(),
                size: frame.size,
                format: frame.format,
                pixels,
            });
        }
        Ok(Some(FrameSet { frames }))
    }

    fn bad_packet(&self, source: PacketError) -> HandoverError {
        HandoverError::BadPacket {
            service: self.service_name.clone(),
            source,
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

fn open_block_store(
    service_name: &str,
    service: &OpenService,
    block_bytes: usize,
) -> Result<BlockStore, HandoverError> {
    let own = with_patience(
        PATIENCE,
        || service.blocks.subscriber_builder().create(),
        |_| clean_up(&service.node),
    )
    .map_err(|error| cannot_open(service_name, "the publisher's own subscriber of pixels", error))?;
    let create = || {
        let builder = service.blocks.publisher_builder().max_loaned_samples(LENT_BLOCKS);
        builder
            .initial_max_slice_len(block_bytes)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
    };
    let port = with_patience(PATIENCE, create, |_| clean_up(&service.node))
        .map_err(|error| cannot_open(service_name, "the publisher of pixels", error))?;
    Ok(BlockStore::new(port, own))
}

/// Frees the places of ports whose processes have died.
fn clean_up(node: &Node<Ipc>) {
    unborn::while_removing(node.config(), || node.try_cleanup_dead_nodes());
}
