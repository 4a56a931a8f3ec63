//! Response curves: pixel code to linear signal and back.

/// Number of codes of an 8-bit pixel.
const CODES: usize = 256;

/// What an 8-bit pixel code says about the linear signal y, as a fraction of the brightest recordable one.
///
/// Never decreasing. The forward curve f, `code = round(255 f(y))`, is exact for sRGB; a measured curve knows f at the
/// codes only and is linear in between.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponseCurve {
    kind: Kind,
    linear: Box<[f64; CODES]>,
    linear_f32: Box<[f32; CODES]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Srgb,
    Table,
}

/// Why a table of numbers is not a response curve.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// Not one value per code.
    #[error("the response curve has `{found}` values (allowed: exactly 256, one per code)")]
    Length {
        /// Number of values found.
        found: usize,
    },
    /// A value is outside 0 to 1, or NaN.
    #[error("the response of code `{code}` is `{value}` (allowed: 0 to 1)")]
    Range {
        /// Index of the value.
        code: usize,
        /// What was found.
        value: f64,
    },
    /// The curve falls.
    #[error("the response falls from `{before}` to `{value}` at code `{code}` (allowed: never decreasing)")]
    Decreasing {
        /// Index of the smaller value.
        code: usize,
        /// Value of the code before.
        before: f64,
        /// What was found.
        value: f64,
    },
    /// All values are equal.
    #[error("all 256 values of the response curve are `{value}` (allowed: a curve that rises)")]
    Flat {
        /// The value.
        value: f64,
    },
}

impl ResponseCurve {
    /// The sRGB transfer curve (IEC 61966-2-1).
    #[must_use]
    pub fn srgb() -> Self {
        Self::new(Kind::Srgb, |code| srgb_decode(code as f64 / 255.0))
    }

    /// A measured curve: for each code the linear signal.
    ///
    /// # Errors
    /// When there are not 256 values, one is outside 0 to 1, the curve falls, or it never rises.
    pub fn from_table(values: &[f64]) -> Result<Self, ResponseError> {
        if values.len() != CODES {
            return Err(ResponseError::Length { found: values.len() });
        }
        if let Some((code, &value)) = values
            .iter()
            .enumerate()
            .find(|(_, value)| !(0.0..=1.0).contains(*value))
        {
            return Err(ResponseError::Range { code, value });
        }
        for (before, pair) in values.windows(2).enumerate() {
            if pair[1] < pair[0] {
                return Err(ResponseError::Decreasing {
                    code: before + 1,
                    before: pair[0],
                    value: pair[1],
                });
            }
        }
        if values[0] >= values[CODES - 1] {
            return Err(ResponseError::Flat { value: values[0] });
        }
        Ok(Self::new(Kind::Table, |code| values[code]))
    }

    fn new(kind: Kind, linear_from_code: impl Fn(usize) -> f64) -> Self {
        let linear = Box::new(std::array::from_fn(linear_from_code));
        let linear_f32 = Box::new(linear.map(|y| y as f32));
        Self {
            kind,
            linear,
            linear_f32,
        }
    }

    /// The linear signal of a code, 0 to 1.
    #[must_use]
    pub fn linear_from_code(&self, code: u8) -> f64 {
        self.linear[usize::from(code)]
    }

    /// The linear signals of all codes.
    #[must_use]
    pub fn table(&self) -> &[f32; CODES] {
        &self.linear_f32
    }

    /// How wide the code is on the scale of the signal: the mean distance to its neighbours' signals, or the distance to
    /// the only neighbour.
    #[must_use]
    pub fn code_width(&self, code: u8) -> f64 {
        let (below, above) = (code.saturating_sub(1), code.saturating_add(1));
        (self.linear_from_code(above) - self.linear_from_code(below)) / f64::from(above - below)
    }

    /// The first code that stands for its signal and everything above; at least 1.
    #[must_use]
    pub fn first_clipped_code(&self) -> u8 {
        self.linear.partition_point(|&y| y < self.linear[CODES - 1]) as u8
    }

    /// The last code that stands for its signal and everything below; below [`Self::first_clipped_code`].
    #[must_use]
    pub fn last_black_code(&self) -> u8 {
        (self.linear.partition_point(|&y| y <= self.linear[0]) - 1) as u8
    }

