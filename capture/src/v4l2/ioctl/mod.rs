//! Calls into the kernel's video interface, each behind a function that is safe to call; only queueing buffers is not.
//!
//! Written out here instead of taken from the crate `v4l`: its conversions panic on text that is no UTF-8, on unknown
//! kinds of control and on unknown colour spaces, its poll hides what it found, and it knows no events.
//! Reference: Linux Media Userspace API, part I "Video for Linux API".

mod controls;
mod streaming;

use std::ffi::c_void;
use std::io;
use std::os::fd::BorrowedFd;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use rustix::io::{FdFlags, fcntl_setfd};
use v4l::Device;
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

pub(super) use controls::RawControl;
pub(crate) use streaming::monotonic_ns;
pub(super) use streaming::{Dequeued, Memory};

use crate::frame::Size;
use crate::pool::Lease;

/// Buffers of a video capture device with one plane, the only kind that is used here.
const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;

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

impl Node {
    /// Opens a device node for reading and writing, without waiting calls; child processes do not inherit it.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        // The crate's `open` panics on a path with a zero byte.
        if path.as_os_str().as_encoded_bytes().contains(&0) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let device = Device::with_path(path)?;
        let node = Self {
            device,
            path: path.into(),
            abandoned: Mutex::new(Vec::new()),
        };
        fcntl_setfd(node.descriptor(), FdFlags::CLOEXEC)?;
        Ok(node)
    }

    /// The open file, for as long as the node is open.
    fn descriptor(&self) -> BorrowedFd<'_> {
        // SAFETY: the device keeps it open and closes it when it is dropped, which the borrow of `self` forbids.
        unsafe { BorrowedFd::borrow_raw(self.device.handle().fd()) }
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
}

/// Free bytes on the file system of a path.
pub(super) fn free_bytes(path: &Path) -> io::Result<u64> {
    let found = rustix::fs::statvfs(path)?;
    Ok(found.f_bavail * found.f_frsize)
}

/// Text up to the first zero; what is no UTF-8 is replaced, as drivers cut names in the middle of a letter.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
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
