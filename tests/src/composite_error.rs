//! Error of the composites against the path-traced references, by region.
//!
//! | region | pixels |
//! | --- | --- |
//! | object | mask > 127; per virtual object also label = its label |
//! | shadow | shadow ratio 1 to 190 (a receiver darkened by at least 5 %) and mask = 0 |
//! | unchanged | shadow ratio 198 to 202 and mask = 0 |
//! | outside | the pixel and its eight neighbours have mask = 0 and the label of no phantom |

use crate::{
    ToolError,
    flip::FlipMap,
    outputs::Outputs,
    picture,
    psnr::Psnr,
    truth::{MaterialKind, Reference, Truth},
};
use image::{GrayImage, RgbImage};
use serde::Serialize;

/// Error of one composite against its reference.
#[derive(Clone, Debug, Serialize)]
pub struct CompositeError {
    /// Sequence number of the scene frame.
    pub frame: u32,
    /// All virtual objects.
    pub object: RegionError,
    /// Each virtual object.
    pub objects: Vec<ObjectError>,
    /// Where virtual objects darken real things.
    pub shadow: RegionError,
    /// Receivers that the virtual objects leave as they are.
    pub unchanged: RegionError,
    /// The whole picture.
    pub whole: RegionError,
    /// Composite against the camera's own frame over the unchanged region; `None` when it is empty.
    pub unchanged_against_camera: Option<Psnr>,
    /// Number of pixels outside every phantom and virtual object.
    pub outside_pixels: usize,
    /// How many of them are not the camera's, bit for bit.
    pub outside_pixels_changed: usize,
}

/// Error over a region; the figures are `None` when it is empty.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RegionError {
    /// Number of pixels.
    pub pixels: usize,
    /// Composite against the reference.
    pub psnr_db: Option<Psnr>,
    /// The camera's own frame against the reference.
    pub untouched_psnr_db: Option<Psnr>,
    /// Mean FLIP of the composite.
    pub flip: Option<f64>,
    /// Mean FLIP of the camera's own frame.
    pub untouched_flip: Option<f64>,
}

/// Error over one virtual object.
#[derive(Clone, Debug, Serialize)]
pub struct ObjectError {
    /// Its name.
    pub name: String,
    /// What it is made of.
    pub material: MaterialKind,
    /// Error over its pixels.
    #[serde(flatten)]
    pub region: RegionError,
}

/// Compares the composites of all frames that have a reference.
///
/// # Errors
/// When a composite or a picture of the truth is missing, cannot be decoded, or has the wrong size or kind.
pub fn measure(outputs: &Outputs, truth: &Truth) -> Result<Vec<CompositeError>, ToolError> {
    let references = truth.references.iter();
    references
        .map(|reference| {
            Ok(compare(
                &Pictures::load(outputs, truth, reference)?,
                truth,
                reference.frame,
            ))
        })
        .collect()
}

/// The pictures of one frame, all of one size.
struct Pictures {
    composite: RgbImage,
    with: RgbImage,
    without: RgbImage,
    mask: GrayImage,
    labels: GrayImage,
    shadow_ratio: GrayImage,
}

impl Pictures {
    fn load(outputs: &Outputs, truth: &Truth, reference: &Reference) -> Result<Self, ToolError> {
        let (frame, size_px) = (reference.frame, truth.size_px);
        let paths = truth.reference_paths(reference);
        let role = |what: &str| format!("the {what} of frame {frame}");
        Ok(Self {
            composite: picture::read_rgb(&outputs.composite_path(frame), &role("composite"), size_px)?,
            with: picture::read_rgb(&paths.with, &role("reference"), size_px)?,
            without: picture::read_rgb(&paths.without, &role("camera's picture"), size_px)?,
            mask: picture::read_grey(&paths.mask, &role("mask"), size_px)?,
            labels: picture::read_grey(&paths.labels, &role("label picture"), size_px)?,
            shadow_ratio: picture::read_grey(&paths.shadow_ratio, &role("shadow ratio"), size_px)?,
        })
    }

    /// Returns the pixels whose mask, label and shadow ratio satisfy a condition, in row order.
    fn region(&self, inside: impl Fn(u8, u8, u8) -> bool) -> Vec<bool> {
        let pixels = self.mask.iter().zip(self.labels.iter()).zip(self.shadow_ratio.iter());
        pixels
            .map(|((&mask, &label), &ratio)| inside(mask, label, ratio))
            .collect()
    }
}

