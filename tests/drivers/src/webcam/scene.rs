//! What a simulated webcam looks at.
//!
//! Radiance is linear RGB in Rec. 709 primaries, in a unit of which 1.0 just saturates an ideal webcam at 10 ms and
//! gain 1 (see [`super::sensor`]).

use std::sync::Arc;
use std::time::Instant;

use image::RgbImage;

/// The light in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Level in stops; at 0 a white surface has radiance 1.
    pub level_ev: f32,
    /// Colour temperature in kelvin, 1700 to 25000; see [`planckian_rgb`].
    pub temperature_k: f32,
}

impl Default for Light {
    fn default() -> Self {
        Self {
            level_ev: 0.0,
            temperature_k: 6504.0,
        }
    }
}

impl Light {
    /// Radiance of a white surface.
    pub fn radiance(&self) -> [f32; 3] {
        planckian_rgb(self.temperature_k).map(|channel| channel * self.level_ev.exp2())
    }
}

/// Colour of a black body in linear Rec. 709 RGB, green 1; neutral at 6504 K. Temperatures are clamped to 1700 to
/// 25000 K.
///
/// Chromaticity after Kim et al. 2002 (US patent 7024034, cubic fits of the Planckian locus).
pub fn planckian_rgb(temperature_k: f32) -> [f32; 3] {
    let rgb = planckian_rec709(temperature_k);
    let neutral = planckian_rec709(6504.0);
    let scaled = [0, 1, 2].map(|channel| rgb[channel] / neutral[channel]);
    scaled.map(|channel| channel / scaled[1])
}

fn planckian_rec709(temperature_k: f32) -> [f32; 3] {
    let t = f64::from(temperature_k.clamp(1700.0, 25_000.0));
    let cubic = |[a, b, c, d]: [f64; 4], v: f64| ((a * v + b) * v + c) * v + d;
    let x = if t <= 4000.0 {
        cubic([-0.266_123_9, -0.234_358_9, 0.877_695_6, 0.179_910], 1e3 / t)
    } else {
        cubic([-3.025_846_9, 2.107_037_9, 0.222_634_7, 0.240_390], 1e3 / t)
    };
    let y = if t <= 2222.0 {
        cubic([-1.106_381_4, -1.348_110_20, 2.185_558_32, -0.202_196_83], x)
    } else if t <= 4000.0 {
        cubic([-0.954_947_6, -1.374_185_93, 2.091_370_15, -0.167_488_67], x)
    } else {
        cubic([3.081_758_0, -5.873_386_70, 3.751_129_97, -0.370_014_83], x)
    };
    let (big_x, big_z) = (x / y, (1.0 - x - y) / y);
    // XYZ with Y = 1 to linear Rec. 709 (IEC 61966-2-1).
    [
        3.240_97 * big_x - 1.537_383 - 0.498_611 * big_z,
        -0.969_244 * big_x + 1.875_968 + 0.041_555 * big_z,
        0.055_630 * big_x - 0.203_977 + 1.056_972 * big_z,
    ]
    .map(|channel| channel.max(1e-3) as f32)
}

/// Flat patches in a grid over the whole picture, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Patches {
    /// Patches in a row.
    pub columns: usize,
    /// Reflectance of each patch, linear RGB from 0 to 1.
    pub reflectances: Vec<[f32; 3]>,
}

impl Patches {
    /// One even surface.
    pub fn even(reflectance: [f32; 3]) -> Self {
        Self {
            columns: 1,
            reflectances: vec![reflectance],
        }
    }

    /// A chart of 4 × 3: greys, colours, and a row of 18 % grey card.
    pub fn chart() -> Self {
        let grey = |reflectance: f32| [reflectance; 3];
        let reflectances = vec![
            grey(0.90),
            grey(0.36),
            grey(0.09),
            grey(0.03),
            [0.40, 0.06, 0.05],
            [0.08, 0.30, 0.07],
            [0.05, 0.07, 0.35],
            [0.55, 0.42, 0.06],
            grey(0.18),
            grey(0.18),
            grey(0.18),
            grey(0.18),
        ];
        Self {
            columns: 4,
            reflectances,
        }
    }

    /// Rows of patches; the last may be incomplete, its missing patches black.
    pub fn rows(&self) -> usize {
        self.reflectances.len().div_ceil(self.columns.max(1))
    }
}

/// A picture of radiances, stored as logarithms so that exposing it is an addition.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearPicture {
    width: usize,
    height: usize,
    log_codes: Vec<[u16; 3]>,
    mean: [f32; 3],
}

/// Log codes per stop: steps of 0.27 %.
pub const LOG_STEPS_PER_STOP: f32 = 256.0;
/// The log code of radiance 1; the range is 12 stops below to 4 above.
pub const LOG_CODE_OF_ONE: i32 = 3072;
/// Greatest log code.
pub const LOG_CODE_MAX: i32 = 4095;

impl LinearPicture {
    /// A picture from radiances, row by row.
    ///
    /// # Panics
    /// When `radiances` has not `width` × `height` entries, or there are none.
    pub fn new(width: usize, height: usize, radiances: &[[f32; 3]]) -> Self {
        assert!(
            width > 0 && radiances.len() == width * height,
            "as many radiances as pixels"
        );
        let mut sum = [0.0_f64; 3];
        for radiance in radiances {
            for channel in 0..3 {
                sum[channel] += f64::from(radiance[channel]);
            }
        }
        let mean = sum.map(|channel| (channel / radiances.len() as f64) as f32);
        let log_codes = radiances.iter().map(|radiance| radiance.map(log_code)).collect();
        Self {
            width,
            height,
            log_codes,
            mean,
        }
    }

