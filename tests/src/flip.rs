//! Perceptual difference of pictures: FLIP (Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images").

use image::RgbImage;

/// FLIP by pixel, row by row: 0 for no visible difference, 1 for the greatest.
#[derive(Clone, Debug)]
pub struct FlipMap {
    errors: Vec<f32>,
}

impl FlipMap {
    /// Compares two pictures as seen with 67 pixels per degree, the authors' default.
    ///
    /// # Panics
    /// When the pictures differ in size; callers load them with one expected size.
    pub fn of(picture: &RgbImage, reference: &RgbImage) -> Self {
        let [picture, reference] = [picture, reference]
            .map(|picture| nv_flip::FlipImageRgb8::with_data(picture.width(), picture.height(), picture.as_raw()));
        Self {
            errors: nv_flip::flip(reference, picture, nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec(),
        }
    }

    /// Returns the mean over a region, given by pixel in row order; `None` when the region has no pixel.
    pub fn mean(&self, region: &[bool]) -> Option<f64> {
        let inside = || self.errors.iter().zip(region).filter(|(_, inside)| **inside);
        let sum: f64 = inside().map(|(&error, _)| f64::from(error)).sum();
        let pixels = inside().count();
        (pixels > 0).then(|| sum / pixels as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn identical_pictures_have_no_difference_and_opposite_ones_the_greatest() {
        let red = RgbImage::from_fn(32, 24, |x, y| Rgb([200, (x * 8) as u8, (y * 8) as u8]));
        let region = [true; 32 * 24];
        assert_eq!(FlipMap::of(&red, &red).mean(&region), Some(0.0));
        let [black, white] = [0, 255].map(|code| RgbImage::from_pixel(32, 24, Rgb([code; 3])));
        assert!(FlipMap::of(&black, &white).mean(&region).unwrap() > 0.9);
        assert_eq!(FlipMap::of(&red, &red).mean(&[false; 32 * 24]), None);
    }
}
