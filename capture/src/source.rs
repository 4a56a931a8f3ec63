//! Where frames come from: one trait for recordings now and cameras later, and everything that can go wrong there.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::frame::{Frame, PixelFormat, Size};
use crate::recording::mcap::McapReadError;

/// What a camera of the rig is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraRole {
    /// Moves and sees the markers; it leads: one frame set per frame of this camera.
    Scene,
    /// Fixed, films the mirror ball.
    Ball,
    /// Fixed, looks at the room itself through a fisheye lens.
    Fisheye,
}

/// One camera of a source: what its frames look like before the first one has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraDescription {
    /// Name, unique within the source, 1 to [`NAME_MAX_BYTES`] bytes.
    pub name: Arc<str>,
    /// What the camera is for.
    pub role: CameraRole,
    /// Width and height of every frame it sends.
    pub size: Size,
    /// Layout of every frame it sends.
    pub format: PixelFormat,
}

/// Longest camera name in bytes; frame sets that travel between processes have this much room for it.
pub const NAME_MAX_BYTES: usize = 64;

/// Most cameras a rig may have.
pub const CAMERAS_MAX: usize = 16;

/// Longest side of a picture in pixels.
pub const SIDE_MAX_PX: u32 = 16_384;

/// What [`Source::next_frame`] found.
#[derive(Debug, Clone)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly always a frame; a box would be an allocation per frame"
)]
pub enum Next {
    /// A frame.
    Frame(Frame),
    /// No frame within the timeout; the source goes on.
    TimedOut,
    /// There will be no more frames. Every later call says so again.
    End,
}

/// Something that sends frames, one at a time: a recording, a camera, a synthetic scene.
///
/// Promises every source keeps:
/// - the frames of one camera come in rising order of time stamp and of sequence number;
/// - time stamps of all cameras are on one monotonic clock;
/// - a frame carries the exposure in force when it was taken and has its camera's size and format;
/// - frames of different cameras may come in any order.
pub trait Source: Send {
    /// Cameras that send frames, in a fixed order; exactly one has the role [`CameraRole::Scene`].
    fn cameras(&self) -> &[CameraDescription];

    /// Waits up to `timeout` for the next frame.
    ///
    /// # Errors
    ///
    /// After an error for which [`SourceError::is_skippable`] is true the source goes on with the frame after the
    /// bad one; after any other error it is finished.
    fn next_frame(&mut self, timeout: Duration) -> Result<Next, SourceError>;
}

