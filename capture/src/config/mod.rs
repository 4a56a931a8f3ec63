//! What the daemon is told: `configs/capture.toml`, read into checked types.
//!
//! Every value is in its range once there is a [`CaptureConfig`]. `configs/README.md` lists keys, units, ranges and
//! defaults. What is not checked here: whether cameras are there and can do what is asked of them.

mod check;
mod describe;
mod document;
mod error;
mod file;

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use error::ConfigError;

use crate::frame::Size;
use crate::lockstep::LockstepSettings;
use crate::lockstep::tables::Tables;
use crate::meter::Response;
use crate::source::CameraRole;
use crate::stamps::StampPolicy;
use crate::v4l2::{CameraAddress, FormatKind, Method};

/// Longest configuration file in bytes: tables of a few thousand points have room in it.
const FILE_MAX_BYTES: u64 = 1 << 20;

/// Everything the daemon is told.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureConfig {
    /// How frame sets are published, and where the daemon tells how it is.
    pub service: ServiceConfig,
    /// The rig file that goes into recordings, if there is one.
    pub rig: Option<PathBuf>,
    /// 1 or 2 cameras in the order of the file; exactly one has the role `scene`.
    pub cameras: Vec<CameraConfig>,
    /// How exposure and white balance are chosen; cameras are indices into [`Self::cameras`].
    pub lockstep: LockstepSettings,
    /// How the daemon records, from the first frame on; None if it is not to.
    pub record: Option<RecordConfig>,
    /// How the daemon logs.
    pub log: LogFormat,
}

/// How frame sets are published, and where the daemon tells how it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceConfig {
    /// Name of the service, 1 to 255 bytes.
    pub name: String,
    /// Largest difference in time between frames of one set, 1 to 1000 ms.
    pub max_skew: Duration,
    /// Socket of the status server; None for the default place, see [`crate::status::default_socket`].
    pub status_socket: Option<PathBuf>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraConfig {
    /// Name, as in the rig file: letters, digits, `-`, `_`; 1 to 64.
    pub name: Arc<str>,
    /// What it is for.
    pub role: CameraRole,
    /// How it is found.
    pub address: CameraAddress,
    /// Size of its pictures, each side 1 to 16384 px.
    pub size: Size,
    /// Frames per second wanted, 1 to 1000.
    pub rate_hz: f64,
    /// Formats in order of preference: at least one, none twice.
    pub formats: Vec<FormatKind>,
    /// How pictures get from the driver into our memory.
    pub method: Method,
    /// Buffers that the driver is given, 3 to 32.
    pub n_buffers: u32,
    /// Whether its time stamps are believed.
    pub stamps: StampPolicy,
    /// Added to its time stamps, in nanoseconds, at most 1 s either way.
    pub stamp_offset_ns: i64,
    /// What its codes say about light.
    pub response: Response,
    /// What its control values mean.
    pub tables: Tables,
    /// Frames until a control shows, 0 to 8; None to measure it.
    pub latency_frames: Option<u32>,
}

/// How the daemon records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordConfig {
    /// Folder that recordings are put into.
    pub directory: PathBuf,
    /// Most memory for frames that wait for the disk, 16 to 65536 MB of 10^6 bytes.
    pub max_queue_mb: u32,
}

/// How the daemon logs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// Lines for people.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

impl CaptureConfig {
    /// Reads a configuration file. Relative paths in it are relative to its folder.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no TOML, or has a key or a value that is not allowed; the error names the line.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let read = |source| ConfigError::Read {
            path: path.to_owned(),
            source,
        };
        let mut text = String::new();
        let file = File::open(path).map_err(read)?;
        let n_bytes = file.take(FILE_MAX_BYTES + 1).read_to_string(&mut text).map_err(read)?;
        if n_bytes as u64 > FILE_MAX_BYTES {
            return Err(ConfigError::TooLong {
                path: path.to_owned(),
                max_bytes: FILE_MAX_BYTES,
            });
        }
        Self::parse(&text, path)
    }

    /// Reads the text of a configuration file; `path` is used in errors and for relative paths.
    ///
    /// # Errors
    ///
    /// As [`Self::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let document = document::Document::parse(path, text)?;
        check::check(&document, document.read()?)
    }

    /// The camera with the role `scene`.
    #[must_use]
    pub fn leader(&self) -> &CameraConfig {
        &self.cameras[self.lockstep.leader]
    }

    /// What is configured, in some lines for people.
    #[must_use]
    pub fn describe(&self) -> String {
        describe::describe(self)
    }
}

#[cfg(test)]
mod tests;
