//! What the threads of the daemon tell the hub.

use crossbeam_channel::Sender;

use super::device::Mode;
use crate::controls::{ControlRanges, ControlValues};
use crate::frame::{BufferFlags, Pixels};
use crate::lockstep::{Request, RequestId};
use crate::meter::Statistics;
use crate::stamps::{LossCounts, StampBasis, StampCounters};
use crate::v4l2::AutoMode;

/// Something that happened to a camera.
pub(super) struct Event {
    /// Index of the camera.
    pub(super) camera: usize,
    pub(super) what: What,
}

pub(super) enum What {
    /// It was found and is about to stream.
    Opened(Box<Opened>),
    /// It cannot be opened, or is gone, for this reason; it is looked for from now on.
    Closed { reason: String },
    /// Its stream was started anew, for this reason.
    Restarted { reason: String },
    /// A picture.
    Frame(Captured),
    /// Its account so far.
    Tally(Box<Tally>),
    /// Somebody switched an automatic mode on.
    AutoModeFound(AutoMode),
    /// A request was accepted at this time on the monotonic clock; these are the values now.
    Applied {
        id: RequestId,
        read_back: ControlValues,
        accepted_ns: u64,
    },
    /// A request was refused; perhaps because an automatic mode is on.
    Refused {
        id: RequestId,
        reason: String,
        is_automatic: bool,
    },
    /// Values read from the camera at this time, not those of a request.
    Found { values: ControlValues, accepted_ns: u64 },
    /// Values have changed that nobody asked to change.
    Drifted,
    /// A picture was measured.
    Measured { sequence: u64, statistics: Box<Statistics> },
    /// A picture could not be decoded.
    Undecodable { sequence: u64, reason: String },
}

/// A camera that was found.
pub(super) struct Opened {
    pub(super) mode: Mode,
    /// Its controls, if they answer.
    pub(super) controls: Option<OpenControls>,
    /// Automatic modes that were on.
    pub(super) switched_off: Vec<AutoMode>,
    /// What is wrong with its controls, if anything.
    pub(super) complaint: Option<String>,
}

/// The way to the controls of an open camera.
pub(super) struct OpenControls {
    pub(super) ranges: ControlRanges,
    pub(super) values: ControlValues,
    pub(super) requests: Sender<Request>,
}

/// A good picture with its checked number and time, before it is known how it was exposed.
pub(super) struct Captured {
    pub(super) sequence: u64,
    pub(super) timestamp_ns: u64,
    pub(super) lost_before: u32,
    pub(super) flags: BufferFlags,
    pub(super) pixels: Pixels,
}

/// The account of one camera since the daemon started.
#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    pub(super) delivered: u64,
    pub(super) losses: LossCounts,
    pub(super) duplicates: u64,
    pub(super) empty_buffers: u64,
    pub(super) stamps: StampCounters,
    pub(super) basis: Option<StampBasis>,
    pub(super) opened: u64,
    pub(super) restarts: u64,
}
