//! Statistics of a picture in linear light, from a fixed grid of samples: what exposure and white balance are set by.
//!
//! No allocation per frame, no I/O, no clock. The grid has at most [`COLUMNS`] by [`ROWS`] samples, one pixel each; the
//! central half of the picture, in width and height, counts twice, as what the camera is pointed at matters most.
//!
//! **What is not in here**: JPEG. A compressed picture is decoded to [`PixelFormat::Rgb8`] first.

use crate::frame::{PixelFormat, Size, Ycbcr, YcbcrMatrix, YcbcrRange};

/// Most columns of the sampling grid.
pub const COLUMNS: usize = 64;

/// Most rows of the sampling grid.
pub const ROWS: usize = 48;

/// A sample with a channel at this code or above is clipped. Not 255: cameras bend the top of their curve, and colour
/// differences at half the resolution move a clipped channel by a few codes.
pub const CLIPPED_CODE: u8 = 250;

/// Shares of the samples below each of [`Statistics::percentiles_log2`].
pub const PERCENTILES: [f64; 7] = [0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.98];

/// Least luminance told apart from black, as a power of two: about the first code of the sRGB curve.
pub const BLACK_LOG2: f64 = -11.5;

/// Samples dimmer than this say little about colour: one code is a tenth of them or more.
const COLOUR_LEAST: f32 = 0.004;

/// Exponent of the norm behind [`Statistics::white_rgb`].
///
/// Finlayson and Trezzi 2004, "Shades of gray and colour constancy": 1 is the grey world, infinity the brightest
/// sample; between them is best. They find 6 for whole pictures; 4 leans less on the few brightest of a coarse grid.
const WHITE_NORM: i32 = 4;

const BINS_PER_EV: f64 = 24.0;
const BINS: usize = 276;

/// Leading binary places of a number that its logarithm is looked up by: 11.
const MANTISSAS: usize = 2048;

/// What an 8-bit code says about the linear signal, as a fraction of full scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    linear: Box<[f32; 256]>,
}

/// Why numbers are not a response.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// Not one value per code.
    #[error("the response has `{found}` values (allowed: exactly 256, one per code)")]
    Length {
        /// Number of values found.
        found: usize,
    },
    /// A value is outside 0 to 1 or not a number.
    #[error("the response of code `{code}` is `{found}` (allowed: 0 to 1)")]
    Range {
        /// Index of the value.
        code: usize,
        /// The value found.
        found: f64,
    },
    /// The response falls, or never rises.
    #[error("the response does not rise at code `{code}` (allowed: never falling, and higher at 255 than at 0)")]
    NotRising {
        /// Index of the value that is too small.
        code: usize,
    },
}

impl Response {
    /// The sRGB curve (IEC 61966-2-1).
    #[must_use]
    pub fn srgb() -> Self {
        let linear = |code: usize| {
            let value = code as f64 / 255.0;
            let linear = if value <= 0.040_45 {
                value / 12.92
            } else {
                ((value + 0.055) / 1.055).powf(2.4)
            };
            linear as f32
        };
        Self {
            linear: Box::new(std::array::from_fn(linear)),
        }
    }

    /// A measured response: the linear signal of each code.
    ///
    /// # Errors
    /// When there are not 256 values, one is outside 0 to 1, they fall, or they never rise.
    pub fn from_values(values: &[f64]) -> Result<Self, ResponseError> {
        if values.len() != 256 {
            return Err(ResponseError::Length { found: values.len() });
        }
        for (code, &found) in values.iter().enumerate() {
            if !(0.0..=1.0).contains(&found) {
                return Err(ResponseError::Range { code, found });
            }
            if code > 0 && found < values[code - 1] {
                return Err(ResponseError::NotRising { code });
            }
        }
        if values[255] <= values[0] {
            return Err(ResponseError::NotRising { code: 255 });
        }
        Ok(Self {
            linear: Box::new(std::array::from_fn(|code| values[code] as f32)),
        })
    }

    /// The linear signal of a code, 0 to 1.
    #[must_use]
    pub fn linear(&self, code: u8) -> f32 {
        self.linear[usize::from(code)]
    }
}

/// Why a picture cannot be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MeterError {
    /// A compressed picture.
    #[error("cannot measure a JPEG picture (allowed: RGB, YUYV, NV12 and grey; decode it first)")]
    Compressed,
    /// The bytes do not fit the format and size.
    #[error("a picture of {width}×{height} in format {format:?} has `{found}` bytes (allowed: {expected})")]
    Bytes {
        /// Layout of the bytes.
        format: PixelFormat,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes found.
        found: usize,
        /// Bytes that it takes.
        expected: usize,
    },
}

