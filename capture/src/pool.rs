//! Buffers that frames are written into: a fixed number, made at the start, given back when the last user lets go.

use std::sync::Arc;

use crossbeam_queue::ArrayQueue;

use crate::frame::Pixels;

/// A stock of equal buffers.
pub trait Pool: Send {
    /// Length of every buffer in bytes.
    fn buffer_bytes(&self) -> usize;

    /// A buffer to write into; none while all are in use. Never waits.
    fn lease(&mut self) -> Option<Box<dyn Lease>>;
}

/// A buffer on loan: nobody else reads or writes it. Dropped, it goes back to its pool.
///
/// Its memory stays where it is for as long as the lease lives, so a driver may write into it.
pub trait Lease: Send {
    /// The whole buffer, [`Pool::buffer_bytes`] long; what it holds at first is not defined.
    fn bytes_mut(&mut self) -> &mut [u8];

    /// Ends writing: the first `n_bytes` become the pixels of a frame, `n_bytes` at most the length of the buffer.
    ///
    /// Empty if the picture was lost on the way; no format admits that.
    fn freeze(self: Box<Self>, n_bytes: usize) -> Pixels;
}

/// A pool in this process's own memory.
#[derive(Debug)]
pub struct HeapPool {
    free: Arc<ArrayQueue<Box<[u8]>>>,
    buffer_bytes: usize,
}

impl HeapPool {
    /// Makes `n_buffers` (at least one) of `buffer_bytes` each.
    #[must_use]
    pub fn new(n_buffers: usize, buffer_bytes: usize) -> Self {
        let n_buffers = n_buffers.max(1);
        let free = ArrayQueue::new(n_buffers);
        for _ in 0..n_buffers {
            free.force_push(vec![0; buffer_bytes].into_boxed_slice());
        }
        Self {
            free: Arc::new(free),
            buffer_bytes,
        }
    }
}

impl Pool for HeapPool {
    fn buffer_bytes(&self) -> usize {
        self.buffer_bytes
    }

    fn lease(&mut self) -> Option<Box<dyn Lease>> {
        let buffer = self.free.pop()?;
        Some(Box::new(HeapLease {
            buffer,
            n_bytes: self.buffer_bytes,
            home: self.free.clone(),
        }))
    }
}

/// A buffer with its way home.
#[derive(Debug)]
struct HeapLease {
    buffer: Box<[u8]>,
    n_bytes: usize,
    home: Arc<ArrayQueue<Box<[u8]>>>,
}

impl Lease for HeapLease {
    fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.buffer
    }

    fn freeze(mut self: Box<Self>, n_bytes: usize) -> Pixels {
        self.n_bytes = n_bytes.min(self.buffer.len());
        Pixels::from_owner(*self)
    }
}

impl AsRef<[u8]> for HeapLease {
    fn as_ref(&self) -> &[u8] {
        &self.buffer[..self.n_bytes]
    }
}

impl Drop for HeapLease {
    fn drop(&mut self) {
        // The queue has room for every buffer there is.
        self.home.force_push(std::mem::take(&mut self.buffer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_come_back_with_the_last_clone() {
        let mut pool = HeapPool::new(2, 4);
        let mut lease = pool.lease().unwrap();
        lease.bytes_mut().copy_from_slice(&[1, 2, 3, 4]);
        let pixels = lease.freeze(3);
        assert_eq!(*pixels, [1, 2, 3]);
        let other = pool.lease().unwrap();
        assert!(pool.lease().is_none());
        let clone = pixels.clone();
        drop(pixels);
        assert!(pool.lease().is_none());
        drop(clone);
        drop(other);
        assert_eq!((0..2).filter_map(|_| pool.lease()).count(), 2);
    }

    #[test]
    fn pixels_outlive_their_pool() {
        let mut pool = HeapPool::new(1, 1);
        let pixels = pool.lease().unwrap().freeze(1);
        drop(pool);
        assert_eq!(pixels.len(), 1);
    }
}
