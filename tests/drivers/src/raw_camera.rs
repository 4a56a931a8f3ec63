//! A small V4L2 reader: what the driver says, with nothing in between.
//!
//! It is the reference that the capture crate is tested beside, and shares no code with it. It copies every frame and
//! repairs nothing. Linux, `Documentation/userspace-api/media/v4l/`.
#![expect(
    unsafe_code,
    reason = "V4L2 is ioctls on structs with unions, and memory mapped from the driver"
)]

use std::ffi::c_void;
use std::fs::{File, OpenOptions};
use std::io;
use std::mem;
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::ptr;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use v4l::v4l_sys::{
    V4L2_CTRL_FLAG_NEXT_CTRL, v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE as VIDEO_CAPTURE, v4l2_buffer, v4l2_capability,
    v4l2_control, v4l2_format, v4l2_memory_V4L2_MEMORY_MMAP as MEMORY_MMAP, v4l2_queryctrl, v4l2_requestbuffers,
    v4l2_streamparm,
};
use v4l::v4l2;
use v4l::v4l2::vidioc;

/// `O_NONBLOCK` on Linux for x86-64 and aarch64: taking a buffer that is not there fails instead of waiting.
const O_NONBLOCK: i32 = 0o4000;
/// Read and write, shared: `PROT_READ | PROT_WRITE` and `MAP_SHARED`.
const READ_WRITE: i32 = 3;
const SHARED: i32 = 1;

/// V4L2's control of the exposure mode; 1 is manual, 3 aperture priority.
pub const EXPOSURE_MODE: u32 = 0x009A_0901;
/// V4L2's control of the exposure time, in units of 100 µs.
pub const EXPOSURE_TIME: u32 = 0x009A_0902;
/// V4L2's control of the brightness.
pub const BRIGHTNESS: u32 = 0x0098_0900;
/// V4L2's control of the automatic white balance.
pub const WHITE_BALANCE_AUTO: u32 = 0x0098_090C;
/// V4L2's control of the gain.
pub const GAIN: u32 = 0x0098_0913;
/// V4L2's control of the white balance, in kelvin.
pub const WHITE_BALANCE: u32 = 0x0098_091A;

/// A buffer as the driver returned it.
#[derive(Clone, Debug)]
pub struct RawFrame {
    /// The bytes that the driver says were used.
    pub bytes: Vec<u8>,
    /// The driver's count.
    pub sequence: u32,
    /// The driver's time stamp in ns.
    pub timestamp_ns: u64,
    /// The driver's flags, `V4L2_BUF_FLAG_*`.
    pub flags: u32,
}

impl RawFrame {
    /// Whether the driver flagged it as damaged (`V4L2_BUF_FLAG_ERROR`).
    pub fn is_damaged(&self) -> bool {
        self.flags & 0x40 != 0
    }
}

/// A control that a driver has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawControl {
    /// Its number.
    pub id: u32,
    /// Its name.
    pub name: String,
    /// Least value.
    pub minimum: i32,
    /// Greatest value.
    pub maximum: i32,
}

/// An open camera.
pub struct RawCamera {
    file: File,
    buffers: Vec<Mapping>,
}

