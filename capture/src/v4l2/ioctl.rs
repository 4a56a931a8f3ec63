//! Calls into the kernel's video interface, each behind a function that is safe to call; only queueing buffers is not.
//!
//! Written out here instead of taken from the crate `v4l`: its conversions panic on text that is no UTF-8, on unknown
//! kinds of control and on unknown colour spaces, its poll hides what it found, and it knows no events.
//! Reference: Linux Media Userspace API, part I "Video for Linux API".

use std::ffi::{CString, c_char, c_void};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

use crate::frame::Size;
use crate::pool::Lease;

/// Buffers of a video capture device with one plane, the only kind that is used here.
const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;

/// `VIDIOC_DQEVENT`: `_IOR('V', 89, struct v4l2_event)`; the crate has no constant.
const DEQUEUE_EVENT: u64 = request_code(2, 89, size_of::<sys::v4l2_event>());
/// `VIDIOC_SUBSCRIBE_EVENT`: `_IOW('V', 90, struct v4l2_event_subscription)`.
const SUBSCRIBE_EVENT: u64 = request_code(1, 90, size_of::<sys::v4l2_event_subscription>());
/// `VIDIOC_UNSUBSCRIBE_EVENT`: `_IOW('V', 91, struct v4l2_event_subscription)`.
const UNSUBSCRIBE_EVENT: u64 = request_code(1, 91, size_of::<sys::v4l2_event_subscription>());
/// `V4L2_EVENT_ALL`.
const EVENT_ALL: u32 = 0;

/// The number of a request as `linux/ioctl.h` builds it; direction 1 writes to the kernel, 2 reads.
const fn request_code(direction: u64, number: u64, size: usize) -> u64 {
    (direction << 30) | ((size as u64) << 16) | ((b'V' as u64) << 8) | number
}

/// Structures of the kernel of which all zeros is a value.
///
/// # Safety
///
/// Implemented for C structures of integers, raw pointers and unions of those only.
unsafe trait Plain: Sized {
    fn zeroed() -> Self {
        // SAFETY: by the promise of the trait, zero bytes are a valid value.
        unsafe { std::mem::zeroed() }
    }
}

macro_rules! plain {
    ($($name:ty),* $(,)?) => { $(
        // SAFETY: a structure of `linux/videodev2.h`: integers, pointers, and unions of those.
        unsafe impl Plain for $name {}
    )* };
}
plain!(
    sys::v4l2_capability,
    sys::v4l2_fmtdesc,
    sys::v4l2_format,
    sys::v4l2_query_ext_ctrl,
    sys::v4l2_querymenu,
    sys::v4l2_ext_control,
    sys::v4l2_ext_controls,
    sys::v4l2_event,
    sys::v4l2_event_subscription,
    sys::v4l2_requestbuffers,
    sys::v4l2_buffer,
    std::ffi::c_int,
);

/// An open device node, shared by the stream and the controls of one camera.
pub(super) struct Node {
    // Closed before the leases are dropped: fields are dropped in the order in which they are declared.
    device: Device,
    path: PathBuf,
    /// Memory that the driver may still write into until the node is closed.
    abandoned: Mutex<Vec<Box<dyn Lease>>>,
}

impl std::fmt::Debug for Node {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Node")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

/// What a driver says about itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Capability {
    pub(super) driver: String,
    pub(super) card: String,
    pub(super) bus: String,
    /// What this node can do, not the whole device.
    pub(super) flags: u32,
}

/// A layout of pictures as the driver has set it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) fourcc: [u8; 4],
    pub(super) size: Size,
    /// Distance between rows; 0 for compressed formats.
    pub(super) bytes_per_line: u32,
    /// Most bytes of a picture.
    pub(super) image_bytes: u32,
    pub(super) colorspace: u32,
    pub(super) ycbcr_enc: u32,
    pub(super) quantization: u32,
}

/// What a driver says about one of its controls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RawControl {
    pub(super) id: u32,
    pub(super) kind: u32,
    pub(super) name: String,
    pub(super) minimum: i64,
    pub(super) maximum: i64,
    pub(super) step: u64,
    pub(super) default: i64,
    pub(super) flags: u32,
    /// True for arrays and structures.
    pub(super) is_compound: bool,
}

/// What [`Node::poll`] found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Ready {
    /// A buffer can be dequeued.
    pub(super) has_buffer: bool,
    /// An event can be dequeued.
    pub(super) has_event: bool,
    /// The stream is broken or the device is gone; the next call says which.
    pub(super) has_failed: bool,
}

/// Where buffers lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Memory {
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
pub(super) struct Dequeued {
    pub(super) index: u32,
    pub(super) bytes_used: u32,
    pub(super) flags: u32,
    pub(super) sequence: u32,
    pub(super) timestamp_ns: u64,
}