/// What the samples of one picture say, in linear light; 1 is full scale.
///
/// Everything is relative to the exposure in force: divided by it, it is scene radiance. Luminance is that of
/// ITU-R BT.709.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistics {
    /// Mean luminance, centre-weighted.
    pub mean_luminance: f64,
    /// Mean of log2 luminance, centre-weighted; black counts as [`BLACK_LOG2`]. The key of Reinhard et al. 2002.
    pub mean_log2: f64,
    /// Mean of log2 luminance between the quartiles, centre-weighted: moves with the exposure, step by step, as long
    /// as neither quartile is clipped or black.
    pub mid_log2: f64,
    /// log2 of the luminance below which the shares [`PERCENTILES`] of the samples lie, centre-weighted.
    pub percentiles_log2: [f64; PERCENTILES.len()],
    /// Mean red, green and blue of the samples that are neither clipped nor too dark to tell their colour.
    pub mean_rgb: [f64; 3],
    /// Norm of red, green and blue over the same samples, with the exponent 4: bright ones count more, which are more
    /// often white. Each channel scales exactly with its own gain.
    pub white_rgb: [f64; 3],
    /// Share of the samples with a clipped channel, 0 to 1, centre-weighted.
    pub clipped_share: f64,
    /// Share of the samples without light, 0 to 1, centre-weighted.
    pub black_share: f64,
    /// Share of the samples behind `mean_rgb` and `white_rgb`, 0 to 1.
    pub coloured_share: f64,
}

/// Measures pictures of one camera.
#[derive(Debug, Clone)]
pub struct Meter {
    response: Response,
    bins: Box<[Bin; BINS]>,
    mantissa_log2: Box<[f32; MANTISSAS]>,
}

/// Samples of about the same luminance.
#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    weight: f32,
    sum_log2: f32,
}

/// Sums over the samples of one picture.
#[derive(Debug, Default)]
struct Sums {
    samples: u32,
    weight: f64,
    luminance: f64,
    clipped: f64,
    black: f64,
    coloured: u32,
    rgb: [f64; 3],
    white: [f64; 3],
}

impl Meter {
    /// A meter for pictures encoded with `response`.
    #[must_use]
    pub fn new(response: Response) -> Self {
        Self {
            response,
            bins: Box::new([Bin::default(); BINS]),
            mantissa_log2: Box::new(std::array::from_fn(|index| {
                (1.0 + (index as f32 + 0.5) / MANTISSAS as f32).log2()
            })),
        }
    }

    /// Measures a picture: rows from the top without padding, as in [`crate::Frame`].
    ///
    /// # Errors
    /// When the picture is compressed, or the bytes do not fit the format and size.
    pub fn measure(&mut self, size: Size, format: PixelFormat, pixels: &[u8]) -> Result<Statistics, MeterError> {
        if format == PixelFormat::Mjpeg {
            return Err(MeterError::Compressed);
        }
        if size.pixels() == 0 || !format.admits(size, pixels.len()) {
            return Err(MeterError::Bytes {
                format,
                width: size.width,
                height: size.height,
                found: pixels.len(),
                expected: format.max_bytes(size),
            });
        }
        let (width, height) = (size.width as usize, size.height as usize);
        let sums = match format {
            PixelFormat::Grey8 => self.sample(size, |x, y| [pixels[y * width + x]; 3]),
            PixelFormat::Rgb8 | PixelFormat::Mjpeg => self.sample(size, |x, y| {
                let at = 3 * (y * width + x);
                [pixels[at], pixels[at + 1], pixels[at + 2]]
            }),
            PixelFormat::Yuyv(ycbcr) => {
                let decode = Decode::new(ycbcr);
                self.sample(size, |x, y| {
                    let at = 2 * (y * width + (x & !1));
                    decode.rgb([pixels[at + 2 * (x & 1)], pixels[at + 1], pixels[at + 3]])
                })
            }
            PixelFormat::Nv12(ycbcr) => {
                let decode = Decode::new(ycbcr);
                let (luma, chroma) = pixels.split_at(width * height);
                self.sample(size, |x, y| {
                    let at = y / 2 * width + (x & !1);
                    decode.rgb([luma[y * width + x], chroma[at], chroma[at + 1]])
                })
            }
        };
        Ok(self.statistics(&sums))
    }

