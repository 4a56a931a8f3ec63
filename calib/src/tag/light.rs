//! Pictures whose pixels can be read as light.

use super::{LinearLuma, LumaView};

/// A picture that can be read as light, pixel by pixel: edges are exact where values are proportional to light, and a whole
/// picture need not be converted for the few pixels about the edges.
pub trait LightPicture {
    /// Columns and rows.
    fn size(&self) -> [usize; 2];

    /// A value proportional to the light of a pixel, 1 for the largest code.
    ///
    /// # Panics
    /// May panic outside of the picture.
    fn light(&self, x: usize, y: usize) -> f32;
}

impl LightPicture for LinearLuma {
    fn size(&self) -> [usize; 2] {
        self.size()
    }

    #[inline]
    fn light(&self, x: usize, y: usize) -> f32 {
        f32::from(self.linear()[y * self.size()[0] + x]) / 65_535.0
    }
}

/// A grey picture with the light of each of its codes.
#[derive(Debug, Clone, Copy)]
pub struct EncodedLuma<'a> {
    /// The codes.
    pub luma: LumaView<'a>,
    /// Light of a code.
    pub light_from_code: &'a [f32; 256],
}

impl LightPicture for EncodedLuma<'_> {
    fn size(&self) -> [usize; 2] {
        [self.luma.width(), self.luma.height()]
    }

    #[inline]
    fn light(&self, x: usize, y: usize) -> f32 {
        self.light_from_code[usize::from(self.luma.at(x, y))]
    }
}

/// A colour picture, three bytes per pixel without padding, with the light of each code: grey is a quarter of red, half of
/// green and a quarter of blue, as sensors sample them.
#[derive(Debug, Clone, Copy)]
pub struct EncodedRgb<'a> {
    /// Red, green and blue, pixel by pixel.
    pub rgb: &'a [u8],
    /// Columns and rows.
    pub size: [usize; 2],
    /// Light of a code.
    pub light_from_code: &'a [f32; 256],
}

impl LightPicture for EncodedRgb<'_> {
    fn size(&self) -> [usize; 2] {
        self.size
    }

    #[inline]
    fn light(&self, x: usize, y: usize) -> f32 {
        let first = 3 * (y * self.size[0] + x);
        let [red, green, blue] = [0, 1, 2].map(|i| self.light_from_code[usize::from(self.rgb[first + i])]);
        0.25 * (red + blue) + 0.5 * green
    }
}