/// Why a source cannot be opened or cannot send a frame.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The folder of a recording is missing or is not a folder.
    #[error("cannot open recording `{}`: it is not a folder", path.display())]
    NotAFolder {
        /// What was given as the recording.
        path: PathBuf,
    },
    /// An MCAP recording cannot be played, or a part of it.
    #[error(transparent)]
    Mcap(#[from] McapReadError),
    /// A file of a recording cannot be read.
    #[error("cannot read `{}`", path.display())]
    ReadFile {
        /// The file.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: std::io::Error,
    },
    /// The rig file of a recording is no valid TOML or lacks what a recording needs of it.
    #[error("cannot understand rig file `{}`", path.display())]
    RigSyntax {
        /// The rig file.
        path: PathBuf,
        /// Place and reason.
        #[source]
        source: Box<toml::de::Error>,
    },
    /// A key of the rig file has a value that is not allowed.
    #[error("rig file `{}` has {key} = `{found}`, allowed is {allowed}", path.display())]
    RigValue {
        /// The rig file.
        path: PathBuf,
        /// Which key of which camera.
        key: String,
        /// The value found.
        found: String,
        /// What would be right.
        allowed: &'static str,
    },
    /// The rig has none or several cameras to lead.
    #[error("rig file `{}` has {n_leaders} cameras with role `scene`, needed is exactly 1", path.display())]
    RigLeader {
        /// The rig file.
        path: PathBuf,
        /// Number of cameras with the role `scene`.
        n_leaders: usize,
    },
    /// The first line of the frame list is not the one that is needed.
    #[error("frame list `{}` line 1 has the columns `{found}`, needed are exactly `{expected}`", path.display())]
    ListHeader {
        /// The frame list.
        path: PathBuf,
        /// Columns found.
        found: String,
        /// Columns needed, in this order.
        expected: String,
    },
    /// A line of the frame list is no valid CSV or has too few or too many fields.
    #[error("cannot read frame list `{}` line {line}", path.display())]
    ListSyntax {
        /// The frame list.
        path: PathBuf,
        /// Line number, the header being 1.
        line: u64,
        /// What the CSV reader said.
        #[source]
        source: csv::Error,
    },
    /// A field of the frame list has a value that is not allowed.
    #[error("frame list `{}` line {line} has {field} = `{found}`, allowed is {allowed}", path.display())]
    ListValue {
        /// The frame list.
        path: PathBuf,
        /// Line number, the header being 1.
        line: u64,
        /// Name of the column.
        field: &'static str,
        /// The value found.
        found: String,
        /// What would be right.
        allowed: String,
    },
    /// The frame list has no frame at all, or none of the leading camera.
    #[error("recording is empty: frame list `{}` has no frame of camera `{leader}`", path.display())]
    NoLeaderFrame {
        /// The frame list.
        path: PathBuf,
        /// The camera with the role `scene`.
        leader: String,
    },
    /// One picture is missing, broken or of the wrong kind; the source can go on with the next frame.
    #[error("cannot read frame {sequence} of camera `{camera}` from `{}` (`{}` line {line})",
        file.display(), list.display())]
    BadFrame {
        /// Name of the camera.
        camera: String,
        /// Sequence number of the lost frame.
        sequence: u64,
        /// The picture.
        file: PathBuf,
        /// The frame list that names it.
        list: PathBuf,
        /// Line of the frame list, the header being 1.
        line: u64,
        /// What is wrong with the picture.
        #[source]
        source: Box<PictureError>,
    },
}

/// What is wrong with a picture.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be opened or read.
    #[error("the system cannot read the file")]
    Read(#[source] std::io::Error),
    /// The file is not a whole PNG or JPEG picture.
    #[error("the file is no valid PNG or JPEG picture")]
    Decode(#[source] image::ImageError),
    /// The picture does not hold three 8-bit channels.
    #[error("the picture's pixels are `{found}`, allowed are `Rgb8`")]
    PixelKind {
        /// Kind of pixel found.
        found: String,
    },
    /// The picture is not as large as the rig file says.
    #[error("the picture is {}×{} px, the rig file says {}×{} px",
        found.width, found.height, expected.width, expected.height)]
    WrongSize {
        /// Size of the picture.
        found: Size,
        /// Size the rig file gives for the camera.
        expected: Size,
    },
}

impl SourceError {
    /// True if only one frame is lost and the source can go on with the next one.
    #[must_use]
    pub fn is_skippable(&self) -> bool {
        match self {
            Self::BadFrame { .. } => true,
            Self::Mcap(error) => error.is_skippable(),
            Self::NotAFolder { .. }
            | Self::ReadFile { .. }
            | Self::RigSyntax { .. }
            | Self::RigValue { .. }
            | Self::RigLeader { .. }
            | Self::ListHeader { .. }
            | Self::ListSyntax { .. }
            | Self::ListValue { .. }
            | Self::NoLeaderFrame { .. } => false,
        }
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Mcap(error) => error.hint(),
            Self::NotAFolder { .. } => "give the folder that holds `rig.toml` and `frames.csv`, or an MCAP file",
            Self::ReadFile { .. } => "a recording needs readable files `rig.toml` and `frames.csv`",
            Self::RigSyntax { .. } | Self::RigValue { .. } => {
                "every `[[camera]]` needs `name`, `role` and `size_px = [width, height]`"
            }
            Self::RigLeader { .. } => "give exactly one `[[camera]]` the `role = \"scene\"`",
            Self::ListHeader { .. } | Self::ListSyntax { .. } | Self::ListValue { .. } => {
                "correct this line of the frame list"
            }
            Self::NoLeaderFrame { .. } => "record at least one frame of the camera with `role = \"scene\"`",
            Self::BadFrame { .. } => "restore the picture, take its line out of `frames.csv`, or skip bad frames",
        }
    }
}
