//! What is wrong with a set-up of cameras: facts are gathered in one place and judged in another, which is pure.

mod judge;

use std::fs;
use std::path::Path;

pub use judge::diagnose;

use super::controls::AutoMode;
use super::enumerate::{CameraAddress, UsbPlace, find, holders_of, list_nodes};
use super::error::V4l2Error;
use super::format::FormatKind;
use super::{Camera, ioctl};
use crate::controls::ControlKind;
use crate::frame::Size;

/// How grave a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// It works, but not as well as it could.
    Warning,
    /// It does not work.
    Problem,
}

/// One thing that was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// How grave.
    pub severity: Severity,
    /// What was found.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

/// All that is judged.
#[derive(Debug, Clone, PartialEq)]
pub struct Facts {
    /// The cameras asked for, or all there are.
    pub cameras: Vec<CameraFacts>,
    /// Width and height that are to be streamed.
    pub size: Size,
    /// Frames per second that are to be streamed.
    pub frames_per_s: f64,
    /// Settings of the kernel's driver for USB cameras; none if it is not loaded.
    pub uvcvideo: Option<UvcSettings>,
    /// Free bytes in `/dev/shm`; none if there is none.
    pub shared_memory_free_bytes: Option<u64>,
}

/// What is known of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFacts {
    /// The address, as given.
    pub address: String,
    /// Whether it opened.
    pub opened: Opened,
    /// Where it is plugged in, if on USB.
    pub usb: Option<UsbPlace>,
    /// Programs that have it open.
    pub holders: Vec<String>,
    /// Formats of ours in which it has the size.
    pub formats: Vec<FormatKind>,
    /// Controls of ours that it has.
    pub controls: Vec<ControlKind>,
    /// Automatic modes that are on.
    pub modes_on: Vec<AutoMode>,
}

/// What came of opening a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Opened {
    /// It is a camera and opened.
    Yes,
    /// It did not: the error, what caused it, what to do about it.
    No {
        /// The error in words.
        what: String,
        /// The hint in words.
        remedy: String,
    },
}

/// Parameters of the kernel module `uvcvideo`, as sysfs shows them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct UvcSettings {
    /// Frames with errors are delivered, with a flag, instead of dropped.
    pub nodrop: bool,
    /// Stamps come from the camera's clock instead of the arrival of the first packet.
    pub hwtimestamps: bool,
    /// Clock of the stamps.
    pub clock: String,
}

/// Gathers the facts about these cameras, or about all there are if none is named.
#[must_use]
pub fn gather(addresses: &[CameraAddress], size: Size, frames_per_s: f64) -> Facts {
    let named = if addresses.is_empty() {
        list_nodes()
            .iter()
            .filter(|node| node.index == 0)
            .map(|node| CameraAddress::Path(node.path.clone()))
            .collect()
    } else {
        addresses.to_vec()
    };
    Facts {
        cameras: named.iter().map(|address| gather_camera(address, size)).collect(),
        size,
        frames_per_s,
        uvcvideo: uvc_settings(Path::new("/sys/module/uvcvideo/parameters")),
        shared_memory_free_bytes: ioctl::free_bytes(Path::new("/dev/shm")).ok(),
    }
}

fn gather_camera(address: &CameraAddress, size: Size) -> CameraFacts {
    let path = find(address).ok();
    let mut facts = CameraFacts {
        address: address.to_string(),
        opened: Opened::Yes,
        usb: path
            .as_ref()
            .and_then(|path| list_nodes().into_iter().find(|node| node.path == *path)?.usb),
        holders: path.as_deref().map(holders_of).unwrap_or_default(),
        formats: Vec::new(),
        controls: Vec::new(),
        modes_on: Vec::new(),
    };
    if let Err(error) = look_inside(address, size, &mut facts) {
        facts.opened = Opened::No {
            what: error.to_string(),
            remedy: error.hint(),
        };
    }
    facts
}

fn look_inside(address: &CameraAddress, size: Size, facts: &mut CameraFacts) -> Result<(), V4l2Error> {
    let camera = Camera::open(address)?;
    let offers = camera.offers()?;
    let is_offered = |kind: &FormatKind| {
        let mut same_format = offers.iter().filter(|offer| offer.fourcc == kind.fourcc());
        same_format.any(|offer| offer.sizes.iter().any(|offered| offered.sizes.contain(size)))
    };
    facts.formats = FormatKind::ALL.into_iter().filter(is_offered).collect();
    let controls = camera.controls();
    facts.controls = controls.ranges().iter().map(|(kind, _)| kind).collect();
    // A control that cannot be read now is no finding: streaming does not need it read.
    facts.modes_on = controls.modes_on().unwrap_or_default();
    Ok(())
}

fn uvc_settings(parameters: &Path) -> Option<UvcSettings> {
    if !parameters.is_dir() {
        return None;
    }
    let read = |name: &str| fs::read_to_string(parameters.join(name)).unwrap_or_default();
    let is_set = |name: &str| !matches!(read(name).trim(), "" | "0" | "N");
    Some(UvcSettings {
        nodrop: is_set("nodrop"),
        hwtimestamps: is_set("hwtimestamps"),
        clock: read("clock").trim().to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_as_sysfs_writes_them() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [
            ("nodrop", "1\n"),
            ("hwtimestamps", "0\n"),
            ("clock", "CLOCK_MONOTONIC\n"),
        ] {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let expected = UvcSettings {
            nodrop: true,
            hwtimestamps: false,
            clock: "CLOCK_MONOTONIC".into(),
        };
        assert_eq!(uvc_settings(folder.path()), Some(expected));
        assert_eq!(uvc_settings(&folder.path().join("absent")), None);
    }
}