impl RawCamera {
    /// Opens a device node.
    ///
    /// # Errors
    /// The system's.
    pub fn open(node: &Path) -> io::Result<Self> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(O_NONBLOCK)
            .open(node)?;
        Ok(Self {
            file,
            buffers: Vec::new(),
        })
    }

    /// The camera's name (`card`).
    ///
    /// # Errors
    /// The driver's.
    pub fn name(&self) -> io::Result<String> {
        let mut capability: v4l2_capability = zeroed();
        self.ioctl(vidioc::VIDIOC_QUERYCAP, &mut capability)?;
        Ok(text(&capability.card))
    }

    /// Asks for a size and a four-letter format; returns what the driver chose.
    ///
    /// # Errors
    /// The driver's.
    pub fn set_format(&self, size: (u32, u32), fourcc: [u8; 4]) -> io::Result<((u32, u32), [u8; 4])> {
        let mut format: v4l2_format = zeroed();
        format.type_ = VIDEO_CAPTURE;
        self.ioctl(vidioc::VIDIOC_G_FMT, &mut format)?;
        // SAFETY: `type_` is VIDEO_CAPTURE, so `pix` is the union's member in use; all its bytes are plain numbers.
        let pix = unsafe { &mut format.fmt.pix };
        (pix.width, pix.height) = size;
        pix.pixelformat = u32::from_le_bytes(fourcc);
        pix.bytesperline = 0;
        pix.sizeimage = 0;
        self.ioctl(vidioc::VIDIOC_S_FMT, &mut format)?;
        // SAFETY: as above; the driver does not change `type_`.
        let pix = unsafe { &format.fmt.pix };
        Ok(((pix.width, pix.height), pix.pixelformat.to_le_bytes()))
    }

    /// Asks for a frame rate; returns what the driver chose, as seconds per frame in a fraction.
    ///
    /// # Errors
    /// The driver's.
    pub fn set_rate(&self, rate_hz: u32) -> io::Result<(u32, u32)> {
        let mut parameters: v4l2_streamparm = zeroed();
        parameters.type_ = VIDEO_CAPTURE;
        // SAFETY: `type_` is VIDEO_CAPTURE, so `capture` is the union's member in use; all of it is plain numbers.
        let interval = unsafe { &mut parameters.parm.capture.timeperframe };
        (interval.numerator, interval.denominator) = (1, rate_hz);
        self.ioctl(vidioc::VIDIOC_S_PARM, &mut parameters)?;
        // SAFETY: as above; the driver does not change `type_`.
        let interval = unsafe { &parameters.parm.capture.timeperframe };
        Ok((interval.numerator, interval.denominator))
    }

    /// Maps buffers, hands them to the driver and starts the stream.
    ///
    /// # Errors
    /// The driver's.
    pub fn start(&mut self, n_buffers: u32) -> io::Result<()> {
        self.buffers.clear();
        self.request_buffers(n_buffers)?;
        for index in 0..n_buffers {
            let mut buffer = buffer(index);
            self.ioctl(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
            // SAFETY: the memory is MMAP, so `offset` is the union's member in use.
            let offset = unsafe { buffer.m.offset };
            self.buffers
                .push(Mapping::new(&self.file, buffer.length as usize, offset)?);
            self.queue(index)?;
        }
        let mut kind = VIDEO_CAPTURE;
        self.ioctl(vidioc::VIDIOC_STREAMON, &mut kind)
    }

    /// Waits for a frame; `None` when there is none in time.
    ///
    /// # Errors
    /// The driver's: `ENODEV` after an unplug, `EIO` after a fatal error.
    pub fn next_frame(&mut self, patience: Duration) -> io::Result<Option<RawFrame>> {
        let timeout = Timespec {
            tv_sec: patience.as_secs().cast_signed(),
            tv_nsec: patience.subsec_nanos().into(),
        };
        let mut files = [PollFd::from_borrowed_fd(self.file.as_fd(), PollFlags::IN)];
        poll(&mut files, Some(&timeout))?;
        if files[0].revents().is_empty() {
            return Ok(None);
        }
        let mut buffer = buffer(0);
        self.ioctl(vidioc::VIDIOC_DQBUF, &mut buffer)?;
        let mapping = self
            .buffers
            .get(buffer.index as usize)
            .ok_or(io::ErrorKind::InvalidData)?;
        let bytes = mapping.copy(buffer.bytesused as usize);
        self.queue(buffer.index)?;
        let seconds = buffer.timestamp.tv_sec.cast_unsigned();
        let timestamp_ns = seconds * 1_000_000_000 + buffer.timestamp.tv_usec.cast_unsigned() * 1000;
        Ok(Some(RawFrame {
            bytes,
            sequence: buffer.sequence,
            timestamp_ns,
            flags: buffer.flags,
        }))
    }

    /// Stops the stream and gives the buffers back.
    ///
    /// # Errors
    /// The driver's.
    pub fn stop(&mut self) -> io::Result<()> {
        let mut kind = VIDEO_CAPTURE;
        self.ioctl(vidioc::VIDIOC_STREAMOFF, &mut kind)?;
        self.buffers.clear();
        self.request_buffers(0)
    }

    /// The value of a control.
    ///
    /// # Errors
    /// The driver's.
    pub fn control(&self, id: u32) -> io::Result<i32> {
        let mut control = v4l2_control { id, value: 0 };
        self.ioctl(vidioc::VIDIOC_G_CTRL, &mut control)?;
        Ok(control.value)
    }

    /// Sets a control, or presses a button.
    ///
    /// # Errors
    /// The driver's.
    pub fn set_control(&self, id: u32, value: i32) -> io::Result<()> {
        self.ioctl(vidioc::VIDIOC_S_CTRL, &mut v4l2_control { id, value })
    }

    /// All controls that hold one number, and buttons.
    pub fn controls(&self) -> Vec<RawControl> {
        let mut found = Vec::new();
        let mut query: v4l2_queryctrl = zeroed();
        loop {
            query.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
            if self.ioctl(vidioc::VIDIOC_QUERYCTRL, &mut query).is_err() {
                return found;
            }
            let name = text(&query.name);
            found.push(RawControl {
                id: query.id,
                name,
                minimum: query.minimum,
                maximum: query.maximum,
            });
        }
    }

    fn request_buffers(&self, count: u32) -> io::Result<()> {
        let mut request: v4l2_requestbuffers = zeroed();
        request.count = count;
        request.type_ = VIDEO_CAPTURE;
        request.memory = MEMORY_MMAP;
        self.ioctl(vidioc::VIDIOC_REQBUFS, &mut request)?;
        if request.count < count {
            Err(io::ErrorKind::OutOfMemory.into())
        } else {
            Ok(())
        }
    }

    fn queue(&self, index: u32) -> io::Result<()> {
        self.ioctl(vidioc::VIDIOC_QBUF, &mut buffer(index))
    }

    fn ioctl<T>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        // SAFETY: every call in this file pairs a request with the struct that the request's number was made from
        // (the size is in the number), and the reference makes it valid for reading and writing during the call.
        unsafe { v4l2::ioctl(self.file.as_raw_fd(), request, ptr::from_mut(argument).cast()) }
    }
}

