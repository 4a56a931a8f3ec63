//! Frames to markers.

use super::{Detection, Detector, Family, LinearLuma, LumaError, refine_corners};
use crate::rig::Camera;

/// Finds the markers in the frames of a camera: linearises, detects, refines the corners. Keeps its buffers.
#[derive(Debug)]
pub struct Finder {
    detector: Detector,
    luma: LinearLuma,
}

/// Why a picture cannot be searched.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    /// The picture is not of the size that the camera was calibrated for.
    #[error(
        "a picture of camera `{camera}` has `{found_width}×{found_height}` pixels (its rig entry says: `{width}×{height}`)"
    )]
    Size {
        /// Name of the camera.
        camera: String,
        /// Columns found.
        found_width: usize,
        /// Rows found.
        found_height: usize,
        /// Columns expected.
        width: u32,
        /// Rows expected.
        height: u32,
    },
    /// The bytes are not a picture.
    #[error("a picture of camera `{camera}` cannot be read")]
    Luma {
        /// Name of the camera.
        camera: String,
        /// What is wrong with the bytes.
        source: LumaError,
    },
}

impl Finder {
    /// A finder for these families.
    #[must_use]
    pub fn new(families: &[Family]) -> Self {
        Self {
            detector: Detector::new(families),
            luma: LinearLuma::new(),
        }
    }

    /// Finds the markers in a picture of `size` columns and rows, three bytes per pixel (red, green, blue), as the
    /// camera encoded them. Ordered as by [`Detector::detect`].
    ///
    /// # Errors
    /// When the size is not the camera's or bytes are missing.
    pub fn find(&mut self, rgb: &[u8], size: [usize; 2], camera: &Camera) -> Result<Vec<Detection>, PictureError> {
        let [width, height] = camera.intrinsics.size_px;
        if size != [width as usize, height as usize] {
            return Err(PictureError::Size {
                camera: camera.name.clone(),
                found_width: size[0],
                found_height: size[1],
                width,
                height,
            });
        }
        self.luma
            .set(rgb, size, &camera.photometry.response)
            .map_err(|source| PictureError::Luma {
                camera: camera.name.clone(),
                source,
            })?;
        let mut detections = self.detector.detect(self.luma.luma());
        for detection in &mut detections {
            detection.corners_px = refine_corners(&self.luma, &camera.intrinsics, detection.corners_px);
        }
        Ok(detections)
    }
}