/// Measures one composite.
fn compare(pictures: &Pictures, truth: &Truth, frame: u32) -> CompositeError {
    let flip = FlipMap::of(&pictures.composite, &pictures.with);
    let untouched_flip = FlipMap::of(&pictures.without, &pictures.with);
    let error_over = |region: &[bool]| RegionError {
        pixels: region.iter().filter(|inside| **inside).count(),
        psnr_db: Psnr::of(&pictures.composite, &pictures.with, region),
        untouched_psnr_db: Psnr::of(&pictures.without, &pictures.with, region),
        flip: flip.mean(region),
        untouched_flip: untouched_flip.mean(region),
    };
    let objects = truth.virtual_objects.iter().map(|object| ObjectError {
        name: object.name.clone(),
        material: object.material.kind,
        region: error_over(&pictures.region(|mask, label, _| mask > 127 && label == object.label)),
    });
    let unchanged = pictures.region(|mask, _, ratio| (198..=202).contains(&ratio) && mask == 0);
    let outside = outside(pictures, &truth.background_labels);
    let pixels = pictures.composite.pixels().zip(pictures.without.pixels()).zip(&outside);
    CompositeError {
        frame,
        object: error_over(&pictures.region(|mask, _, _| mask > 127)),
        objects: objects.collect(),
        shadow: error_over(&pictures.region(|mask, _, ratio| (1..=190).contains(&ratio) && mask == 0)),
        unchanged: error_over(&unchanged),
        whole: error_over(&pictures.region(|_, _, _| true)),
        unchanged_against_camera: Psnr::of(&pictures.composite, &pictures.without, &unchanged),
        outside_pixels: outside.iter().filter(|outside| **outside).count(),
        outside_pixels_changed: pixels
            .filter(|((found, camera), outside)| **outside && found != camera)
            .count(),
    }
}

/// Returns the pixels outside every phantom and virtual object, one pixel of margin included: a label is one sample of
/// the pixel, so a phantom may cover part of the pixel beside its labels.
fn outside(pictures: &Pictures, background_labels: &[u8]) -> Vec<bool> {
    let free = pictures.region(|mask, label, _| mask == 0 && background_labels.contains(&label));
    let (width, height) = (pictures.mask.width() as usize, pictures.mask.height() as usize);
    let mut outside = Vec::with_capacity(free.len());
    for row in 0..height {
        for column in 0..width {
            let rows = row.saturating_sub(1)..(row + 2).min(height);
            let columns = column.saturating_sub(1)..(column + 2).min(width);
            outside.push(rows.into_iter().all(|r| columns.clone().all(|c| free[r * width + c])));
        }
    }
    outside
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Luma, Rgb};

    /// Ten columns: background 0 to 2, table 3 to 9, an object in 5 and 6, its shadow in 7 and 8.
    fn pictures() -> Pictures {
        let grey = |values: [u8; 10]| GrayImage::from_fn(10, 3, |x, _| Luma([values[x as usize]]));
        let rgb = |values: [u8; 10]| RgbImage::from_fn(10, 3, |x, _| Rgb([values[x as usize]; 3]));
        let without = rgb([10, 10, 10, 80, 80, 80, 80, 80, 80, 80]);
        let with = rgb([10, 10, 10, 80, 80, 200, 200, 50, 50, 80]);
        Pictures {
            composite: with.clone(),
            with,
            without,
            mask: grey([0, 0, 0, 0, 0, 255, 255, 0, 0, 0]),
            labels: grey([1, 1, 1, 10, 10, 100, 100, 10, 10, 10]),
            shadow_ratio: grey([0, 0, 0, 200, 200, 0, 0, 120, 120, 200]),
        }
    }

    fn truth() -> Truth {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/data/moving_lamp/truth");
        Truth::load(folder.as_ref()).unwrap()
    }

    #[test]
    fn the_reference_itself_is_perfect_and_the_camera_is_not() {
        let error = compare(&pictures(), &truth(), 3);
        assert_eq!(error.object.psnr_db, Some(Psnr(f64::INFINITY)));
        assert_eq!(error.object.flip, Some(0.0));
        assert_eq!(
            (error.object.pixels, error.shadow.pixels, error.unchanged.pixels),
            (6, 6, 9)
        );
        assert_eq!(error.objects[0].region.pixels, 6);
        assert_eq!(error.objects[1].region.psnr_db, None);
        let shadow_db = error.shadow.untouched_psnr_db.unwrap().0;
        assert!((shadow_db - 20.0 * (255.0_f64 / 30.0).log10()).abs() < 1e-12);
        assert_eq!((error.outside_pixels, error.outside_pixels_changed), (6, 0));
    }

    #[test]
    fn a_changed_background_pixel_is_counted_beyond_the_margin() {
        let mut pictures = pictures();
        pictures.composite.put_pixel(0, 1, Rgb([10, 11, 10]));
        pictures.composite.put_pixel(2, 1, Rgb([99, 99, 99]));
        assert_eq!(compare(&pictures, &truth(), 3).outside_pixels_changed, 1);
    }
}
