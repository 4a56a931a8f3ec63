//! What a frame is: pixels as the camera encoded them, and the truth about how they were taken.

use std::ops::Deref;
use std::sync::Arc;

use bytes::Bytes;

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

/// Layout of a frame's bytes: rows from the top without padding, samples encoded by the camera's response curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// Three bytes per pixel, red first.
    Rgb8,
    /// One byte per pixel, luma over the full range.
    Grey8,
    /// Two bytes per pixel: Y0 Cb Y1 Cr for two pixels side by side; the width is even.
    Yuyv(Ycbcr),
    /// A plane of Y, then one of Cb Cr pairs at half the size; width and height are even.
    Nv12(Ycbcr),
    /// One JPEG picture.
    Mjpeg,
}

impl PixelFormat {
    /// Most bytes a frame of this format and size may have; exactly as many for every format but [`Self::Mjpeg`].
    ///
    /// A JPEG picture with more than three bytes per pixel is none that a camera would send.
    #[must_use]
    pub fn max_bytes(self, size: Size) -> usize {
        match self {
            Self::Rgb8 | Self::Mjpeg => size.pixels() * 3,
            Self::Grey8 => size.pixels(),
            Self::Yuyv(_) => size.pixels() * 2,
            Self::Nv12(_) => size.pixels() / 2 * 3,
        }
    }

    /// True if frames of this format can have this size and this many bytes.
    #[must_use]
    pub fn admits(self, size: Size, n_bytes: usize) -> bool {
        let is_even = |side: u32| side.is_multiple_of(2);
        match self {
            Self::Rgb8 | Self::Grey8 => n_bytes == self.max_bytes(size),
            Self::Yuyv(_) => is_even(size.width) && n_bytes == self.max_bytes(size),
            Self::Nv12(_) => is_even(size.width) && is_even(size.height) && n_bytes == self.max_bytes(size),
            Self::Mjpeg => (1..=self.max_bytes(size)).contains(&n_bytes),
        }
    }
}

/// How luma and colour difference become red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Ycbcr {
    /// Weights of red, green and blue in luma.
    pub matrix: YcbcrMatrix,
    /// Codes of black and white.
    pub range: YcbcrRange,
}

/// Weights of red, green and blue in luma.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum YcbcrMatrix {
    /// ITU-R BT.601: webcams, JPEG.
    Bt601,
    /// ITU-R BT.709: high definition.
    Bt709,
}

/// Codes of black and white.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum YcbcrRange {
    /// Luma 16 to 235, colour differences 16 to 240.
    Limited,
    /// 0 to 255.
    Full,
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

/// What the driver said about a frame's buffer: the flags of `struct v4l2_buffer`, as they are; 0 for recordings
/// that do not keep them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct BufferFlags(pub u32);

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
    /// Linear factors for red, green and blue that take this frame from its own exposure to the one that all frames
    /// of its set should have had: what the steps of the camera's controls have left over. 1 for nothing.
    pub residual: [f64; 3],
    /// Which exposure of a bracket this is, counted from 0; 0 without a bracket.
    pub bracket_step: u32,
    /// Frames of this camera that are known to be lost between the frame before and this one, whatever the cause.
    pub lost_before: u32,
    /// What the driver said about the frame.
    pub flags: BufferFlags,
}

impl FrameMeta {
    /// The description of a frame of which nothing more is known: no residual, no bracket, nothing lost.
    #[must_use]
    pub fn new(camera: Arc<str>, sequence: u64, timestamp_ns: u64, exposure: Exposure) -> Self {
        Self {
            camera,
            sequence,
            timestamp_ns,
            exposure,
            residual: [1.0; 3],
            bracket_step: 0,
            lost_before: 0,
            flags: BufferFlags::default(),
        }
    }
}

/// The bytes of a picture, wherever they lie. Immutable; a clone shares them; they are given back with the last clone.
#[derive(Debug, Clone)]
pub struct Pixels {
    bytes: Bytes,
    place: Option<SharedPlace>,
}

/// Where pixels lie in shared memory: which publisher's, and their running number there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct SharedPlace {
    pub(crate) publisher: u128,
    pub(crate) number: u64,
}

impl Pixels {
    /// Pixels that someone else keeps and takes back when the last clone is dropped: a pool, shared memory.
    pub fn from_owner(owner: impl AsRef<[u8]> + Send + 'static) -> Self {
        Self {
            bytes: Bytes::from_owner(owner),
            place: None,
        }
    }

    /// The same, for bytes that readers in other processes can already see at `place`.
    pub(crate) fn from_shared(owner: impl AsRef<[u8]> + Send + 'static, place: SharedPlace) -> Self {
        Self {
            bytes: Bytes::from_owner(owner),
            place: Some(place),
        }
    }

    /// The same bytes under another owner, not copied.
    pub(crate) fn shared_bytes(&self) -> Bytes {
        self.bytes.clone()
    }

    /// Where other processes find them, if they can.
    pub(crate) fn place(&self) -> Option<SharedPlace> {
        self.place
    }
}

impl Deref for Pixels {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl From<Vec<u8>> for Pixels {
    fn from(bytes: Vec<u8>) -> Self {
        Self {
            bytes: bytes.into(),
            place: None,
        }
    }
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
    /// The bytes, as many as [`PixelFormat::admits`].
    pub pixels: Pixels,
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

    /// By how much the frame with this index was taken after the leading one, in nanoseconds; negative is before.
    /// None if the set has no such frame.
    #[must_use]
    pub fn skew_ns(&self, frame_index: usize) -> Option<i64> {
        let leader_ns = self.frames.first()?.meta.timestamp_ns;
        let frame_ns = self.frames.get(frame_index)?.meta.timestamp_ns;
        Some(frame_ns.wrapping_sub(leader_ns).cast_signed())
    }
}
