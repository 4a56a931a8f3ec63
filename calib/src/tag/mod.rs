//! Markers in pictures: linearise, detect, refine.
//!
//! [`Finder`] does all three for a camera's frames. The parts can be used alone.

mod apriltag;
mod detect;
mod family;
mod finder;
mod linearise;
mod refine;

pub use detect::{Detection, Detector, LumaError, LumaView};
pub use family::{DictionarySize, Family, UnknownFamily};
pub use finder::{Finder, PictureError};
pub use linearise::LinearLuma;
pub use refine::refine_corners;
