//! What can go wrong with a camera: opening it ([`V4l2Error`]), streaming ([`StreamError`]), controls ([`ControlError`]).

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use crate::controls::{ControlKind, ControlRange};
use crate::frame::Size;

use super::controls::AutoMode;

/// Why a camera cannot be opened, listed or set up.
#[derive(Debug, thiserror::Error)]
pub enum V4l2Error {
    /// No camera answers to the address.
    #[error("cannot find camera `{address}`: there are {}", known(present))]
    NoSuchCamera {
        /// The address, as it was given.
        address: String,
        /// Addresses of the cameras that are there.
        present: Vec<String>,
    },
    /// Several cameras answer to the address.
    #[error("cannot tell which camera is `{address}`: it could be {}", known(candidates))]
    Ambiguous {
        /// The address, as it was given.
        address: String,
        /// Addresses that name one of them each.
        candidates: Vec<String>,
    },
    /// The node exists, but this user may not open it.
    #[error("no permission to open camera `{}`: it belongs to group `{group}`", path.display())]
    NoPermission {
        /// The device node.
        path: PathBuf,
        /// The group that may, by name or number.
        group: String,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// Another program holds the camera.
    #[error("camera `{}` is busy: {}", path.display(), held_by(holders))]
    Busy {
        /// The device node.
        path: PathBuf,
        /// Programs that have it open, as name and process number, as far as `/proc` tells.
        holders: Vec<String>,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The node is something else than a camera that can stream.
    #[error("`{}` is no camera: {reason}", path.display())]
    NotACamera {
        /// The device node or file.
        path: PathBuf,
        /// What it is.
        reason: String,
    },
    /// The camera was unplugged.
    #[error("camera `{}` is unplugged", path.display())]
    Unplugged {
        /// The device node it had.
        path: PathBuf,
    },
    /// The camera has nothing that was wished for.
    #[error("camera `{}` has no format for {}×{} px: {}", path.display(), size.width, size.height, refusals.join("; "))]
    FormatRefused {
        /// The device node.
        path: PathBuf,
        /// The size wished for.
        size: Size,
        /// For each wished format, why not.
        refusals: Vec<String>,
    },
    /// A call failed for another reason.
    #[error("cannot {action} of camera `{}`", path.display())]
    Call {
        /// What was tried.
        action: &'static str,
        /// The device node.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
}

impl V4l2Error {
    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::NoSuchCamera { .. } => "`mirrorball-capture devices` lists the cameras".into(),
            Self::Ambiguous { .. } => "add the USB port, as in `NAME@usb-0000:00:14.0-1`".into(),
            Self::NoPermission { group, .. } => format!("add the user to the group: `sudo usermod -aG {group} $USER`"),
            Self::Busy { .. } => "end the other program; one program at a time can stream from a camera".into(),
            Self::NotACamera { .. } => "`mirrorball-capture devices` lists the cameras".into(),
            Self::Unplugged { .. } => "plug it in again".into(),
            Self::FormatRefused { .. } => {
                "`mirrorball-capture devices` lists formats, sizes and rates of each camera".into()
            }
            Self::Call { .. } => {
                "`mirrorball-capture doctor` looks for the cause; the kernel's log may say more".into()
            }
        }
    }

    /// The error for a failed call on an open camera.
    pub(super) fn from_call(action: &'static str, path: &Path, source: io::Error) -> Self {
        match source.raw_os_error() {
            Some(libc::ENODEV) => Self::Unplugged { path: path.into() },
            Some(libc::EBUSY) => Self::Busy {
                path: path.into(),
                holders: super::enumerate::holders_of(path),
                source,
            },
            _ => Self::Call {
                action,
                path: path.into(),
                source,
            },
        }
    }
}

/// Why a stream cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// The camera was unplugged. Open it again by its address when it is back; its node may have another number.
    #[error("camera `{}` was unplugged while streaming", path.display())]
    Unplugged {
        /// The device node it had.
        path: PathBuf,
    },
    /// The driver reports a fatal error of this stream; [`super::Stream::restart`] may bring it back.
    #[error("the stream of camera `{}` has failed", path.display())]
    Failed {
        /// The device node.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// A failed USB transfer took part of the stream with it, and nothing comes any more;
    /// [`super::Stream::restart`] may bring the stream back.
    #[error("the stream of camera `{}` is stuck since {n_empty} buffers came back empty", path.display())]
    Stuck {
        /// The device node.
        path: PathBuf,
        /// How many since the stream started.
        n_empty: u32,
    },
    /// Buffer after buffer comes back without a picture; [`super::Stream::restart`] may bring the stream back.
    #[error("camera `{}` sent {n_losses} broken frames in a row", path.display())]
    OnlyErrors {
        /// The device node.
        path: PathBuf,
        /// How many.
        n_losses: u32,
    },
    /// The USB bus has no room for the stream.
    #[error("no USB bandwidth left for camera `{}`", path.display())]
    NoBandwidth {
        /// The device node.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// Another program holds the stream of the camera.
    #[error("camera `{}` is busy: {}", path.display(), held_by(holders))]
    Busy {
        /// The device node.
        path: PathBuf,
        /// Programs that have it open, as name and process number, as far as `/proc` tells.
        holders: Vec<String>,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The pool cannot take the camera's pictures.
    #[error("pool has {n_buffers} buffers of {buffer_bytes} bytes, camera `{}` needs {n_needed} of {bytes_needed}", path.display())]
    PoolTooSmall {
        /// The device node.
        path: PathBuf,
        /// Free buffers found.
        n_buffers: usize,
        /// Free buffers needed at least.
        n_needed: usize,
        /// Length of the pool's buffers.
        buffer_bytes: usize,
        /// Length needed at least.
        bytes_needed: usize,
    },
    /// The driver does not write into lent memory, or not in the layout of frames.
    #[error("camera `{}` cannot write into shared memory: {reason}", path.display())]
    NoUserPtr {
        /// The device node.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A call failed for another reason.
    #[error("cannot {action} of camera `{}`", path.display())]
    Call {
        /// What was tried.
        action: &'static str,
        /// The device node.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
}

impl StreamError {
    /// True if [`super::Stream::restart`] is worth a try.
    #[must_use]
    pub fn is_restartable(&self) -> bool {
        matches!(
            self,
            Self::Failed { .. } | Self::Stuck { .. } | Self::OnlyErrors { .. } | Self::Call { .. }
        )
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Unplugged { .. } => "plug it in again; it is found by its address even under another node number",
            Self::Failed { .. } | Self::Stuck { .. } | Self::OnlyErrors { .. } => {
                "restart the stream; if it comes back, change cable, port or hub"
            }
            Self::NoBandwidth { .. } => {
                "choose MJPEG, a smaller size or fewer frames/s, or put the cameras on different USB controllers"
            }
            Self::Busy { .. } => "end the other program; one program at a time can stream from a camera",
            Self::PoolTooSmall { .. } => "raise the number of buffers",
            Self::NoUserPtr { .. } => "use `method = \"mmap\"` or `\"auto\"`",
            Self::Call { .. } => "`mirrorball-capture doctor` looks for the cause; the kernel's log may say more",
        }
    }

    /// The error for a failed call of a stream.
    pub(super) fn from_call(action: &'static str, path: &Path, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.raw_os_error() {
            Some(libc::ENODEV) => Self::Unplugged { path },
            Some(libc::EIO) => Self::Failed { path, source },
            Some(libc::ENOSPC) => Self::NoBandwidth { path, source },
            Some(libc::EBUSY) => Self::Busy {
                holders: super::enumerate::holders_of(&path),
                path,
                source,
            },
            _ => Self::Call { action, path, source },
        }
    }
}

/// Why a control cannot be read or set.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The camera does not have the control.
    #[error("camera `{}` has no control for {kind}", path.display())]
    Missing {
        /// The device node.
        path: PathBuf,
        /// The control.
        kind: ControlKind,
    },
    /// The value is not in the control's range, or between its steps.
    #[error("cannot set {kind} of camera `{}` to `{value}`, allowed is {}", path.display(), allowed(range))]
    OutOfRange {
        /// The device node.
        path: PathBuf,
        /// The control.
        kind: ControlKind,
        /// The value.
        value: i64,
        /// What the camera allows.
        range: ControlRange,
    },
    /// The camera itself steers the control at the moment.
    #[error("cannot set {kind} of camera `{}`: the camera steers it itself", path.display())]
    AutoStillOn {
        /// The device node.
        path: PathBuf,
        /// The control.
        kind: ControlKind,
    },
    /// The camera is busy with an earlier request.
    #[error("cannot access {what} of camera `{}`: the camera is busy", path.display())]
    Busy {
        /// The device node.
        path: PathBuf,
        /// The control.
        what: String,
    },
    /// An automatic mode cannot be switched off.
    #[error("cannot switch off {mode} of camera `{}`", path.display())]
    AutoStays {
        /// The device node.
        path: PathBuf,
        /// The mode.
        mode: AutoMode,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The camera was unplugged.
    #[error("camera `{}` is unplugged", path.display())]
    Unplugged {
        /// The device node it had.
        path: PathBuf,
    },
    /// The camera refused, or does not answer.
    #[error("camera `{}` refuses access to {what}", path.display())]
    Refused {
        /// The device node.
        path: PathBuf,
        /// The control, and the value if there is one.
        what: String,
        /// What the system said.
        #[source]
        source: io::Error,
    },
}

impl ControlError {
    /// True if the same request may succeed a little later.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        matches!(self, Self::Busy { .. } | Self::Refused { .. })
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Missing { .. } => "`mirrorball-capture devices` lists the controls of each camera",
            Self::OutOfRange { .. } => "choose a value the camera allows",
            Self::AutoStillOn { .. } => "switch the automatic mode off first; another program may have switched it on",
            Self::Busy { .. } => "try again after the next frame",
            Self::AutoStays { .. } => "exposure and white balance cannot be kept in step with this camera",
            Self::Unplugged { .. } => "plug it in again",
            Self::Refused { .. } => "try again; a camera that goes on refusing needs to be plugged in anew",
        }
    }

    /// The error for a failed access to a control.
    pub(super) fn from_access(path: &Path, what: &dyn fmt::Display, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.raw_os_error() {
            Some(libc::ENODEV) => Self::Unplugged { path },
            Some(libc::EBUSY) => Self::Busy {
                path,
                what: what.to_string(),
            },
            _ => Self::Refused {
                path,
                what: what.to_string(),
                source,
            },
        }
    }
}

impl fmt::Display for ControlKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::ExposureTime => "exposure time",
            Self::Gain => "gain",
            Self::WhiteBalanceTemperature => "white balance temperature",
            Self::RedBalance => "red balance",
            Self::BlueBalance => "blue balance",
        })
    }
}

fn allowed(range: &ControlRange) -> String {
    let ControlRange {
        minimum, maximum, step, ..
    } = range;
    if *step == 1 {
        format!("{minimum}..={maximum}")
    } else {
        format!("{minimum}..={maximum} in steps of {step}")
    }
}

fn known(addresses: &[String]) -> String {
    if addresses.is_empty() {
        return "none".into();
    }
    let quoted: Vec<_> = addresses.iter().map(|address| format!("`{address}`")).collect();
    quoted.join(", ")
}

fn held_by(holders: &[String]) -> String {
    if holders.is_empty() {
        "`/proc` does not tell by whom".into()
    } else {
        format!("held by {}", known(holders))
    }
}
