//! Where finished frames go.

pub mod environment;
pub mod file;
pub mod screen;
pub mod window;

use crate::error::RenderError;
use crate::node::{RenderNode, RenderedFrame};

/// A place for finished frames.
pub trait Sink {
    /// Takes a frame; `node` still holds the light that it was rendered with.
    ///
    /// # Errors
    /// When the frame cannot be stored or shown.
    fn take(&mut self, frame: &RenderedFrame, node: &RenderNode) -> Result<(), RenderError>;
}