    /// Walks over the grid; `rgb` gives the encoded pixel in a column and row.
    fn sample(&mut self, size: Size, rgb: impl Fn(usize, usize) -> [u8; 3]) -> Sums {
        self.bins.fill(Bin::default());
        let (width, height) = (size.width as usize, size.height as usize);
        let (columns, rows) = (width.min(COLUMNS), height.min(ROWS));
        let is_central = |cell: usize, cells: usize| (cells..3 * cells).contains(&(4 * cell + 2));
        // Where the samples of a row lie, and which of them are central: divisions are done once, not for each row.
        let place = |column: usize| ((2 * column + 1) * width / (2 * columns), is_central(column, columns));
        let places: [(usize, bool); COLUMNS] = std::array::from_fn(place);
        let mut sums = Sums::default();
        for row in 0..rows {
            let y = (2 * row + 1) * height / (2 * rows);
            let row_is_central = is_central(row, rows);
            for &(x, column_is_central) in &places[..columns] {
                let weight = if row_is_central && column_is_central { 2.0 } else { 1.0 };
                self.add(&mut sums, rgb(x, y), weight);
            }
        }
        sums
    }

    #[inline]
    fn add(&mut self, sums: &mut Sums, code: [u8; 3], weight: f32) {
        let rgb = code.map(|code| self.response.linear(code));
        let luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        let log2 = self.log2(luminance).max(BLACK_LOG2 as f32);
        let bin = ((log2 - BLACK_LOG2 as f32) * BINS_PER_EV as f32) as usize;
        let bin = &mut self.bins[bin.min(BINS - 1)];
        bin.weight += weight;
        bin.sum_log2 += weight * log2;
        let wide = f64::from(weight);
        sums.samples += 1;
        sums.weight += wide;
        sums.luminance += wide * f64::from(luminance);
        let is_clipped = code.iter().any(|&code| code >= CLIPPED_CODE);
        if is_clipped {
            sums.clipped += wide;
        } else if luminance >= COLOUR_LEAST {
            sums.coloured += 1;
            for ((channel, sum), white) in rgb.into_iter().zip(&mut sums.rgb).zip(&mut sums.white) {
                *sum += f64::from(channel);
                *white += f64::from(channel.powi(WHITE_NORM));
            }
        }
        if log2 <= BLACK_LOG2 as f32 {
            sums.black += wide;
        }
    }

    /// log2 of a number from 0 to 1, to 0.0004: its exponent, and a table for its leading binary places.
    #[inline]
    fn log2(&self, number: f32) -> f32 {
        let bits = number.to_bits();
        let exponent = (bits >> 23) as i32 - 127;
        exponent as f32 + self.mantissa_log2[(bits >> 12) as usize % MANTISSAS]
    }

    fn statistics(&self, sums: &Sums) -> Statistics {
        let coloured = f64::from(sums.coloured.max(1));
        let sum_log2: f64 = self.bins.iter().map(|bin| f64::from(bin.sum_log2)).sum();
        Statistics {
            mean_luminance: sums.luminance / sums.weight,
            mean_log2: sum_log2 / sums.weight,
            mid_log2: self.mid_log2(sums.weight),
            percentiles_log2: PERCENTILES.map(|share| self.percentile_log2(share * sums.weight)),
            mean_rgb: sums.rgb.map(|sum| sum / coloured),
            white_rgb: sums.white.map(|sum| (sum / coloured).powf(1.0 / f64::from(WHITE_NORM))),
            clipped_share: sums.clipped / sums.weight,
            black_share: sums.black / sums.weight,
            coloured_share: f64::from(sums.coloured) / f64::from(sums.samples),
        }
    }

    /// log2 luminance with this weight of samples below, linear within a bin.
    fn percentile_log2(&self, weight_below: f64) -> f64 {
        let mut below = 0.0;
        for (index, bin) in self.bins.iter().enumerate() {
            let weight = f64::from(bin.weight);
            if weight > 0.0 && below + weight >= weight_below {
                let within = (weight_below - below) / weight;
                return BLACK_LOG2 + (index as f64 + within) / BINS_PER_EV;
            }
            below += weight;
        }
        0.0
    }

    fn mid_log2(&self, weight: f64) -> f64 {
        let (from, to) = (0.25 * weight, 0.75 * weight);
        let (mut below, mut sum) = (0.0, 0.0);
        for bin in self.bins.iter().filter(|bin| bin.weight > 0.0) {
            let above = below + f64::from(bin.weight);
            let inside = above.min(to) - f64::max(below, from);
            if inside > 0.0 {
                sum += inside * f64::from(bin.sum_log2 / bin.weight);
            }
            below = above;
        }
        sum / (to - from)
    }
}

