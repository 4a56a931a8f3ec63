//! Recordings, of two kinds: image folders, for pictures made or looked at one by one, and [MCAP files](mcap), for all
//! that cameras send.
//!
//! An image folder is a rig file, a frame list and one picture per frame:
//!
//! ```text
//! DIR/rig.toml      name, role and size_px of every camera (all else in it is for others)
//! DIR/frames.csv    camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b
//! DIR/<file>        8-bit RGB pictures, PNG or JPEG
//! ```
//!
//! Everything but the pictures is checked when a recording is opened; pictures are read one at a time while it plays.

mod folder_writer;
mod format;
pub mod mcap;
mod pace;
mod picture;
mod player;
mod report;
mod rig;

pub use folder_writer::{FolderError, FolderWriter};
pub use pace::{Pace, Repeat};
pub use player::Player;
pub use report::{CameraReport, Gap, RecordingReport, report_on};
pub use rig::read_cameras;

use std::path::Path;

use crate::source::{Source, SourceError};

/// Opens a recording of either kind: a folder, or an MCAP file.
///
/// # Errors
///
/// Any [`SourceError`] that is not skippable.
pub fn open_recording(path: &Path, pace: Pace, repeat: Repeat) -> Result<Box<dyn Source>, SourceError> {
    if path.is_file() {
        return Ok(Box::new(mcap::McapPlayer::open(path, pace, repeat)?));
    }
    Ok(Box::new(Player::open(path, pace, repeat)?))
}
