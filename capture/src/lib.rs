//! Frames from recordings and cameras, and their hand-over to whoever uses them.
//!
//! **A frame** ([`Frame`]) is one picture as the camera encoded it, with the truth about how it was taken: the
//! exposure, gain and white balance in force at that moment, never the ones asked for. It is immutable; a clone shares
//! the pixels. A **frame set** ([`FrameSet`]) is one frame of the leading camera (the one with the role `scene`) and,
//! of every other camera, the frame nearest to it in time.
//!
//! **The clock**: time stamps are nanoseconds on one monotonic clock shared by all cameras of a rig. Frames are paired
//! by time stamp, never by sequence number, and never by the time at which they arrive.
//!
//! **Who owns what**:
//!
//! ```text
//! Source --Frame--> Grouper --FrameSet--> Publisher ~~~ Subscriber --FrameSet--> user
//!         one at a time      bounded               bounded
//! ```
//!
//! A [`Source`] makes frames and gives them away. The [`Grouper`] keeps a few until their partners have come. The
//! [`handover`] keeps as many sets as its transport has room for. After that a frame lives as long as its user holds
//! it. A [`Playback`] drives the chain; [`play_in_thread`] does so on a thread of its own (the embedded mode), the
//! program `mirrorball-capture` as a process of its own (the live mode).
//!
//! **What is not in here**: no GPU; no calibration (of a rig file only names, roles and sizes of the cameras are read);
//! no colour or lens maths; no file system outside [`recording`]; no queue without a bound.

pub mod config;
pub mod controls;
pub mod daemon;
pub mod decode;
pub mod frame;
pub mod grouping;
pub mod handover;
pub mod lockstep;
pub mod meter;
pub mod notify;
pub mod playback;
pub mod pool;
pub mod recording;
pub mod source;
pub mod stamps;
pub mod status;
pub mod v4l2;

pub use config::{CaptureConfig, ConfigError};
pub use controls::{ControlKind, ControlRange, ControlRanges, ControlValues, PerControl};
pub use decode::{DecodeError, to_rgb8};
pub use frame::{
    BufferFlags, Exposure, Frame, FrameMeta, FrameSet, PixelFormat, Pixels, Size, Ycbcr, YcbcrMatrix, YcbcrRange,
};
pub use grouping::{DEFAULT_MAX_SKEW, Grouper, GroupingCounters};
pub use handover::{HandoverError, Publisher, Received, Subscriber};
pub use meter::{Meter, Response, Statistics};
pub use playback::{BadFramePolicy, Playback, PlaybackStats, PlaybackThread, Progress, play_in_thread};
pub use pool::{HeapPool, Lease, Pool};
pub use recording::{Pace, Player, Repeat, open_recording};
pub use source::{CameraDescription, CameraRole, Next, Source, SourceError};