    /// The code that the camera gives to a linear signal; signals outside 0 to 1 are clipped, NaN gives 0.
    ///
    /// The inverse of [`Self::linear_from_code`] for every code whose value no other code has.
    #[must_use]
    pub fn encode(&self, y: f64) -> u8 {
        let y = if y.is_nan() { 0.0 } else { y.clamp(0.0, 1.0) };
        let position = match self.kind {
            Kind::Srgb => 255.0 * srgb_encode(y),
            Kind::Table => self.table_position(y),
        };
        (position + 0.5).floor().clamp(0.0, 255.0) as u8
    }

    /// 255 f(y), linear between the codes; the last code of a plateau.
    fn table_position(&self, y: f64) -> f64 {
        let above = self.linear.partition_point(|&value| value <= y);
        let Some(below) = above.checked_sub(1) else { return 0.0 };
        if above == CODES {
            return 255.0;
        }
        below as f64 + (y - self.linear[below]) / (self.linear[above] - self.linear[below])
    }
}

fn srgb_decode(value: f64) -> f64 {
    if value <= 0.040_45 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

fn srgb_encode(y: f64) -> f64 {
    if y <= 0.003_130_8 {
        12.92 * y
    } else {
        1.055 * y.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_srgb_code_comes_back() {
        let curve = ResponseCurve::srgb();
        for code in 0..=255 {
            assert_eq!(curve.encode(curve.linear_from_code(code)), code);
            // Half way to the neighbour, on the camera's own scale, the code changes.
            let edge = srgb_decode((f64::from(code) + 0.5) / 255.0);
            assert_eq!(curve.encode(edge - 1e-9), code);
            assert_eq!(curve.encode(edge + 1e-9), code.saturating_add(1));
        }
        // IEC 61966-2-1: code 128 is a fifth.
        assert!((curve.linear_from_code(128) - 0.215_861).abs() < 1e-6);
    }

    #[test]
    fn signals_out_of_range_are_clipped() {
        let curve = ResponseCurve::srgb();
        let codes = [-1.0, 2.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(|y| curve.encode(y));
        assert_eq!(codes, [0, 255, 0, 255, 0]);
    }

    #[test]
    fn a_table_that_stops_below_1_clips_at_its_last_code() {
        let values: Vec<f64> = (0..256).map(|code| f64::from(code) / 256.0 * 0.5).collect();
        let curve = ResponseCurve::from_table(&values).expect("a curve");
        assert_eq!(curve.encode(0.9), 255);
        assert_eq!(curve.encode(0.0), 0);
    }

    #[test]
    fn what_is_no_curve_is_refused() {
        let line: Vec<f64> = (0..256).map(|code| f64::from(code) / 255.0).collect();
        let with = |code: usize, value: f64| {
            let mut values = line.clone();
            values[code] = value;
            ResponseCurve::from_table(&values).unwrap_err().to_string()
        };
        assert_eq!(
            ResponseCurve::from_table(&line[..255]).unwrap_err().to_string(),
            "the response curve has `255` values (allowed: exactly 256, one per code)"
        );
        assert_eq!(with(7, f64::NAN), "the response of code `7` is `NaN` (allowed: 0 to 1)");
        assert_eq!(with(255, 1.5), "the response of code `255` is `1.5` (allowed: 0 to 1)");
        assert_eq!(
            with(3, 0.0),
            "the response falls from `0.00784313725490196` to `0` at code `3` (allowed: never decreasing)"
        );
        assert_eq!(
            ResponseCurve::from_table(&[0.5; 256]),
            Err(ResponseError::Flat { value: 0.5 })
        );
    }

    proptest! {
        #[test]
        fn every_code_of_a_rising_table_comes_back(steps in prop::collection::vec(1e-6f64..1.0, 256)) {
            let mut values: Vec<f64> = steps.iter().scan(0.0, |sum, step| { *sum += step; Some(*sum) }).collect();
            let last = values[255];
            values.iter_mut().for_each(|value| *value /= last);
            let curve = ResponseCurve::from_table(&values).expect("a curve");
            for code in 0..=255 {
                prop_assert_eq!(curve.encode(curve.linear_from_code(code)), code);
            }
        }

        #[test]
        fn encoding_never_falls(a in 0.0f64..1.0, b in 0.0f64..1.0, power in 1.0f64..3.0) {
            let values: Vec<f64> = (0..256).map(|code| (f64::from(code) / 255.0).powf(power)).collect();
            let curve = ResponseCurve::from_table(&values).expect("a curve");
            prop_assert!(curve.encode(a.min(b)) <= curve.encode(a.max(b)));
        }
    }
}
