//! What can go wrong when MCAP recordings are read.

use std::io;
use std::path::PathBuf;

use super::layout::FORMAT_VERSION;

/// Why an MCAP recording cannot be played, or a part of it.
#[derive(Debug, thiserror::Error)]
pub enum McapReadError {
    /// The file cannot be opened.
    #[error("cannot open recording `{}`", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The file cannot be read further.
    #[error("cannot read recording `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// The file does not begin as MCAP files do.
    #[error("`{}` is no MCAP file", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// An MCAP file that another program has made.
    #[error("`{}` is an MCAP file, but no recording of ours: it has no metadata record `mirrorball`", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A recording of another version of the format.
    #[error("recording `{}` has format version `{found}`, supported is {FORMAT_VERSION}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
    },
    /// The channel of a camera does not say what is needed.
    #[error("recording `{}`: channel `{topic}` is bad: {reason}", path.display())]
    Channel {
        /// The file.
        path: PathBuf,
        /// Topic of the channel.
        topic: String,
        /// What is wrong.
        reason: String,
    },
    /// None or several cameras lead.
    #[error("recording `{}` has {n_leaders} cameras with role `scene`, needed is exactly 1", path.display())]
    Leader {
        /// The file.
        path: PathBuf,
        /// Number of cameras with the role `scene`.
        n_leaders: usize,
    },
    /// There is no frame of the leading camera.
    #[error("recording `{}` is empty: it has no whole frame of camera `{leader}`", path.display())]
    NoLeaderFrame {
        /// The file.
        path: PathBuf,
        /// The camera with the role `scene`.
        leader: String,
    },
    /// A chunk is damaged; its frames are skipped.
    #[error("recording `{}`: the chunk at byte {offset} ({n_bytes} bytes) is bad: {reason}", path.display())]
    BadChunk {
        /// The file.
        path: PathBuf,
        /// Where the chunk's content begins.
        offset: u64,
        /// Its length.
        n_bytes: u64,
        /// What is wrong.
        reason: String,
    },
    /// Bytes that are no records; what lay there is skipped.
    #[error("recording `{}`: bytes {from} to {to} are damaged", path.display())]
    Damage {
        /// The file.
        path: PathBuf,
        /// First damaged byte.
        from: u64,
        /// First byte that is good again.
        to: u64,
    },
    /// A frame is bad; it is skipped.
    #[error("recording `{}`: a frame of camera `{camera}` with time {timestamp_ns} ns is bad: {reason}", path.display())]
    BadFrame {
        /// The file.
        path: PathBuf,
        /// Name of the camera.
        camera: String,
        /// Time of its messages.
        timestamp_ns: u64,
        /// What is wrong.
        reason: String,
    },
}

impl McapReadError {
    /// True if only a part is lost and playing can go on after it.
    #[must_use]
    pub fn is_skippable(&self) -> bool {
        match self {
            Self::BadChunk { .. } | Self::Damage { .. } | Self::BadFrame { .. } => true,
            Self::Open { .. }
            | Self::Read { .. }
            | Self::NotMcap { .. }
            | Self::Foreign { .. }
            | Self::Version { .. }
            | Self::Channel { .. }
            | Self::Leader { .. }
            | Self::NoLeaderFrame { .. } => false,
        }
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Open { .. } | Self::Read { .. } => "give a readable MCAP file",
            Self::NotMcap { .. } => "give a folder with `rig.toml` and `frames.csv`, or an MCAP file",
            Self::Foreign { .. } => "give a file that `mirrorball-capture record` or `import` has made",
            Self::Version { .. } => "play it with the version of `mirrorball-capture` that recorded it",
            Self::Channel { .. } => "leave channels and their metadata as they were recorded",
            Self::Leader { .. } => "record with exactly one camera of role `scene`",
            Self::NoLeaderFrame { .. } => "record at least one frame of the camera with `role = \"scene\"`",
            Self::BadChunk { .. } | Self::Damage { .. } | Self::BadFrame { .. } => {
                "restore the file from a copy, or skip what is bad"
            }
        }
    }
}
