//! Markers in pictures: linearise, detect, refine.
//!
//! [`Finder`] does all three for a camera's frames. The parts can be used alone.

mod apriltag;
mod codebook;
mod detect;
mod family;
mod finder;
mod layout;
mod light;
mod linearise;
mod luma;
mod refine;

pub use codebook::{Codebook, Match};
pub use detect::{Detection, Detector};
pub use family::{DictionarySize, Family, UnknownFamily};
pub use finder::{Finder, PictureError};
pub use layout::{Cell, Layout};
pub use light::{EncodedLuma, EncodedRgb, LightPicture};
pub use linearise::LinearLuma;
pub use luma::{LumaError, LumaView};
pub use refine::refine_corners;
