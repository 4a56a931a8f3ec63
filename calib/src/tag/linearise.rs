//! Pictures proportional to light, which is where edges are found without bias.

use crate::response::ResponseCurve;

use super::{LumaError, LumaView, luma::check_sides};

/// Weights of red, green and blue in a grey value, in quarters. Green counts twice: sensors sample it twice as densely.
const WEIGHTS: [u32; 3] = [1, 2, 1];

/// Fraction of the pixels that may be brighter than [`WELL_EXPOSED`] in the 8-bit picture: lamps and their reflections.
const BRIGHTEST_FRACTION: f64 = 0.02;

/// 8-bit value that the brightest pixels but [`BRIGHTEST_FRACTION`] get.
const WELL_EXPOSED: f64 = 230.0;

/// Histogram bins per factor of the 16-bit range; 16 values share a bin.
const BIN_SHIFT: u32 = 4;

/// A grey picture proportional to light, as 16 bits for measuring edges and as 8 bits, scaled so that white paper is
/// well exposed, for finding markers. Its buffers are reused from picture to picture.
#[derive(Debug, Clone, Default)]
pub struct LinearLuma {
    size: [usize; 2],
    linear: Vec<u16>,
    luma: Vec<u8>,
    histogram: Vec<u32>,
}

impl LinearLuma {
    /// An empty picture.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes in a picture of `size` columns and rows, three bytes per pixel, encoded with `response`.
    ///
    /// # Errors
    /// When there are fewer than `3 × columns × rows` bytes or a side exceeds 32767; the old picture stays then.
    pub fn set(&mut self, rgb: &[u8], size: [usize; 2], response: &ResponseCurve) -> Result<(), LumaError> {
        let [width, height] = size;
        check_sides(size, width)?;
        let needed = 3 * width * height;
        if rgb.len() < needed {
            return Err(LumaError::TooShort {
                found: rgb.len(),
                needed,
            });
        }
        self.size = size;
        let table = response.table().map(|y| (y * 65_535.0 / 4.0 * 64.0).round() as u32);
        self.linear.clear();
        self.linear.extend(rgb[..needed].chunks_exact(3).map(|pixel| {
            let sum: u32 = pixel
                .iter()
                .zip(WEIGHTS)
                .map(|(&code, weight)| weight * table[usize::from(code)])
                .sum();
            (sum / 64) as u16
        }));
        let factor = self.exposure_factor();
        self.luma.clear();
        self.luma.extend(
            self.linear
                .iter()
                .map(|&value| ((u64::from(value) * factor) >> 32).min(255) as u8),
        );
        Ok(())
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The 8-bit picture.
    #[must_use]
    pub fn luma(&self) -> LumaView<'_> {
        LumaView::new(self.size, self.size[0], &self.luma).expect("`set` has checked the size")
    }

    /// The 16-bit picture, row by row without padding.
    #[must_use]
    pub fn linear(&self) -> &[u16] {
        &self.linear
    }

    /// Factor from 16 to 8 bits, times 2³².
    fn exposure_factor(&mut self) -> u64 {
        self.histogram.clear();
        self.histogram.resize(1 << (16 - BIN_SHIFT), 0);
        for &value in &self.linear {
            self.histogram[usize::from(value >> BIN_SHIFT)] += 1;
        }
        let allowed = (self.linear.len() as f64 * BRIGHTEST_FRACTION) as u64;
        let mut brighter = 0;
        let bin = self.histogram.iter().rposition(|&count| {
            brighter += u64::from(count);
            brighter > allowed
        });
        let white = ((bin.unwrap_or(0) + 1) << BIN_SHIFT) as f64;
        (WELL_EXPOSED / white * 2f64.powi(32)) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_values_are_proportional_to_light() {
        let curve = ResponseCurve::srgb();
        let codes: Vec<u8> = (0..=255).collect();
        let rgb: Vec<u8> = codes.iter().flat_map(|&code| [code; 3]).collect();
        let mut luma = LinearLuma::new();
        luma.set(&rgb, [256, 1], &curve).unwrap();
        for (&code, &value) in codes.iter().zip(luma.linear()) {
            assert!((f64::from(value) / 65_535.0 - curve.linear_from_code(code)).abs() < 2.0 / 65_535.0);
        }
    }

    #[test]
    fn dark_pictures_are_brought_up_and_lamps_do_not_count() {
        let mut rgb = vec![3u8; 3 * 1000];
        rgb[600..1500].fill(9);
        rgb[..30].fill(255);
        let mut luma = LinearLuma::new();
        luma.set(&rgb, [100, 10], &ResponseCurve::srgb()).unwrap();
        let pixel = |i: usize| luma.luma().at(i % 100, i / 100);
        assert_eq!(pixel(0), 255);
        assert!((200..=WELL_EXPOSED as u8).contains(&pixel(250)), "{}", pixel(250));
        assert!((60..90).contains(&pixel(900)), "{}", pixel(900));
    }

    #[test]
    fn too_few_bytes_are_refused_and_the_picture_stays() {
        let mut luma = LinearLuma::new();
        luma.set(&[9; 12], [2, 2], &ResponseCurve::srgb()).unwrap();
        let error = luma.set(&[9; 11], [2, 2], &ResponseCurve::srgb()).unwrap_err();
        assert_eq!(error, LumaError::TooShort { found: 11, needed: 12 });
        assert!(luma.set(&[], [40_000, 1], &ResponseCurve::srgb()).is_err());
        assert_eq!(luma.size(), [2, 2]);
        luma.set(&[], [0, 0], &ResponseCurve::srgb()).unwrap();
        assert_eq!(luma.luma().width(), 0);
    }
}