    /// The scene that a recorded picture shows: its codes through the inverse sRGB response (IEC 61966-2-1), divided
    /// by the exposure it was taken with (in units of 10 ms at gain 1).
    pub fn from_recorded(picture: &RgbImage, exposure: f32) -> Self {
        let linear: Vec<f32> = (0..=255_u8)
            .map(|code| srgb_to_linear(f32::from(code) / 255.0) / exposure)
            .collect();
        let logs: Vec<u16> = linear.iter().map(|radiance| log_code(*radiance)).collect();
        let mut sum = [0.0_f64; 3];
        for pixel in picture.pixels() {
            for channel in 0..3 {
                sum[channel] += f64::from(linear[usize::from(pixel.0[channel])]);
            }
        }
        let n_pixels = f64::from(picture.width()) * f64::from(picture.height());
        Self {
            width: picture.width() as usize,
            height: picture.height() as usize,
            log_codes: picture
                .pixels()
                .map(|pixel| pixel.0.map(|code| logs[usize::from(code)]))
                .collect(),
            mean: sum.map(|channel| (channel / n_pixels) as f32),
        }
    }

    /// Mean radiance.
    pub fn mean(&self) -> [f32; 3] {
        self.mean
    }

    /// Pixels in a row.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Log codes of the row that is nearest to row `y` of a picture with `height` rows.
    pub(crate) fn row(&self, y: usize, height: usize) -> &[[u16; 3]] {
        let row = y * self.height / height;
        &self.log_codes[row * self.width..(row + 1) * self.width]
    }
}

/// Linear light of an sRGB value from 0 to 1.
pub fn srgb_to_linear(value: f32) -> f32 {
    if value <= 0.040_45 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// sRGB value of linear light from 0 to 1.
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

fn log_code(radiance: f32) -> u16 {
    let code = (radiance.max(1e-9).log2() * LOG_STEPS_PER_STOP).round() as i32 + LOG_CODE_OF_ONE;
    code.clamp(0, LOG_CODE_MAX) as u16
}

/// Pictures that follow one another at a steady rate, over and over.
#[derive(Clone, Debug)]
pub struct Film {
    /// The pictures; at least one.
    pub pictures: Arc<Vec<LinearPicture>>,
    /// Pictures a second.
    pub rate_hz: f64,
    /// When the first is shown; several webcams with the same start see the same moment.
    pub start: Instant,
}

impl Film {
    /// Index of the picture that is shown now.
    pub fn index_at(&self, now: Instant) -> usize {
        let shown = now.saturating_duration_since(self.start).as_secs_f64() * self.rate_hz;
        shown as usize % self.pictures.len().max(1)
    }
}

/// What the webcam sees.
#[derive(Clone, Debug)]
pub enum Scene {
    /// Patches under the scene's light.
    Patches(Patches),
    /// Moving pictures, as if taken in white light of level 0; the scene's light multiplies them.
    Film(Film),
}

impl Scene {
    /// Mean radiance under white light of level 0, of the picture shown at `index`.
    pub fn mean(&self, index: usize) -> [f32; 3] {
        match self {
            Scene::Patches(patches) => {
                let n_patches = patches.reflectances.len().max(1) as f32;
                [0, 1, 2].map(|channel| patches.reflectances.iter().map(|r| r[channel]).sum::<f32>() / n_patches)
            }
            Scene::Film(film) => film.pictures.get(index).map_or([0.0; 3], LinearPicture::mean),
        }
    }

    /// Index of the picture shown now; 0 for patches.
    pub fn index_at(&self, now: Instant) -> usize {
        match self {
            Scene::Patches(_) => 0,
            Scene::Film(film) => film.index_at(now),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_bodies_have_their_known_colours() {
        assert_eq!(planckian_rgb(6504.0), [1.0; 3]);
        // CIE illuminant A is at x 0.4476, y 0.4074; the matrix of Rec. 709 makes that (1.8460, 0.8259, 0.2333).
        // The fit is good to some ten-thousandths in x and y.
        let [r, g, b] = planckian_rec709(2856.0);
        assert!(
            (r / g - 2.235).abs() < 0.02 && (b / g - 0.2825).abs() < 0.005,
            "{r} {g} {b}"
        );
        let cold = planckian_rgb(12_000.0);
        assert!(cold[0] < 1.0 && cold[2] > 1.0);
    }

    #[test]
    fn the_response_and_its_inverse_agree() {
        for code in 0..=255_u8 {
            let value = f32::from(code) / 255.0;
            assert!((linear_to_srgb(srgb_to_linear(value)) - value).abs() < 1e-4);
        }
    }

    #[test]
    fn a_recorded_picture_is_divided_by_its_exposure() {
        let picture = RgbImage::from_pixel(2, 2, image::Rgb([188, 188, 188]));
        let scene = LinearPicture::from_recorded(&picture, 0.25);
        // Code 188 is 0.503 linear.
        assert!((scene.mean()[1] - 4.0 * 0.503).abs() < 0.01);
    }

    #[test]
    fn films_run_in_a_circle() {
        let picture = LinearPicture::new(1, 1, &[[0.5; 3]]);
        let start = Instant::now();
        let film = Film {
            pictures: Arc::new(vec![picture.clone(), picture]),
            rate_hz: 10.0,
            start,
        };
        let at = |ms| film.index_at(start + std::time::Duration::from_millis(ms));
        assert_eq!([at(0), at(50), at(150), at(250)], [0, 0, 1, 0]);
    }
}
