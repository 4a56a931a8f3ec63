//! Cameras on the kernel's Video4Linux interface: finding, opening, agreeing on a format, streaming, controls.
//!
//! ```text
//! CameraAddress --find--> Camera --negotiate--> Negotiated --start--> Stream --next--> Taken
//!                            \--controls--> V4l2Controls (for another thread)
//! ```
//!
//! Nothing of V4L2 leaves this module but names and flags. `unsafe` is in two places: `ioctl` makes the calls,
//! `buffers.rs` owns the memory that the driver writes into.
//!
//! What is not in here: no threads, no waiting but in [`Stream::next`], no decoding of JPEG, no judgement of time
//! stamps, no search for a camera that has gone.

#[expect(
    unsafe_code,
    reason = "memory that a driver writes into is mapped and lent by hand; the file keeps its books"
)]
mod buffers;
mod colour;
mod control_list;
mod controls;
pub mod doctor;

mod enumerate;
mod error;
mod format;
#[expect(unsafe_code, reason = "the kernel's video interface is system calls on C structures")]
mod ioctl;
mod losses;
mod stream;

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;

use v4l::v4l_sys as sys;
use v4l::video::Capture;

pub use control_list::ControlDescription;
pub use controls::{AutoMode, ControlChange, PowerLine, V4l2Controls, Watched};
pub use enumerate::{CameraAddress, CameraNode, UsbPlace, find, holders_of, list_nodes};
pub use error::{ControlError, StreamError, V4l2Error};
pub use format::{Choice, FormatKind, FormatOffer, Interval, Intervals, Negotiated, SizeOffer, Sizes, Wish, choose};
pub(crate) use ioctl::monotonic_ns;
pub use losses::{Loss, LossCause};
pub use stream::{Method, Raw, StampClock, Stream, StreamSettings, Taken};

use crate::frame::{PixelFormat, Size, YcbcrRange};
use crate::pool::Pool;
use ioctl::{Capability, Layout, Node};

/// An open camera.
#[derive(Debug)]
pub struct Camera {
    node: Arc<Node>,
    capability: Capability,
    controls: V4l2Controls,
}

impl Camera {
    /// Opens the camera that answers to the address.
    ///
    /// # Errors
    ///
    /// There is none, it is no camera, or this user may not open it.
    pub fn open(address: &CameraAddress) -> Result<Self, V4l2Error> {
        Self::open_node(&find(address)?)
    }

    fn open_node(path: &Path) -> Result<Self, V4l2Error> {
        let node = Node::open(path).map_err(|error| open_error(path, error))?;
        let capability = node.capability().map_err(|error| match error.raw_os_error() {
            Some(libc::ENOTTY | libc::EINVAL) => not_a_camera(path, "a file that is no video device"),
            _ => V4l2Error::from_call("read the abilities", path, error),
        })?;
        if let Some(reason) = hindrance(capability.flags) {
            return Err(not_a_camera(path, reason));
        }
        let node = Arc::new(node);
        let controls = V4l2Controls::find(node.clone()).map_err(|error| match error {
            ControlError::Refused { source, .. } => V4l2Error::from_call("read the controls", path, source),
            _ => V4l2Error::Unplugged { path: path.into() },
        })?;
        Ok(Self {
            node,
            capability,
            controls,
        })
    }