/// Y, Cb and Cr to encoded red, green and blue.
#[derive(Debug, Clone, Copy)]
struct Decode {
    black: f32,
    luma_scale: f32,
    red_from_cr: f32,
    green_from_cb: f32,
    green_from_cr: f32,
    blue_from_cb: f32,
}

impl Decode {
    /// ITU-R BT.601 and BT.709: R = Y + 2 (1 - Kr) Cr, B = Y + 2 (1 - Kb) Cb, and G from Y = Kr R + Kg G + Kb B.
    fn new(ycbcr: Ycbcr) -> Self {
        let (kr, kb) = match ycbcr.matrix {
            YcbcrMatrix::Bt601 => (0.299, 0.114),
            YcbcrMatrix::Bt709 => (0.2126, 0.0722),
        };
        let (black, luma_scale, chroma_scale) = match ycbcr.range {
            YcbcrRange::Limited => (16.0, 255.0 / 219.0, 255.0 / 224.0),
            YcbcrRange::Full => (0.0, 1.0, 1.0),
        };
        let kg = 1.0 - kr - kb;
        Self {
            black,
            luma_scale,
            red_from_cr: 2.0 * (1.0 - kr) * chroma_scale,
            green_from_cb: -2.0 * (1.0 - kb) * kb / kg * chroma_scale,
            green_from_cr: -2.0 * (1.0 - kr) * kr / kg * chroma_scale,
            blue_from_cb: 2.0 * (1.0 - kb) * chroma_scale,
        }
    }

