//! What can go wrong when recordings are written.

use std::io;
use std::path::PathBuf;

/// What of a recording is safe when writing it has failed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Kept {
    /// Frames in whole chunks.
    pub frames: u64,
    /// Length of the file up to the end of its last whole chunk.
    pub bytes: u64,
}

/// Why a recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// There is a file of that name already; recordings are never overwritten.
    #[error("cannot record to `{}`: the file exists", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created.
    #[error("cannot create `{}`", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// A camera that cannot be recorded.
    #[error("cannot record camera `{camera}`: {reason}")]
    Camera {
        /// Name of the camera.
        camera: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// The threads that write cannot be started.
    #[error("cannot start the threads that write the recording")]
    StartThread(#[source] io::Error),
    /// The disk has no room left.
    #[error("the disk is full: recording `{}` ends after {} frames ({} bytes), which are safe",
        path.display(), kept.frames, kept.bytes)]
    DiskFull {
        /// The file.
        path: PathBuf,
        /// What is safe.
        kept: Kept,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// Writing has failed for another reason.
    #[error("cannot write to `{}`: the recording ends after {} frames ({} bytes)",
        path.display(), kept.frames, kept.bytes)]
    Write {
        /// The file.
        path: PathBuf,
        /// What was written whole.
        kept: Kept,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The thread that writes has panicked.
    #[error("the thread that writes `{}` has panicked", path.display())]
    Panicked {
        /// The file.
        path: PathBuf,
    },
}

impl RecordError {
    /// True if the user's input is to blame (exit code 2), false if the program has failed (exit code 1).
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        matches!(self, Self::Exists { .. } | Self::Create { .. } | Self::Camera { .. })
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Exists { .. } => "choose another name or remove the file",
            Self::Create { .. } => "give a file in a folder that exists and may be written to",
            Self::Camera { .. } => "record cameras with different names of 1 to 64 bytes, 16 at most",
            Self::StartThread(_) => "free memory or raise the limit on threads",
            Self::DiskFull { .. } => "make room on the disk; what was recorded plays as it is",
            Self::Write { .. } => "look into the system's log for the disk; what was recorded plays as it is",
            Self::Panicked { .. } => "the message of the panic is above; please report it",
        }
    }
}