    /// The device node.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.node.path()
    }

    /// Name of the camera.
    #[must_use]
    pub fn card(&self) -> &str {
        &self.capability.card
    }

    /// Name of the driver.
    #[must_use]
    pub fn driver(&self) -> &str {
        &self.capability.driver
    }

    /// Where it is plugged in, as the driver names it.
    #[must_use]
    pub fn bus(&self) -> &str {
        &self.capability.bus
    }

    /// The camera's controls. They keep the device open: let go of them when the camera is unplugged.
    #[must_use]
    pub fn controls(&self) -> V4l2Controls {
        self.controls.clone()
    }

    /// All formats, sizes and rates.
    ///
    /// # Errors
    ///
    /// The camera is gone or does not answer.
    pub fn offers(&self) -> Result<Vec<FormatOffer>, V4l2Error> {
        let mut offers = Vec::new();
        for index in 0.. {
            let format = self
                .node
                .format_at(index)
                .map_err(|error| self.error("list formats", error))?;
            let Some((fourcc, name)) = format else { break };
            offers.push(FormatOffer {
                fourcc,
                name,
                sizes: self.sizes(fourcc)?,
            });
        }
        Ok(offers)
    }

    fn sizes(&self, fourcc: [u8; 4]) -> Result<Vec<SizeOffer>, V4l2Error> {
        let found = self.node.device().enum_framesizes(v4l::FourCC::new(&fourcc));
        let found = none_if_unsupported(found).map_err(|error| self.error("list sizes", error))?;
        let mut sizes = Vec::new();
        for size in found {
            let sizes_of_one = match size.size {
                v4l::framesize::FrameSizeEnum::Discrete(size) => Sizes::Discrete(Size {
                    width: size.width,
                    height: size.height,
                }),
                v4l::framesize::FrameSizeEnum::Stepwise(range) => Sizes::Stepwise {
                    least: Size {
                        width: range.min_width,
                        height: range.min_height,
                    },
                    most: Size {
                        width: range.max_width,
                        height: range.max_height,
                    },
                    step: Size {
                        width: range.step_width,
                        height: range.step_height,
                    },
                },
            };
            let (Sizes::Discrete(greatest) | Sizes::Stepwise { most: greatest, .. }) = sizes_of_one;
            sizes.push(SizeOffer {
                sizes: sizes_of_one,
                intervals: self.intervals(fourcc, greatest)?,
            });
        }
        Ok(sizes)
    }

    fn intervals(&self, fourcc: [u8; 4], size: Size) -> Result<Intervals, V4l2Error> {
        let found = self
            .node
            .device()
            .enum_frameintervals(v4l::FourCC::new(&fourcc), size.width, size.height);
        let found = none_if_unsupported(found).map_err(|error| self.error("list rates", error))?;
        let own = |fraction: v4l::Fraction| Interval {
            numerator: fraction.numerator,
            denominator: fraction.denominator,
        };
        let mut discrete = Vec::new();
        for interval in found {
            match interval.interval {
                v4l::frameinterval::FrameIntervalEnum::Discrete(interval) => discrete.push(own(interval)),
                v4l::frameinterval::FrameIntervalEnum::Stepwise(range) => {
                    return Ok(Intervals::Between(own(range.min), own(range.max)));
                }
            }
        }
        Ok(if discrete.is_empty() {
            Intervals::Unknown
        } else {
            Intervals::Discrete(discrete)
        })
    }

    /// Agrees with the driver on format, size and rate, and says so in the log.
    ///
    /// # Errors
    ///
    /// Nothing that was wished for is offered, or the driver does otherwise than it offers.
    pub fn negotiate(&mut self, wish: &Wish) -> Result<Negotiated, V4l2Error> {
        let refuse = |refusals| V4l2Error::FormatRefused {
            path: self.path().into(),
            size: wish.size,
            refusals,
        };
        let mut offers = self.offers()?;
        // Ranges of sizes are listed with the rates of the greatest; this one may be faster.
        for offer in &mut offers {
            for size in &mut offer.sizes {
                if matches!(size.sizes, Sizes::Stepwise { .. }) && size.sizes.contain(wish.size) {
                    size.intervals = self.intervals(offer.fourcc, wish.size)?;
                }
            }
        }
        let choice = choose(wish, &offers).map_err(refuse)?;
        let layout = self.node.set_layout(choice.format.fourcc(), wish.size);
        let layout = layout.map_err(|error| self.error("set the format", error))?;
        if layout.fourcc != choice.format.fourcc() || layout.size != wish.size {
            let (Size { width, height }, code) = (layout.size, String::from_utf8_lossy(&layout.fourcc));
            let refusal = format!(
                "{} refused: the driver makes {width}x{height} {code} of it",
                choice.format
            );
            return Err(refuse(vec![refusal]));
        }
        let interval = self.set_interval(choice.interval)?;
        let negotiated = self
            .agreement(choice, layout, interval)
            .map_err(|refusal| refuse(vec![refusal]))?;
        tracing::info!("camera `{}`: {negotiated}", self.path().display());
        Ok(negotiated)
    }

    /// Asks for a time between frames and returns what the driver takes; none for drivers without the notion.
    fn set_interval(&self, wanted: Option<Interval>) -> Result<Option<Interval>, V4l2Error> {
        let device = self.node.device();
        let result = match wanted {
            Some(Interval { numerator, denominator }) => {
                let fraction = v4l::Fraction::new(numerator, denominator);
                device.set_params(&v4l::video::capture::Parameters::new(fraction))
            }
            None => device.params(),
        };
        match result {
            Ok(taken) if taken.interval.numerator > 0 && taken.interval.denominator > 0 => {
                let v4l::Fraction { numerator, denominator } = taken.interval;
                Ok(Some(Interval { numerator, denominator }))
            }
            Ok(_) => Ok(None),
            Err(error) if matches!(error.raw_os_error(), Some(libc::ENOTTY | libc::EINVAL)) => Ok(None),
            Err(error) => Err(self.error("set the rate", error)),
        }
    }

    fn agreement(&self, choice: Choice, layout: Layout, interval: Option<Interval>) -> Result<Negotiated, String> {
        let mut remarks = choice.refusals;
        let format = match choice.format {
            FormatKind::Yuyv => PixelFormat::Yuyv(colour::ycbcr(&layout)?),
            FormatKind::Nv12 => PixelFormat::Nv12(colour::ycbcr(&layout)?),
            FormatKind::Mjpeg => PixelFormat::Mjpeg,
            FormatKind::Grey => {
                // Drivers leave the default, which is limited for anything but JPEG, and send 0 to 255.
                if colour::range(&layout) == YcbcrRange::Limited {
                    remarks.push("GREY taken as full range".into());
                }
                PixelFormat::Grey8
            }
        };
        let row_bytes = choice
            .format
            .row_bytes(layout.size)
            .map_or(0, |bytes| u32::try_from(bytes).unwrap_or(u32::MAX));
        // Some drivers leave it 0 for rows without padding.
        let bytes_per_line = if row_bytes == 0 {
            0
        } else {
            layout.bytes_per_line.max(row_bytes)
        };
        Ok(Negotiated {
            format,
            kind: choice.format,
            size: layout.size,
            interval,
            bytes_per_line,
            image_bytes: layout.image_bytes,
            remarks,
        })
    }

    /// Starts to stream what was negotiated; frames will be in buffers of `pool`.
    ///
    /// # Errors
    ///
    /// The pool is too small, the USB bus has no room, the camera is gone or streams already.
    pub fn start(
        &self,
        negotiated: &Negotiated,
        settings: StreamSettings,
        pool: &mut dyn Pool,
    ) -> Result<Stream, StreamError> {
        Stream::start(self.node.clone(), negotiated.clone(), &self.controls, settings, pool)
    }

    fn error(&self, action: &'static str, error: io::Error) -> V4l2Error {
        V4l2Error::from_call(action, self.path(), error)
    }
}

