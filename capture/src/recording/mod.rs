//! Image-folder recordings: a rig file, a frame list and one picture per frame.
//!
//! ```text
//! DIR/rig.toml      name, role and size_px of every camera (all else in it is for others)
//! DIR/frames.csv    camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b
//! DIR/<file>        8-bit RGB pictures, PNG or JPEG
//! ```
//!
//! Everything but the pictures is checked when a recording is opened; pictures are read one at a time while it plays.

mod format;
pub mod mcap;
mod picture;
mod player;
mod rig;

pub use player::{Pace, Player, Repeat};