/// A driver's buffer in our memory.
struct Mapping {
    start: *mut c_void,
    length: usize,
}

// SAFETY: the pointer is to memory that this value alone owns, from mmap to munmap, and the kernel lets any thread of the
// process use it.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(file: &File, length: usize, offset: u32) -> io::Result<Self> {
        // SAFETY: a new mapping at an address of the kernel's choice touches no memory of ours.
        let start = unsafe {
            v4l2::mmap(
                ptr::null_mut(),
                length,
                READ_WRITE,
                SHARED,
                file.as_raw_fd(),
                i64::from(offset),
            )
        }?;
        Ok(Self { start, length })
    }

    /// The first bytes; at most as many as there are. The buffer is ours, not queued, as long as this takes.
    fn copy(&self, length: usize) -> Vec<u8> {
        // SAFETY: `start` is a mapping of `self.length` bytes that lives as long as `self`; the driver does not write
        // to a buffer between DQBUF and QBUF, and the caller copies in between.
        let bytes = unsafe { std::slice::from_raw_parts(self.start.cast::<u8>(), length.min(self.length)) };
        bytes.to_vec()
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping is ours, and no reference into it outlives `copy`.
        let unmapped = unsafe { v4l2::munmap(self.start, self.length) };
        // It cannot fail for a mapping that exists.
        debug_assert!(unmapped.is_ok());
    }
}

fn buffer(index: u32) -> v4l2_buffer {
    let mut buffer: v4l2_buffer = zeroed();
    buffer.index = index;
    buffer.type_ = VIDEO_CAPTURE;
    buffer.memory = MEMORY_MMAP;
    buffer
}

/// A V4L2 struct with all fields 0, as the kernel wants reserved fields.
fn zeroed<T: KernelStruct>() -> T {
    // SAFETY: `KernelStruct` is implemented for C structs of numbers, arrays and unions of these, and pointers.
    unsafe { mem::zeroed() }
}

/// C structs of V4L2 for which all bytes 0 are a valid value.
trait KernelStruct {}
impl KernelStruct for v4l2_capability {}
impl KernelStruct for v4l2_format {}
impl KernelStruct for v4l2_streamparm {}
impl KernelStruct for v4l2_requestbuffers {}
impl KernelStruct for v4l2_buffer {}
impl KernelStruct for v4l2_queryctrl {}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}