    #[inline]
    fn rgb(self, ycbcr: [u8; 3]) -> [u8; 3] {
        let luma = (f32::from(ycbcr[0]) - self.black) * self.luma_scale;
        let (cb, cr) = (f32::from(ycbcr[1]) - 128.0, f32::from(ycbcr[2]) - 128.0);
        // A cast of a float to an integer stops at the integer's limits.
        let code = |value: f32| (value + 0.5) as u8;
        [
            code(luma + self.red_from_cr * cr),
            code(luma + self.green_from_cb * cb + self.green_from_cr * cr),
            code(luma + self.blue_from_cb * cb),
        ]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FORMATS: [PixelFormat; 4] = [
        PixelFormat::Rgb8,
        PixelFormat::Grey8,
        PixelFormat::Yuyv(Ycbcr {
            matrix: YcbcrMatrix::Bt601,
            range: YcbcrRange::Limited,
        }),
        PixelFormat::Nv12(Ycbcr {
            matrix: YcbcrMatrix::Bt709,
            range: YcbcrRange::Full,
        }),
    ];

    fn plain(format: PixelFormat, size: Size, code: u8) -> Vec<u8> {
        let luma = |ycbcr: Ycbcr| match ycbcr.range {
            YcbcrRange::Limited => (16.0 + f64::from(code) * 219.0 / 255.0).round() as u8,
            YcbcrRange::Full => code,
        };
        match format {
            PixelFormat::Rgb8 | PixelFormat::Grey8 | PixelFormat::Mjpeg => vec![code; format.max_bytes(size)],
            PixelFormat::Yuyv(ycbcr) => [luma(ycbcr), 128].repeat(size.pixels()),
            PixelFormat::Nv12(ycbcr) => [vec![luma(ycbcr); size.pixels()], vec![128; size.pixels() / 2]].concat(),
        }
    }

    #[test]
    fn a_plain_picture_measures_the_same_in_every_format() {
        let size = Size { width: 96, height: 50 };
        for format in FORMATS {
            let mut meter = Meter::new(Response::srgb());
            let statistics = meter.measure(size, format, &plain(format, size, 128)).unwrap();
            // IEC 61966-2-1: code 128 is 0.215861; limited range rounds by up to half a code.
            assert!(
                (statistics.mean_luminance / 0.215_861).log2().abs() < 0.015,
                "{format:?} {statistics:?}"
            );
            assert!((statistics.mid_log2 - statistics.mean_log2).abs() < 1e-4);
            assert!((statistics.percentiles_log2[3] - statistics.mean_log2).abs() < 1.0 / BINS_PER_EV);
            assert!(
                statistics
                    .mean_rgb
                    .iter()
                    .all(|mean| (mean / 0.215_861).log2().abs() < 0.015)
            );
            assert!((statistics.white_rgb[1] / statistics.mean_rgb[1] - 1.0).abs() < 1e-4);
            assert!(statistics.clipped_share == 0.0 && statistics.black_share == 0.0);
            assert!(statistics.coloured_share == 1.0);
            let white = meter.measure(size, format, &plain(format, size, 255)).unwrap();
            assert!(white.clipped_share == 1.0 && white.coloured_share == 0.0);
            let black = meter.measure(size, format, &plain(format, size, 0)).unwrap();
            assert!(black.black_share == 1.0 && black.mean_log2 == BLACK_LOG2);
        }
    }

    #[test]
    fn colours_survive_yuyv() {
        // BT.601 full range of pure codes (200, 100, 50): Y 124.2, Cb 86.1, Cr 182.1.
        let format = PixelFormat::Yuyv(Ycbcr {
            matrix: YcbcrMatrix::Bt601,
            range: YcbcrRange::Full,
        });
        let size = Size { width: 64, height: 48 };
        let pixels = [124, 86, 124, 182].repeat(size.pixels() / 2);
        let statistics = Meter::new(Response::srgb()).measure(size, format, &pixels).unwrap();
        for (mean, code) in statistics.mean_rgb.into_iter().zip([200_u8, 100, 50]) {
            let expected = f64::from(Response::srgb().linear(code));
            assert!((mean / expected).log2().abs() < 0.06, "{mean} {expected}");
        }
    }

    #[test]
    fn what_cannot_be_measured_is_refused() {
        let size = Size { width: 4, height: 4 };
        let mut meter = Meter::new(Response::srgb());
        let measure = |meter: &mut Meter, size, format, n: usize| meter.measure(size, format, &vec![0; n]);
        assert_eq!(
            measure(&mut meter, size, PixelFormat::Mjpeg, 9),
            Err(MeterError::Compressed)
        );
        let error = measure(&mut meter, size, PixelFormat::Rgb8, 47)
            .unwrap_err()
            .to_string();
        assert_eq!(error, "a picture of 4×4 in format Rgb8 has `47` bytes (allowed: 48)");
        let nothing = Size { width: 0, height: 0 };
        assert!(measure(&mut meter, nothing, PixelFormat::Grey8, 0).is_err());
        let line: Vec<f64> = (0..256).map(|code| f64::from(code) / 255.0).collect();
        assert!(Response::from_values(&line).is_ok());
        assert_eq!(
            Response::from_values(&line[1..]),
            Err(ResponseError::Length { found: 255 })
        );
        assert_eq!(
            Response::from_values(&[0.5; 256]),
            Err(ResponseError::NotRising { code: 255 })
        );
        let mut falling = line.clone();
        falling[7] = 0.0;
        assert_eq!(
            Response::from_values(&falling),
            Err(ResponseError::NotRising { code: 7 })
        );
        falling[7] = f64::NAN;
        assert!(matches!(
            Response::from_values(&falling),
            Err(ResponseError::Range { code: 7, .. })
        ));
    }

    proptest! {
        #[test]
        fn any_bytes_give_finite_statistics(
            (width, height) in (1_u32..90, 1_u32..70),
            format_index in 0..FORMATS.len(),
            seed in any::<u64>(),
        ) {
            let size = Size { width: 2 * width, height: 2 * height };
            let format = FORMATS[format_index];
            let mut state = seed | 1;
            let pixels: Vec<u8> = (0..format.max_bytes(size)).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 56) as u8
            }).collect();
            let s = Meter::new(Response::srgb()).measure(size, format, &pixels).unwrap();
            let numbers = [s.mean_luminance, s.mean_log2, s.mid_log2, s.clipped_share, s.black_share];
            prop_assert!(numbers.iter().chain(&s.mean_rgb).chain(&s.white_rgb).all(|n| n.is_finite()));
            prop_assert!(s.percentiles_log2.windows(2).all(|pair| pair[0] <= pair[1]));
            prop_assert!(s.percentiles_log2[2] - 0.1 <= s.mid_log2 && s.mid_log2 <= s.percentiles_log2[4] + 0.1);
        }
    }

    #[test]
    #[ignore = "prints how long measuring takes"]
    fn time_per_frame() {
        let size = Size {
            width: 1280,
            height: 720,
        };
        for format in FORMATS {
            let pixels: Vec<u8> = (0..format.max_bytes(size)).map(|at| (at * 31 % 251) as u8).collect();
            let mut meter = Meter::new(Response::srgb());
            let start = std::time::Instant::now();
            for _ in 0..500 {
                std::hint::black_box(meter.measure(size, format, std::hint::black_box(&pixels)).unwrap());
            }
            println!(
                "{format:?} 1280×720: {:.1} µs",
                start.elapsed().as_secs_f64() * 1e6 / 500.0
            );
        }
    }
}