/// What keeps a node with these abilities from being one of our cameras.
fn hindrance(flags: u32) -> Option<&'static str> {
    let has = |flag| flags & flag != 0;
    if has(sys::V4L2_CAP_VIDEO_CAPTURE) {
        return (!has(sys::V4L2_CAP_STREAMING)).then_some("it cannot stream");
    }
    Some(if has(sys::V4L2_CAP_META_CAPTURE) {
        "it is a camera's metadata node; the camera is another node"
    } else if has(sys::V4L2_CAP_VIDEO_CAPTURE_MPLANE) {
        "its pictures come in several planes, which is not supported"
    } else {
        "the device takes no pictures"
    })
}

fn not_a_camera(path: &Path, reason: &str) -> V4l2Error {
    V4l2Error::NotACamera {
        path: path.into(),
        reason: reason.into(),
    }
}

fn open_error(path: &Path, source: io::Error) -> V4l2Error {
    match source.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => V4l2Error::NoPermission {
            path: path.into(),
            group: group_of(path),
            source,
        },
        Some(libc::ENOENT | libc::ENODEV | libc::ENXIO) => {
            let cameras = list_nodes().into_iter().filter(|node| node.index == 0);
            V4l2Error::NoSuchCamera {
                address: path.display().to_string(),
                present: cameras
                    .map(|node| format!("{} ({})", node.path.display(), node.address()))
                    .collect(),
            }
        }
        Some(libc::EISDIR | libc::ENOTDIR) => not_a_camera(path, "a folder"),
        _ => V4l2Error::from_call("open the device", path, source),
    }
}

/// Name of the group that a file belongs to, or its number.
fn group_of(path: &Path) -> String {
    let Ok(metadata) = std::fs::metadata(path) else {
        return "video".into();
    };
    let number = metadata.gid().to_string();
    let groups = std::fs::read_to_string("/etc/group").unwrap_or_default();
    let named = groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)? == number).then(|| name.to_owned())
    });
    named.unwrap_or(number)
}

/// Lists that a driver does not have are empty.
fn none_if_unsupported<T>(found: io::Result<Vec<T>>) -> io::Result<Vec<T>> {
    match found {
        Err(error) if matches!(error.raw_os_error(), Some(libc::ENOTTY | libc::EINVAL)) => Ok(Vec::new()),
        found => found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_no_cameras_are_named_as_such() {
        let open = |path: &str| Camera::open(&CameraAddress::Path(path.into())).unwrap_err();
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = open(file.path().to_str().unwrap());
        assert!(matches!(error, V4l2Error::NotACamera { .. }), "{error}");
        assert!(matches!(open("/dev/null"), V4l2Error::NotACamera { .. }));
        assert!(matches!(open("/dev"), V4l2Error::NotACamera { .. }));
        let error = open("/dev/video-that-is-not");
        assert!(
            error
                .to_string()
                .starts_with("cannot find camera `/dev/video-that-is-not`"),
            "{error}"
        );
    }

    #[test]
    fn metadata_nodes_are_no_cameras() {
        assert_eq!(hindrance(sys::V4L2_CAP_VIDEO_CAPTURE | sys::V4L2_CAP_STREAMING), None);
        assert!(
            hindrance(sys::V4L2_CAP_META_CAPTURE | sys::V4L2_CAP_STREAMING)
                .unwrap()
                .contains("metadata")
        );
        assert!(hindrance(sys::V4L2_CAP_VIDEO_CAPTURE).unwrap().contains("stream"));
        assert!(hindrance(sys::V4L2_CAP_VIDEO_OUTPUT).is_some());
    }
}
