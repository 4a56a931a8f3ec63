//! Pixels in shared memory: written once where they are taken, read where they lie, by every process.
//!
//! The publisher owns a segment of shared memory that is cut into equal blocks. A block is lent to whoever takes the
//! picture (a driver may write right into it), filled, given a running number and sent to all readers; frame sets then
//! only say which numbers belong together. Whoever reads holds a share of the block; it is free again with the last
//! share. Both sides bound what they hold; beyond the bound pixels are copied out, so that nobody who keeps frames can
//! bring the exchange to a halt.

use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{LoanError, ReceiveError};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::ipc_threadsafe::Service as Ipc;

use crate::frame::{Pixels, SharedPlace};
use crate::pool::{Lease, Pool};

/// Blocks that wait for each reader: enough that the frames of the newest set are among them.
pub(super) const QUEUED_BLOCKS: usize = 16;

/// Blocks a user may hold before new ones are copied out of shared memory.
const HELD_BLOCKS: usize = 16;

/// Blocks a reader holds at most: those it keeps for sets that name them, those of its user, and the one in its hand.
pub(super) const BORROWED_BLOCKS: usize = QUEUED_BLOCKS + HELD_BLOCKS + 2;

/// Blocks that are being written: the buffers of two cameras, and some more.
pub(super) const LENT_BLOCKS: usize = 72;

/// What stands before each block.
#[derive(Debug, Clone, Copy, Default, ZeroCopySend)]
#[repr(C)]
pub(super) struct BlockHeader {
    /// Running number of the block, from 1.
    number: u64,
    /// Bytes that belong to the picture; the block may be longer.
    n_bytes: u64,
}

pub(super) type BlockPublisher = Publisher<Ipc, [u8], BlockHeader>;
pub(super) type BlockSubscriber = Subscriber<Ipc, [u8], BlockHeader>;

/// The publisher's side. A clone is another handle on the same blocks.
#[derive(Clone)]
pub(super) struct BlockStore {
    shared: Arc<Mutex<Store>>,
    publisher: u128,
}

struct Store {
    port: BlockPublisher,
    /// Through this the publishing process reads what it has sent, as any other reader does.
    own: BlockIntake,
    last_number: u64,
}

impl fmt::Debug for BlockStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BlockStore")
            .field("publisher", &self.publisher)
            .finish_non_exhaustive()
    }
}

impl BlockStore {
    pub(super) fn new(port: BlockPublisher, own: BlockSubscriber) -> Self {
        let publisher = port.id().value();
        let store = Store {
            port,
            own: BlockIntake::new(own),
            last_number: 0,
        };
        Self {
            shared: Arc::new(Mutex::new(store)),
            publisher,
        }
    }

    /// Tells this publisher's blocks from others'.
    pub(super) fn publisher(&self) -> u128 {
        self.publisher
    }

    /// A pool whose leases are blocks of `buffer_bytes`.
    pub(super) fn pool(&self, buffer_bytes: usize) -> BlockPool {
        BlockPool {
            store: self.clone(),
            buffer_bytes,
        }
    }

    /// Copies pixels that lie elsewhere into a block and sends it.
    pub(super) fn send_copy(&self, pixels: &[u8]) -> Result<SharedPlace, Box<dyn std::error::Error + Send + Sync>> {
        let mut store = self.lock();
        let block = store.port.loan_slice_uninit(pixels.len())?.write_from_slice(pixels);
        let (place, _) = store.send(block, pixels.len())?;
        Ok(place)
    }

    /// Held for microseconds, once or twice per frame.
    fn lock(&self) -> MutexGuard<'_, Store> {
        // Whoever panicked while holding the lock was inside iceoryx2; its own state is sound, or its calls fail.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Store {
    /// Sends a block; also gives the share of it that stays here.
    fn send(
        &mut self,
        mut block: SampleMut<Ipc, [u8], BlockHeader>,
        n_bytes: usize,
    ) -> Result<(SharedPlace, Option<Block>), Box<dyn std::error::Error + Send + Sync>> {
        let number = self.last_number + 1;
        *block.user_header_mut() = BlockHeader {
            number,
            n_bytes: n_bytes as u64,
        };
        block.send()?;
        self.last_number = number;
        let mut own = None;
        while let Some(block) = self.own.take()? {
            own = Some(block);
        }
        let place = SharedPlace {
            publisher: self.port.id().value(),
            number,
        };
        Ok((place, own.filter(|block| block.place == place)))
    }
}

/// Leases are blocks of shared memory.
#[derive(Debug)]
pub(super) struct BlockPool {
    store: BlockStore,
    buffer_bytes: usize,
}

impl Pool for BlockPool {
    fn buffer_bytes(&self) -> usize {
        self.buffer_bytes
    }