impl Node {
    /// Opens a device node for reading and writing, without waiting calls; child processes do not inherit it.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        // The crate's `open` panics on a path with a zero byte.
        if path.as_os_str().as_encoded_bytes().contains(&0) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let device = Device::with_path(path)?;
        // SAFETY: sets a flag of a file descriptor that `device` keeps open.
        if unsafe { libc::fcntl(device.handle().fd(), libc::F_SETFD, libc::FD_CLOEXEC) } == -1 {
            return Err(io::Error::last_os_error());
        }
        Ok(Self {
            device,
            path: path.into(),
            abandoned: Mutex::new(Vec::new()),
        })
    }

    /// Where the node was opened.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The device of the crate `v4l`, for its calls that neither panic nor lose anything.
    pub(super) fn device(&self) -> &Device {
        &self.device
    }

    /// Keeps memory that the driver may still write into until the node is closed.
    pub(super) fn keep_until_closed(&self, leases: impl Iterator<Item = Box<dyn Lease>>) {
        self.abandoned
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .extend(leases);
    }

    /// Makes a request, again when a signal interrupted it.
    ///
    /// # Safety
    ///
    /// `argument` is what the kernel expects for `request`; memory that its pointers name may be read and written.
    unsafe fn call<T: Plain>(&self, request: u64, argument: &mut T) -> io::Result<()> {
        loop {
            // SAFETY: the descriptor is open as long as `self.device` lives; the argument is right by our own contract.
            let result = unsafe {
                v4l::v4l2::ioctl(
                    self.device.handle().fd(),
                    request,
                    std::ptr::from_mut(argument).cast::<c_void>(),
                )
            };
            match result {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }

    /// Driver, card, bus and abilities.
    pub(super) fn capability(&self) -> io::Result<Capability> {
        let mut caps = sys::v4l2_capability::zeroed();
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(vidioc::VIDIOC_QUERYCAP, &mut caps)? };
        let has_own_flags = caps.capabilities & sys::V4L2_CAP_DEVICE_CAPS != 0;
        Ok(Capability {
            driver: text(&caps.driver),
            card: text(&caps.card),
            bus: text(&caps.bus_info),
            flags: if has_own_flags {
                caps.device_caps
            } else {
                caps.capabilities
            },
        })
    }

    /// The four-character code and the name of the format with this index; none after the last.
    pub(super) fn format_at(&self, index: u32) -> io::Result<Option<([u8; 4], String)>> {
        let mut format = sys::v4l2_fmtdesc {
            index,
            type_: CAPTURE,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        match unsafe { self.call(vidioc::VIDIOC_ENUM_FMT, &mut format) } {
            Ok(()) => Ok(Some((format.pixelformat.to_le_bytes(), text(&format.description)))),
            Err(error) if error.raw_os_error() == Some(libc::EINVAL) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Asks for a layout and says what the driver made of it.
    pub(super) fn set_layout(&self, fourcc: [u8; 4], size: Size) -> io::Result<Layout> {
        let mut format = sys::v4l2_format {
            type_: CAPTURE,
            ..Plain::zeroed()
        };
        format.fmt.pix = sys::v4l2_pix_format {
            width: size.width,
            height: size.height,
            pixelformat: u32::from_le_bytes(fourcc),
            field: sys::v4l2_field_V4L2_FIELD_NONE,
            // SAFETY: a structure of integers.
            ..unsafe { std::mem::zeroed() }
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(vidioc::VIDIOC_S_FMT, &mut format)? };
        // SAFETY: all members of this union that a capture device fills are integers; `pix` is the one for `CAPTURE`.
        let (pix, ycbcr_enc) = unsafe { (format.fmt.pix, format.fmt.pix.__bindgen_anon_1.ycbcr_enc) };
        Ok(Layout {
            fourcc: pix.pixelformat.to_le_bytes(),
            size: Size {
                width: pix.width,
                height: pix.height,
            },
            bytes_per_line: pix.bytesperline,
            image_bytes: pix.sizeimage,
            colorspace: pix.colorspace,
            ycbcr_enc,
            quantization: pix.quantization,
        })
    }

    /// The control with this number, or with `V4L2_CTRL_FLAG_NEXT_CTRL` the next one; none if there is none.
    pub(super) fn control(&self, id: u32) -> io::Result<Option<RawControl>> {
        let mut control = sys::v4l2_query_ext_ctrl { id, ..Plain::zeroed() };
        // SAFETY: the request's own structure, without pointers.
        match unsafe { self.call(vidioc::VIDIOC_QUERY_EXT_CTRL, &mut control) } {
            Ok(()) => {}
            // EINVAL: no such control; ENOTTY: a driver without any.
            Err(error) if matches!(error.raw_os_error(), Some(libc::EINVAL | libc::ENOTTY)) => return Ok(None),
            Err(error) => return Err(error),
        }
        Ok(Some(RawControl {
            id: control.id,
            kind: control.type_,
            name: c_text(&control.name),
            minimum: control.minimum,
            maximum: control.maximum,
            step: control.step,
            default: control.default_value,
            flags: control.flags,
            is_compound: control.nr_of_dims > 0 || control.type_ >= sys::v4l2_ctrl_type_V4L2_CTRL_COMPOUND_TYPES,
        }))
    }

    /// The choice with this index of a menu: its name, or its number for a menu of integers. Menus have holes.
    pub(super) fn menu_item(&self, control: &RawControl, index: u32) -> Option<String> {
        let mut item = sys::v4l2_querymenu {
            id: control.id,
            index,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(vidioc::VIDIOC_QUERYMENU, &mut item).ok()? };
        let is_integer = control.kind == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU;
        // SAFETY: both members are integers, any bytes are valid.
        let (name, value) = unsafe { (item.__bindgen_anon_1.name, item.__bindgen_anon_1.value) };
        Some(if is_integer { value.to_string() } else { text(&name) })
    }

    /// The value of a control that holds one number.
    pub(super) fn value(&self, control: &RawControl) -> io::Result<i64> {
        let mut value = sys::v4l2_ext_control {
            id: control.id,
            ..Plain::zeroed()
        };
        self.exchange(vidioc::VIDIOC_G_EXT_CTRLS, &mut value)?;
        // SAFETY: both members are integers, any bytes are valid.
        Ok(unsafe {
            if is_wide(control) {
                value.__bindgen_anon_1.value64
            } else {
                value.__bindgen_anon_1.value.into()
            }
        })
    }

    /// Sets a control that holds one number. Values that do not fit are refused as out of range.
    pub(super) fn set_value(&self, control: &RawControl, value: i64) -> io::Result<()> {
        let mut argument = sys::v4l2_ext_control {
            id: control.id,
            ..Plain::zeroed()
        };
        if is_wide(control) {
            argument.__bindgen_anon_1.value64 = value;
        } else {
            let narrow = i32::try_from(value).map_err(|_| io::Error::from_raw_os_error(libc::ERANGE))?;
            argument.__bindgen_anon_1.value = narrow;
        }
        self.exchange(vidioc::VIDIOC_S_EXT_CTRLS, &mut argument)
    }

    /// Reads or writes one control. The size in `value` is 0, so the kernel takes nothing in it for a pointer.
    fn exchange(&self, request: u64, value: &mut sys::v4l2_ext_control) -> io::Result<()> {
        let mut values = sys::v4l2_ext_controls {
            count: 1,
            controls: value,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure; `controls` points to `count` = 1 controls, borrowed during the call.
        unsafe { self.call(request, &mut values) }
    }

    /// Asks for events when a control changes, unless this node itself changed it.
    pub(super) fn subscribe(&self, control_id: u32) -> io::Result<()> {
        let mut subscription = sys::v4l2_event_subscription {
            type_: sys::V4L2_EVENT_CTRL,
            id: control_id,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(SUBSCRIBE_EVENT, &mut subscription) }
    }

    /// Asks for no more events.
    pub(super) fn unsubscribe_all(&self) -> io::Result<()> {
        let mut subscription = sys::v4l2_event_subscription {
            type_: EVENT_ALL,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(UNSUBSCRIBE_EVENT, &mut subscription) }
    }

    /// The number of a control whose value changed, and the value; none if no such event is waiting.
    pub(super) fn changed_control(&self) -> io::Result<Option<(u32, i64)>> {
        let mut event = sys::v4l2_event::zeroed();
        // SAFETY: the request's own structure, without pointers.
        match unsafe { self.call(DEQUEUE_EVENT, &mut event) } {
            Ok(()) => {}
            Err(error) if matches!(error.raw_os_error(), Some(libc::ENOENT | libc::EAGAIN)) => return Ok(None),
            Err(error) => return Err(error),
        }
        if event.type_ != sys::V4L2_EVENT_CTRL {
            return Ok(None);
        }
        // SAFETY: the member of this type of event; all integers.
        let change = unsafe { event.u.ctrl };
        if change.changes & sys::V4L2_EVENT_CTRL_CH_VALUE == 0 {
            return Ok(None);
        }
        let is_wide = change.type_ == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER64;
        // SAFETY: both members are integers, any bytes are valid.
        let value = unsafe {
            if is_wide {
                change.__bindgen_anon_1.value64
            } else {
                change.__bindgen_anon_1.value.into()
            }
        };
        Ok(Some((event.id, value)))
    }

    /// Waits for a buffer, an event or a failure. Finds nothing when the timeout is over.
    pub(super) fn poll(&self, timeout: Duration) -> io::Result<Ready> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            // Rounded up, so that less than a millisecond does not spin.
            let left_ms = i32::try_from(left.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
            let mut poll = libc::pollfd {
                fd: self.device.handle().fd(),
                events: libc::POLLIN | libc::POLLPRI,
                revents: 0,
            };
            // SAFETY: one structure, borrowed during the call.
            if unsafe { libc::poll(&raw mut poll, 1, left_ms) } >= 0 {
                return Ok(Ready {
                    has_buffer: poll.revents & libc::POLLIN != 0,
                    has_event: poll.revents & libc::POLLPRI != 0,
                    has_failed: poll.revents & (libc::POLLERR | libc::POLLHUP | libc::POLLNVAL) != 0,
                });
            }
            let error = io::Error::last_os_error();
            if error.kind() != io::ErrorKind::Interrupted {
                return Err(error);
            }
        }
    }

    /// Makes `count` buffers, or frees all for 0; says how many there are now.
    pub(super) fn request_buffers(&self, memory: Memory, count: u32) -> io::Result<u32> {
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
    pub(super) fn buffer_place(&self, index: u32) -> io::Result<(u32, u32)> {
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
    pub(super) fn map(&self, offset: u32, length: usize) -> io::Result<*mut u8> {
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
    pub(super) unsafe fn queue_mapped(&self, index: u32) -> io::Result<()> {
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
    pub(super) unsafe fn queue_user(&self, index: u32, start: *mut u8, length: u32) -> io::Result<()> {
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
    pub(super) fn dequeue(&self, memory: Memory) -> io::Result<Dequeued> {
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
    pub(super) fn stream_on(&self) -> io::Result<()> {
        let mut kind = CAPTURE.cast_signed();
        // SAFETY: the request's own argument, an integer.
        unsafe { self.call(vidioc::VIDIOC_STREAMON, &mut kind) }
    }

    /// Stops the stream; when it succeeds, the driver has no buffer any more.
    pub(super) fn stream_off(&self) -> io::Result<()> {
        let mut kind = CAPTURE.cast_signed();
        // SAFETY: the request's own argument, an integer.
        unsafe { self.call(vidioc::VIDIOC_STREAMOFF, &mut kind) }
    }
}

/// Nanoseconds since boot on the clock of the drivers' stamps.
pub(crate) fn monotonic_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: writes to a structure of ours. It cannot fail: the clock exists on every Linux.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Free bytes on the file system of a path.
pub(super) fn free_bytes(path: &Path) -> io::Result<u64> {
    let path = CString::new(path.as_os_str().as_encoded_bytes())?;
    // SAFETY: a structure of integers.
    let mut found: libc::statvfs = unsafe { std::mem::zeroed() };
    // SAFETY: a text that ends in zero and a structure of ours, both borrowed during the call.
    if unsafe { libc::statvfs(path.as_ptr(), &raw mut found) } == -1 {
        return Err(io::Error::last_os_error());
    }
    Ok(found.f_bavail * found.f_frsize)
}

fn is_wide(control: &RawControl) -> bool {
    control.kind == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER64
}

/// Text up to the first zero; what is no UTF-8 is replaced, as drivers cut names in the middle of a letter.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

fn c_text(characters: &[c_char]) -> String {
    let bytes: Vec<u8> = characters.iter().map(|character| character.cast_unsigned()).collect();
    text(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_codes_are_those_of_the_crate_where_it_has_them() {
        assert_eq!(
            request_code(2, 0, size_of::<sys::v4l2_capability>()),
            vidioc::VIDIOC_QUERYCAP
        );
        assert_eq!(request_code(1, 18, 4), vidioc::VIDIOC_STREAMON);
        // As strace shows them on x86-64.
        assert_eq!((DEQUEUE_EVENT, SUBSCRIBE_EVENT), (0x8088_5659, 0x4020_565a));
    }

    #[test]
    fn text_cut_within_a_letter_is_still_text() {
        assert_eq!(text(b"Kamer\xc3\xa4\0rest"), "Kamerä");
        assert_eq!(text(b"Kamer\xc3"), "Kamer\u{fffd}");
    }

    #[test]
    fn a_file_that_is_no_device_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let node = Node::open(file.path()).unwrap();
        assert_eq!(node.capability().unwrap_err().raw_os_error(), Some(libc::ENOTTY));
        assert!(Node::open(Path::new("/dev/video\0")).is_err());
    }
}
