//! Buffers and the stream.

use std::io;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::time::{ClockId, clock_gettime};
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

use super::{CAPTURE, Node, Plain};

/// Longest wait at once: a day. Beyond that deadlines overflow.
const LONGEST_WAIT: Duration = Duration::from_secs(86_400);

/// What [`Node::poll`] found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::v4l2) struct Ready {
    /// A buffer can be dequeued.
    pub(in crate::v4l2) has_buffer: bool,
    /// An event can be dequeued.
    pub(in crate::v4l2) has_event: bool,
    /// The stream is broken or the device is gone; the next call says which.
    pub(in crate::v4l2) has_failed: bool,
}

/// Where buffers lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::v4l2) enum Memory {
    /// In the driver, to be mapped.
    Mmap,
    /// In this process.
    UserPtr,
}

impl Memory {
    fn code(self) -> u32 {
        match self {
            Self::Mmap => sys::v4l2_memory_V4L2_MEMORY_MMAP,
            Self::UserPtr => sys::v4l2_memory_V4L2_MEMORY_USERPTR,
        }
    }
}

/// A buffer that the driver gave back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::v4l2) struct Dequeued {
    pub(in crate::v4l2) index: u32,
    pub(in crate::v4l2) bytes_used: u32,
    pub(in crate::v4l2) flags: u32,
    pub(in crate::v4l2) sequence: u32,
    pub(in crate::v4l2) timestamp_ns: u64,
}

impl Node {
    /// Waits for a buffer, an event or a failure, a day at most. Finds nothing when the timeout is over.
    pub(in crate::v4l2) fn poll(&self, timeout: Duration) -> io::Result<Ready> {
        let deadline = Instant::now() + timeout.min(LONGEST_WAIT);
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let timeout = Timespec::try_from(left).expect("a day is short enough");
            let mut polled = [PollFd::from_borrowed_fd(
                self.descriptor(),
                PollFlags::IN | PollFlags::PRI,
            )];
            match poll(&mut polled, Some(&timeout)) {
                Err(Errno::INTR) => continue,
                Err(error) => return Err(error.into()),
                Ok(_) => {}
            }
            let found = polled[0].revents();
            return Ok(Ready {
                has_buffer: found.contains(PollFlags::IN),
                has_event: found.contains(PollFlags::PRI),
                has_failed: found.intersects(PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL),
            });
        }
    }

    /// Makes `count` buffers, or frees all for 0; says how many there are now.
    pub(in crate::v4l2) fn request_buffers(&self, memory: Memory, count: u32) -> io::Result<u32> {
        let mut buffers = sys::v4l2_requestbuffers {
            count,
            type_: CAPTURE,
            memory: memory.code(),
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers. Memory that is mapped stays until it is unmapped.
        unsafe { self.call(vidioc::VIDIOC_REQBUFS, &mut buffers)? };
        Ok(buffers.count)
    }

    /// Offset and length of a mappable buffer.
    pub(in crate::v4l2) fn buffer_place(&self, index: u32) -> io::Result<(u32, u32)> {
        let mut buffer = sys::v4l2_buffer {
            index,
            type_: CAPTURE,
            memory: Memory::Mmap.code(),
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers for single-plane buffers.
        unsafe { self.call(vidioc::VIDIOC_QUERYBUF, &mut buffer)? };
        // SAFETY: for mapped memory the union holds the offset; any bytes are a valid integer.
        Ok((unsafe { buffer.m.offset }, buffer.length))
    }

    /// Maps a buffer of the driver into this process.
    pub(in crate::v4l2) fn map(&self, offset: u32, length: usize) -> io::Result<*mut u8> {
        // SAFETY: a new mapping at an address that the kernel chooses; it overlaps nothing.
        let start = unsafe {
            v4l::v4l2::mmap(
                std::ptr::null_mut(),
                length,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                self.device.handle().fd(),
                offset.into(),
            )?
        };
        Ok(start.cast())
    }

    /// Lends a mapped buffer to the driver.
    ///
    /// # Safety
    ///
    /// Nothing reads or writes the buffer's memory before it is dequeued or the stream is off.
    pub(in crate::v4l2) unsafe fn queue_mapped(&self, index: u32) -> io::Result<()> {
        let mut buffer = sys::v4l2_buffer {
            index,
            type_: CAPTURE,
            memory: Memory::Mmap.code(),
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure; what the driver writes to is ours to lend by our own contract.
        unsafe { self.call(vidioc::VIDIOC_QBUF, &mut buffer) }
    }

    /// Lends memory of this process to the driver.
    ///
    /// # Safety
    ///
    /// `length` bytes from `start` may be written to, and neither move nor are touched nor freed before the buffer is
    /// dequeued, the stream is off or the node is closed.
    pub(in crate::v4l2) unsafe fn queue_user(&self, index: u32, start: *mut u8, length: u32) -> io::Result<()> {
        let mut buffer = sys::v4l2_buffer {
            index,
            type_: CAPTURE,
            memory: Memory::UserPtr.code(),
            ..Plain::zeroed()
        };
        buffer.m.userptr = start.expose_provenance() as std::ffi::c_ulong;
        buffer.length = length;
        // SAFETY: the request's own structure; what the driver writes to is ours to lend by our own contract.
        unsafe { self.call(vidioc::VIDIOC_QBUF, &mut buffer) }
    }

    /// Takes a buffer back that the driver is done with.
    pub(in crate::v4l2) fn dequeue(&self, memory: Memory) -> io::Result<Dequeued> {
        let mut buffer = sys::v4l2_buffer {
            type_: CAPTURE,
            memory: memory.code(),
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure; nothing is written to but it.
        unsafe { self.call(vidioc::VIDIOC_DQBUF, &mut buffer)? };
        let seconds = u64::try_from(buffer.timestamp.tv_sec).unwrap_or(0);
        let micros = u64::try_from(buffer.timestamp.tv_usec).unwrap_or(0);
        Ok(Dequeued {
            index: buffer.index,
            bytes_used: buffer.bytesused,
            flags: buffer.flags,
            sequence: buffer.sequence,
            timestamp_ns: seconds
                .saturating_mul(1_000_000_000)
                .saturating_add(micros.saturating_mul(1000)),
        })
    }

    /// Starts the stream.
    pub(in crate::v4l2) fn stream_on(&self) -> io::Result<()> {
        let mut kind = CAPTURE.cast_signed();
        // SAFETY: the request's own argument, an integer.
        unsafe { self.call(vidioc::VIDIOC_STREAMON, &mut kind) }
    }

    /// Stops the stream; when it succeeds, the driver has no buffer any more.
    pub(in crate::v4l2) fn stream_off(&self) -> io::Result<()> {
        let mut kind = CAPTURE.cast_signed();
        // SAFETY: the request's own argument, an integer.
        unsafe { self.call(vidioc::VIDIOC_STREAMOFF, &mut kind) }
    }
}

/// Nanoseconds since boot on the clock of the drivers' stamps.
pub(crate) fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}
