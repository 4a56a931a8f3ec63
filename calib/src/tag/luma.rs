//! Grey pictures in somebody's memory.

use std::fmt;

/// Largest width, height or stride that the detector takes, in pixels or bytes.
const MAX_SIDE: usize = 32_767;

/// A grey picture in somebody's memory: 8 bits, rows from the top, `stride` bytes from row to row and `step` from pixel to
/// pixel. A camera's buffer as it is: a step of 1 for GREY and for the first plane of NV12, of 2 for YUYV.
#[derive(Clone, Copy)]
pub struct LumaView<'a> {
    width: usize,
    height: usize,
    stride: usize,
    step: usize,
    pixels: &'a [u8],
}

/// Why bytes are not a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LumaError {
    /// A dimension is too large.
    #[error(
        "the picture has `{width}×{height}` pixels and a stride of `{stride}` bytes (allowed: at most `32767` each)"
    )]
    TooLarge {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes from row to row.
        stride: usize,
    },
    /// Rows would overlap.
    #[error("the stride is `{stride}` bytes (allowed: at least a row's `{row}`)")]
    Stride {
        /// Bytes of a row: columns times bytes from pixel to pixel.
        row: usize,
        /// Bytes from row to row.
        stride: usize,
    },
    /// Pixels would be the same one.
    #[error("pixels are `0` bytes apart (allowed: at least `1`)")]
    Step,
    /// Bytes are missing.
    #[error("the picture has `{found}` bytes (needed: `{needed}`)")]
    TooShort {
        /// Bytes there are.
        found: usize,
        /// Bytes there should be.
        needed: usize,
    },
}

impl<'a> LumaView<'a> {
    /// Looks at bytes as at a picture, one byte per pixel.
    ///
    /// # Errors
    /// As [`Self::with_step`].
    pub fn new(size: [usize; 2], stride: usize, pixels: &'a [u8]) -> Result<Self, LumaError> {
        Self::with_step(size, stride, 1, pixels)
    }

    /// Looks at bytes as at a picture whose pixels are `step` bytes apart, the first byte the first pixel.
    ///
    /// # Errors
    /// When a dimension exceeds 32767, rows or pixels would overlap, or bytes are missing; the last row needs no padding.
    pub fn with_step(size: [usize; 2], stride: usize, step: usize, pixels: &'a [u8]) -> Result<Self, LumaError> {
        let [width, height] = size;
        check_sides(size, stride)?;
        if step == 0 {
            return Err(LumaError::Step);
        }
        let row = width.saturating_mul(step);
        if stride < row {
            return Err(LumaError::Stride { row, stride });
        }
        let needed = match (width, height) {
            (0, _) | (_, 0) => 0,
            _ => stride * (height - 1) + (width - 1) * step + 1,
        };
        if pixels.len() < needed {
            return Err(LumaError::TooShort {
                found: pixels.len(),
                needed,
            });
        }
        Ok(Self {
            width,
            height,
            stride,
            step,
            pixels,
        })
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Bytes from row to row.
    #[must_use]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Bytes from pixel to pixel.
    #[must_use]
    pub fn step(&self) -> usize {
        self.step
    }

    /// The bytes of a row, from its first pixel to its last one; pixels are [`Self::step`] bytes apart.
    ///
    /// # Panics
    /// For a row beyond the last one.
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        assert!(y < self.height, "row {y} of {}", self.height);
        let start = y * self.stride;
        &self.pixels[start..start + self.width.saturating_sub(1) * self.step + usize::from(self.width > 0)]
    }

    /// All bytes, from the first pixel on.
    pub(super) fn bytes(&self) -> &'a [u8] {
        self.pixels
    }

    /// A pixel.
    ///
    /// # Panics
    /// For a row beyond the last one; a column beyond the last one panics or gives another row's pixel.
    #[must_use]
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> u8 {
        self.pixels[y * self.stride + x * self.step]
    }
}

impl fmt::Debug for LumaView<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "LumaView({}×{}, stride {}, step {})",
            self.width, self.height, self.stride, self.step
        )
    }
}

/// Whether the detector can take a picture of this size.
pub(super) fn check_sides([width, height]: [usize; 2], stride: usize) -> Result<(), LumaError> {
    if width.max(height).max(stride) > MAX_SIDE {
        return Err(LumaError::TooLarge { width, height, stride });
    }
    Ok(())
}
