//! The memory that a driver writes pictures into, either its own or lent to it from a pool.
//!
//! The one invariant: memory is with the driver or with us, never both. [`Buffers`] keeps the books.

use std::io;
use std::sync::Arc;

use super::ioctl::{Dequeued, Memory, Node};
use crate::pool::{Lease, Pool};

/// A fixed number of buffers, each either with the driver or with us.
pub(super) struct Buffers {
    node: Arc<Node>,
    slots: Vec<Slot>,
    memory: Memory,
}

struct Slot {
    is_queued: bool,
    place: Place,
}

enum Place {
    Mapped(Mapping),
    Lent(Box<dyn Lease>),
}

/// Memory of the driver, mapped into this process.
struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: the mapping belongs to whoever owns this value; the kernel does not care which thread uses it.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: made by `Node::map` with this length, unmapped here only. A driver that still writes to the buffer
        // writes to its own memory. The call fails only for wrong arguments, and there is nobody to tell.
        let _ = unsafe { v4l::v4l2::munmap(self.start.cast(), self.length) };
    }
}

impl Buffers {
    /// Makes `n_buffers` of the driver's own, or as many as it likes.
    pub(super) fn mapped(node: Arc<Node>, n_buffers: u32) -> io::Result<Self> {
        let n_buffers = node.request_buffers(Memory::Mmap, n_buffers)?;
        let mut buffers = Self {
            node,
            slots: Vec::new(),
            memory: Memory::Mmap,
        };
        for index in 0..n_buffers {
            let (offset, length) = buffers.node.buffer_place(index)?;
            let length = length as usize;
            let start = buffers.node.map(offset, length)?;
            buffers.slots.push(Slot {
                is_queued: false,
                place: Place::Mapped(Mapping { start, length }),
            });
        }
        Ok(buffers)
    }

    /// Takes up to `n_buffers` from the pool and tells the driver that there will be as many.
    pub(super) fn lent(node: Arc<Node>, pool: &mut dyn Pool, n_buffers: u32) -> io::Result<Self> {
        let leases: Vec<_> = std::iter::from_fn(|| pool.lease()).take(n_buffers as usize).collect();
        let n_leases = u32::try_from(leases.len()).unwrap_or(u32::MAX);
        let n_granted = node.request_buffers(Memory::UserPtr, n_leases)? as usize;
        let slot = |lease| Slot {
            is_queued: false,
            place: Place::Lent(lease),
        };
        let slots = leases.into_iter().take(n_granted).map(slot).collect();
        Ok(Self {
            node,
            slots,
            memory: Memory::UserPtr,
        })
    }

    /// Number of buffers.
    pub(super) fn len(&self) -> usize {
        self.slots.len()
    }

    /// Where they lie.
    pub(super) fn memory(&self) -> Memory {
        self.memory
    }

    /// Lends all buffers to the driver that it has not; says how many it has now, and why it took one not.
    pub(super) fn queue_all(&mut self) -> (usize, Option<io::Error>) {
        let mut n_queued = 0;
        let mut refusal = None;
        for index in 0..self.slots.len() {
            match self.queue(index) {
                Ok(()) => n_queued += 1,
                Err(error) => refusal = Some(error),
            }
        }
        (n_queued, refusal)
    }

    /// Lends a buffer to the driver, if it has it not already.
    pub(super) fn queue(&mut self, index: usize) -> io::Result<()> {
        let slot = &mut self.slots[index];
        if slot.is_queued {
            return Ok(());
        }
        let number = u32::try_from(index).expect("drivers have 64 buffers at most");
        match &mut slot.place {
            // SAFETY: `is_queued` keeps `pixels` from touching the mapping until `dequeue` or `stop`.
            Place::Mapped(_) => unsafe { self.node.queue_mapped(number)? },
            Place::Lent(lease) => {
                let memory = lease.bytes_mut();
                let length = u32::try_from(memory.len()).map_err(|_| io::ErrorKind::InvalidInput)?;
                // SAFETY: a lease's memory is exclusive and stays where it is while the lease lives. `is_queued` keeps
                // it in this slot, untouched, until `dequeue` or `stop`; `drop` hands it to the node otherwise.
                unsafe { self.node.queue_user(number, memory.as_mut_ptr(), length)? };
            }
        }
        slot.is_queued = true;
        Ok(())
    }

    /// Takes back the next buffer that the driver is done with; its index in [`Dequeued`] is one of ours.
    pub(super) fn dequeue(&mut self) -> io::Result<Dequeued> {
        let dequeued = self.node.dequeue(self.memory)?;
        let slot = self
            .slots
            .get_mut(dequeued.index as usize)
            .ok_or(io::ErrorKind::InvalidData)?;
        slot.is_queued = false;
        Ok(dequeued)
    }

    /// The whole memory of a mapped buffer; none while the driver has it and none of lent buffers.
    pub(super) fn pixels(&self, index: usize) -> Option<&[u8]> {
        let slot = &self.slots[index];
        match &slot.place {
            Place::Mapped(mapping) if !slot.is_queued => {
                // SAFETY: the mapping is `length` long and lives as long as `self`; the driver does not write to it,
                // as queueing needs `&mut self`.
                Some(unsafe { std::slice::from_raw_parts(mapping.start, mapping.length) })
            }
            Place::Mapped(_) | Place::Lent(_) => None,
        }
    }

    /// Puts another lease in the place of one that came back, and gives that one away; none while the driver has it
    /// and none of mapped buffers.
    pub(super) fn exchange(&mut self, index: usize, lease: Box<dyn Lease>) -> Option<Box<dyn Lease>> {
        let slot = &mut self.slots[index];
        match &mut slot.place {
            Place::Lent(old) if !slot.is_queued => Some(std::mem::replace(old, lease)),
            Place::Lent(_) | Place::Mapped(_) => None,
        }
    }

    /// Stops the stream, after which all buffers are ours.
    pub(super) fn stop(&mut self) -> io::Result<()> {
        self.node.stream_off()?;
        for slot in &mut self.slots {
            slot.is_queued = false;
        }
        Ok(())
    }
}

impl Drop for Buffers {
    fn drop(&mut self) {
        let has_stopped = self.stop().is_ok();
        let slots = std::mem::take(&mut self.slots);
        if !has_stopped {
            // Unplugged, or a driver in trouble: nobody knows whether it still writes, so its memory must stay.
            let leases = slots.into_iter().filter_map(|slot| match slot.place {
                Place::Lent(lease) if slot.is_queued => Some(lease),
                Place::Lent(_) | Place::Mapped(_) => None,
            });
            self.node.keep_until_closed(leases);
            return;
        }
        // Unmapped before they are freed; the driver lets go of lent memory before the leases are dropped.
        let leases: Vec<_> = slots
            .into_iter()
            .filter(|slot| matches!(slot.place, Place::Lent(_)))
            .collect();
        // A failure leaves the buffers to the closing of the node, which cannot fail.
        let _ = self.node.request_buffers(self.memory, 0);
        drop(leases);
    }
}
