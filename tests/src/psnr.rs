//! Peak signal-to-noise ratio over a region of 8-bit pictures.

use image::RgbImage;
use serde::{Serialize, Serializer};
use std::fmt;

/// Peak signal-to-noise ratio in dB: 10 log10(255² / mean squared difference of 8-bit codes over pixels and channels).
///
/// Infinite for identical pictures; written `inf` in text and `"inf"` in JSON, which has no infinite number.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Psnr(pub f64);

impl Psnr {
    /// Compares the pixels of a region, given by pixel in row order; `None` when the region has no pixel.
    ///
    /// # Panics
    /// When the pictures or the region differ in size; callers load them with one expected size.
    pub fn of(picture: &RgbImage, reference: &RgbImage, region: &[bool]) -> Option<Self> {
        assert_eq!(picture.dimensions(), reference.dimensions());
        assert_eq!(picture.pixels().len(), region.len());
        let mut squares = 0_u64;
        let mut pixels = 0_u64;
        for ((pixel, reference), _) in picture
            .pixels()
            .zip(reference.pixels())
            .zip(region)
            .filter(|(_, inside)| **inside)
        {
            let differences = pixel.0.iter().zip(reference.0).map(|(&a, b)| u64::from(a.abs_diff(b)));
            squares += differences.map(|difference| difference * difference).sum::<u64>();
            pixels += 1;
        }
        (pixels > 0).then(|| Self(10.0 * (255.0 * 255.0 * 3.0 * pixels as f64 / squares as f64).log10()))
    }
}

impl fmt::Display for Psnr {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_infinite() {
            formatter.pad("inf")
        } else {
            formatter.pad(&format!("{:.1}", self.0))
        }
    }
}

impl Serialize for Psnr {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_infinite() {
            serializer.serialize_str("inf")
        } else {
            serializer.serialize_f64(self.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_known_difference_gives_the_formula() {
        let reference = RgbImage::from_pixel(4, 2, Rgb([100, 100, 100]));
        let mut picture = reference.clone();
        picture.put_pixel(0, 0, Rgb([110, 90, 100]));
        let psnr = Psnr::of(&picture, &reference, &[true; 8]).unwrap();
        assert!((psnr.0 - 10.0 * (65025.0 * 24.0 / 200.0_f64).log10()).abs() < 1e-12);
        let mut elsewhere = [true; 8];
        elsewhere[0] = false;
        assert_eq!(Psnr::of(&picture, &reference, &elsewhere).unwrap().0, f64::INFINITY);
        assert_eq!(Psnr::of(&picture, &reference, &[false; 8]), None);
        assert_eq!(serde_json::to_string(&Psnr(f64::INFINITY)).unwrap(), "\"inf\"");
    }
}
