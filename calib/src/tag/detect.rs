//! Picture to markers.

use std::fmt;

use glam::DVec2;

use super::{Family, LumaView, apriltag::Library};

/// Smallest width and height in which a marker can be found: ten cells of a pixel and a half, black border and white.
const MIN_SIDE: usize = 15;

/// Widest border, in cells.
const MAX_BORDER: u32 = 8;

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
        // The library knows no pixels that are apart.
        let rows = (0..luma.height()).flat_map(|y| (0..luma.width()).map(move |x| luma.at(x, y)));
        let close: Vec<u8> = if luma.step() == 1 { Vec::new() } else { rows.collect() };
        let luma = if luma.step() == 1 {
            luma
        } else {
            LumaView::new([luma.width(), luma.height()], luma.width(), &close).expect("a picture made of one")
        };
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
