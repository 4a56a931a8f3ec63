//! Picture to markers.

use std::fmt;

use glam::DVec2;

use super::{Family, apriltag::Library};

/// Largest width, height or stride that the detector takes, in pixels or bytes.
const MAX_SIDE: usize = 32_767;

/// Smallest width and height in which a marker can be found: ten cells of a pixel and a half, black border and white.
const MIN_SIDE: usize = 15;

/// Widest border, in cells.
const MAX_BORDER: u32 = 8;

/// A grey picture in somebody's memory: 8 bits, rows from the top, `stride` bytes from row to row.
#[derive(Clone, Copy)]
pub struct LumaView<'a> {
    width: usize,
    height: usize,
    stride: usize,
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
    #[error("the stride is `{stride}` bytes (allowed: at least the width, `{width}`)")]
    Stride {
        /// Columns.
        width: usize,
        /// Bytes from row to row.
        stride: usize,
    },
    /// Bytes are missing.
    #[error("the picture has `{found}` bytes (needed: stride times height, `{needed}`)")]
    TooShort {
        /// Bytes there are.
        found: usize,
        /// Bytes there should be.
        needed: usize,
    },
}

impl<'a> LumaView<'a> {
    /// Looks at bytes as at a picture.
    ///
    /// # Errors
    /// When a dimension exceeds 32767, the stride is below the width, or there are fewer than `stride × height` bytes.
    pub fn new(size: [usize; 2], stride: usize, pixels: &'a [u8]) -> Result<Self, LumaError> {
        let [width, height] = size;
        check_sides(size, stride)?;
        if stride < width {
            return Err(LumaError::Stride { width, stride });
        }
        let needed = stride * height;
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

    /// The bytes, at least `stride × height` of them.
    #[must_use]
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }
}

impl fmt::Debug for LumaView<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "LumaView({}×{}, stride {})",
            self.width, self.height, self.stride
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

/// A marker in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Family of the code.
    pub family: Family,
    /// Number of the code in its family.
    pub id: u32,
    /// Wrong bits that were corrected.
    pub hamming: u32,
    /// Mean difference between the cells' grey values and the decision threshold, in grey levels; larger is surer.
    pub decision_margin: f64,
    /// Corners of the black square in pixels (integers are pixel centres): bottom-left, bottom-right, top-right,
    /// top-left of the upright marker.
    pub corners_px: [DVec2; 4],
}

impl Detection {
    /// Mean length of the four sides in pixels.
    #[must_use]
    pub fn mean_side_px(&self) -> f64 {
        let [a, b, c, d] = self.corners_px;
        0.25 * (a.distance(b) + b.distance(c) + c.distance(d) + d.distance(a))
    }
}

/// Finds markers in grey pictures. Corners are exact where grey values are proportional to light, see
/// [`LinearLuma`](super::LinearLuma): in gamma-encoded pictures they lie about 0.4 pixels too far inside.
pub struct Detector {
    library: Library,
}

impl Detector {
    /// A detector for these families.
    #[must_use]
    pub fn new(families: &[Family]) -> Self {
        Self::with_border(families, 1)
    }

    /// A detector for markers whose black border is so many cells wide; at most 8.
    #[must_use]
    pub fn with_border(families: &[Family], border_bits: u32) -> Self {
        Self {
            library: Library::new(families, border_bits.min(MAX_BORDER)),
        }
    }

    /// Finds the markers in a picture, ordered by family, id and position, so that equal pictures give equal lists.
    ///
    /// One id may appear more than once: which one is the rig's marker is for the pose to decide.
    /// A picture with a side below 15 pixels has none.
    pub fn detect(&mut self, luma: LumaView<'_>) -> Vec<Detection> {
        let mut detections = Vec::new();
        if self.library.has_families() && luma.width().min(luma.height()) >= MIN_SIDE {
            self.library.detect(luma, &mut detections);
        }
        detections.sort_by(|a, b| {
            let position = |detection: &Detection| detection.corners_px[0];
            (a.family, a.id)
                .cmp(&(b.family, b.id))
                .then(position(a).y.total_cmp(&position(b).y))
                .then(position(a).x.total_cmp(&position(b).x))
        });
        detections
    }
}

impl fmt::Debug for Detector {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Detector")
    }
}
