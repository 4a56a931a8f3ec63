//! MCAP recordings: the frames as the cameras sent them, with all that is known about each, in one file.
//!
//! ```text
//! metadata `mirrorball`      version of the format, program, cameras
//! attachments                `rig.toml`, `capture.toml`, when given
//! /<camera>/frame            ours: who, when, how (JSON with a JSON schema)
//! /<camera>/image            foxglove.RawImage or foxglove.CompressedImage (protobuf)
//! /events                    ours: losses, controls, notes (JSON with a JSON schema)
//! ```
//!
//! A frame is two messages with its time stamp, first `frame`, then `image`, in one chunk. Chunks carry a check sum and
//! are finished and synchronised often, so a file that ends anywhere is read up to its last whole chunk.
//!
//! `configs/README.md` documents all fields.

mod chunk;
mod error;
mod file;
mod image;
mod layout;
mod output;
mod player;
mod read_error;
mod recorder;
mod records;
mod rounds;
pub(super) mod scan;
mod survey;
mod threads;
mod writer;

pub use error::{Kept, RecordError};
pub use file::Ending;
pub use layout::{EventKind, RecordingEvent};
pub(super) use layout::{format_name, role_name};
pub use player::{McapPlayer, McapPlayerStats};
pub use read_error::McapReadError;
pub use recorder::{ChunkCompression, Recorded, Recorder, RecorderOptions, RecorderStats};
