//! What a frame is: pixels as the camera encoded them, and the truth about how they were taken.

use std::sync::Arc;

/// Width and height of a picture in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Size {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// Layout of a frame's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// Three bytes per pixel, red first, rows from the top without padding, encoded by the camera's response curve.
    Rgb8,
}

/// Exposure and white balance in force when a frame was taken, not the ones requested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Exposure time in seconds, above 0.
    pub time_s: f64,
    /// Analogue gain, linear, above 0; 1 means none.
    pub gain: f64,
    /// Linear white-balance gains of red, green and blue, above 0.
    pub white_balance: [f64; 3],
}

/// Who took a frame, when and how.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameMeta {
    /// Name of the camera, as in the rig file.
    pub camera: Arc<str>,
    /// The driver's own count; gaps are lost frames.
    pub sequence: u64,
    /// Capture time in nanoseconds on one monotonic clock shared by all cameras of the rig.
    pub timestamp_ns: u64,
    /// Exposure in force when the frame was taken.
    pub exposure: Exposure,
}

/// One picture of one camera. Immutable once made; a clone shares the pixels.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Who, when, how.
    pub meta: FrameMeta,
    /// Width and height.
    pub size: Size,
    /// Layout of `pixels`.
    pub format: PixelFormat,
    /// The bytes, `size.pixels() * 3` of them for [`PixelFormat::Rgb8`].
    pub pixels: Arc<[u8]>,
}

/// Frames that belong together: one of the leading camera and, of every other camera, the one nearest to it in time.
#[derive(Debug, Clone)]
pub struct FrameSet {
    /// The leading camera's frame first.
    pub frames: Vec<Frame>,
}

impl FrameSet {
    /// The frame of the camera with this name, if the set has one.
    #[must_use]
    pub fn camera(&self, name: &str) -> Option<&Frame> {
        self.frames.iter().find(|frame| &*frame.meta.camera == name)
    }
}