    fn lease(&mut self) -> Option<Box<dyn Lease>> {
        let block = self.store.lock().port.loan_slice_uninit(self.buffer_bytes);
        let block = match block {
            Ok(block) => block,
            Err(
                LoanError::OutOfMemory
                | LoanError::ExceedsMaxLoans
                | LoanError::ExceedsMaxLoanSize
                | LoanError::InternalFailure,
            ) => return None,
        };
        #[expect(
            unsafe_code,
            reason = "zeroing megabytes that are about to be overwritten costs more than the copy"
        )]
        // SAFETY: the block lies in a mapping of shared memory, which the system hands out filled with zeros and in
        // which only bytes have been written since; every bit pattern is a valid `u8`.
        let block = unsafe { block.assume_init() };
        Some(Box::new(BlockLease {
            block,
            store: self.store.clone(),
        }))
    }
}

struct BlockLease {
    block: SampleMut<Ipc, [u8], BlockHeader>,
    store: BlockStore,
}

impl Lease for BlockLease {
    fn bytes_mut(&mut self) -> &mut [u8] {
        self.block.payload_mut()
    }

    fn freeze(self: Box<Self>, n_bytes: usize) -> Pixels {
        let Self { block, store } = *self;
        let n_bytes = n_bytes.min(block.payload().len());
        let mut guard = store.lock();
        // If too many blocks are in use here the frame lives on as a copy, for this process and for all others.
        if guard.own.is_full() {
            return block.payload()[..n_bytes].to_vec().into();
        }
        match guard.send(block, n_bytes) {
            Ok((_, Some(block))) => block.pixels,
            // Nothing is left of the picture: whoever publishes it is told by its length.
            Ok((_, None)) | Err(_) => Vec::new().into(),
        }
    }
}

/// The reader's side: the newest blocks, kept until a frame set names them.
pub(super) struct BlockCache {
    intake: BlockIntake,
    blocks: VecDeque<Block>,
}

struct Block {
    place: SharedPlace,
    pixels: Pixels,
}

impl BlockCache {
    pub(super) fn new(port: BlockSubscriber) -> Self {
        Self {
            intake: BlockIntake::new(port),
            blocks: VecDeque::with_capacity(QUEUED_BLOCKS + 1),
        }
    }

    /// Takes over all blocks that have come.
    pub(super) fn fill(&mut self) -> Result<(), ReceiveError> {
        while let Some(block) = self.intake.take()? {
            self.blocks.push_back(block);
            if self.blocks.len() > QUEUED_BLOCKS {
                self.blocks.pop_front();
            }
        }
        Ok(())
    }

    /// The pixels at `place`, if they have come and have not been pushed out by newer ones.
    pub(super) fn find(&self, place: SharedPlace) -> Option<Pixels> {
        let block = self.blocks.iter().rev().find(|block| block.place == place)?;
        Some(block.pixels.clone())
    }
}

/// Takes blocks out of a port and counts how many are in use.
struct BlockIntake {
    port: BlockSubscriber,
    in_use: Arc<AtomicUsize>,
}

impl BlockIntake {
    fn new(port: BlockSubscriber) -> Self {
        Self {
            port,
            in_use: Arc::default(),
        }
    }

    /// True if the next block would be copied. The count is only a bound: it guards no data, and falls by itself.
    fn is_full(&self) -> bool {
        self.in_use.load(Ordering::Relaxed) >= BORROWED_BLOCKS - 1
    }

    /// The next block that has come.
    fn take(&mut self) -> Result<Option<Block>, ReceiveError> {
        let is_full = self.is_full();
        let Some(sample) = self.port.receive()? else {
            return Ok(None);
        };
        let BlockHeader { number, n_bytes } = *sample.user_header();
        let place = SharedPlace {
            publisher: sample.origin().value(),
            number,
        };
        let n_bytes = usize::try_from(n_bytes)
            .unwrap_or(usize::MAX)
            .min(sample.payload().len());
        let pixels = if is_full {
            sample.payload()[..n_bytes].to_vec().into()
        } else {
            self.in_use.fetch_add(1, Ordering::Relaxed);
            let in_use = InUse(self.in_use.clone());
            Pixels::from_shared(
                BlockShare {
                    sample,
                    n_bytes,
                    _in_use: in_use,
                },
                place,
            )
        };
        Ok(Some(Block { place, pixels }))
    }
}

/// A share of a block.
struct BlockShare {
    sample: Sample<Ipc, [u8], BlockHeader>,
    n_bytes: usize,
    /// Dropped after the sample is given back.
    _in_use: InUse,
}

impl AsRef<[u8]> for BlockShare {
    fn as_ref(&self) -> &[u8] {
        &self.sample.payload()[..self.n_bytes]
    }
}

struct InUse(Arc<AtomicUsize>);

impl Drop for InUse {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}
