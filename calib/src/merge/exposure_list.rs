//! Lists of pictures and exposure times, in the format of Debevec's image series.
//!
//! ```text
//! # Filename          exposure  1/shutter_speed f/stop gain(db) ND_filters
//! memorial0061.png    32        0.03125         8      0        0
//! ```
//!
//! After the name comes the exposure time in seconds or, where there is a single number, its inverse; where both stand they must
//! agree. Aperture, gain and filters follow, or nothing. A `#` begins a comment.

/// Exposure times beyond this are a mistake: a day.
pub const MAX_EXPOSURE_S: f64 = 86_400.0;

/// Exposure times below this are a mistake: a nanosecond.
pub const MIN_EXPOSURE_S: f64 = 1e-9;

/// A picture of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedPicture {
    /// Name of its file, relative to the list.
    pub file: String,
    /// What its exposure is in proportion to: seconds times gain over the square of the aperture's number, relative to the
    /// first picture's aperture, gain and filter.
    pub exposure_s: f64,
}

/// Why a text is not such a list.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ListError {
    /// A line has too few or too many columns.
    #[error("line {line} has `{found}` columns (allowed: 2, name and 1/seconds; 3, with the seconds between; or 6)")]
    Columns {
        /// Line, from 1.
        line: usize,
        /// Number of columns.
        found: usize,
    },
    /// A column is no number, or out of range.
    #[error("line {line}: {column} is `{found}` (allowed: {allowed})")]
    Number {
        /// Line, from 1.
        line: usize,
        /// What the column means.
        column: &'static str,
        /// What stands there.
        found: String,
        /// What may stand there.
        allowed: &'static str,
    },
    /// Exposure time and its inverse disagree.
    #[error("line {line}: the exposure `{exposure_s}` s is not the inverse of `{inverse}` (allowed: within 10 %)")]
    Inverse {
        /// Line, from 1.
        line: usize,
        /// Exposure time found.
        exposure_s: f64,
        /// Its supposed inverse.
        inverse: f64,
    },
    /// There is no picture in it.
    #[error("the list names no picture (allowed: 2 or more)")]
    Empty,
}

/// Reads a list.
///
/// # Errors
/// When a line is not as described above, or there is none.
pub fn parse(text: &str) -> Result<Vec<ListedPicture>, ListError> {
    let mut pictures = Vec::new();
    let mut first = None;
    for (index, line) in text.lines().enumerate() {
        let columns: Vec<&str> = line.split('#').next().unwrap_or("").split_whitespace().collect();
        if columns.is_empty() {
            continue;
        }
        let line = index + 1;
        let exposure_s = exposure(&columns, line)?;
        let light = light(&columns, line)?;
        let reference = *first.get_or_insert(light);
        pictures.push(ListedPicture {
            file: columns[0].to_owned(),
            exposure_s: exposure_s * light / reference,
        });
    }
    if pictures.is_empty() {
        Err(ListError::Empty)
    } else {
        Ok(pictures)
    }
}

/// Seconds of exposure.
fn exposure(columns: &[&str], line: usize) -> Result<f64, ListError> {
    let seconds = |at: usize, column: &'static str| {
        let range = MIN_EXPOSURE_S..=MAX_EXPOSURE_S;
        number(columns[at], line, column, "1e-9 to 86400", |value| {
            range.contains(&value)
        })
    };
    let inverse = |at: usize| {
        let range = 1.0 / MAX_EXPOSURE_S..=1.0 / MIN_EXPOSURE_S;
        let allowed = "the inverse of 1e-9 to 86400";
        number(columns[at], line, "1/shutter speed", allowed, |value| {
            range.contains(&value)
        })
    };
    match columns.len() {
        2 => Ok(1.0 / inverse(1)?),
        3 | 6 => {
            let (exposure_s, inverse) = (seconds(1, "the exposure")?, inverse(2)?);
            if (exposure_s * inverse - 1.0).abs() > 0.1 {
                return Err(ListError::Inverse {
                    line,
                    exposure_s,
                    inverse,
                });
            }
            Ok(exposure_s)
        }
        found => Err(ListError::Columns { line, found }),
    }
}

/// What aperture, gain and filter let through: `10^(gain/10) / (aperture²) / 10^density`, since 3 dB double the exposure in
/// these lists.
fn light(columns: &[&str], line: usize) -> Result<f64, ListError> {
    if columns.len() < 6 {
        return Ok(1.0);
    }
    let aperture = number(columns[3], line, "f/stop", "0.1 to 1000", |v| {
        (0.1..=1000.0).contains(&v)
    })?;
    let gain_db = number(columns[4], line, "gain", "-200 to 200 dB", |v| {
        (-200.0..=200.0).contains(&v)
    })?;
    let density = number(columns[5], line, "ND filter", "a density of 0 to 10", |v| {
        (0.0..=10.0).contains(&v)
    })?;
    Ok(10f64.powf(0.1 * gain_db - density) / (aperture * aperture))
}

fn number(
    text: &str,
    line: usize,
    column: &'static str,
    allowed: &'static str,
    is_allowed: impl Fn(f64) -> bool,
) -> Result<f64, ListError> {
    let value = text.parse().ok().filter(|&value| is_allowed(value));
    value.ok_or_else(|| ListError::Number {
        line,
        column,
        found: text.to_owned(),
        allowed,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn lists_are_read() {
        let text =
            "# Filename exposure 1/shutter f/stop gain ND\n\na.png 32 0.03125 8 0 0\nb.png 16 0.0625 16 3 0 # half\n";
        let pictures = parse(text).unwrap();
        assert_eq!(pictures[0].file, "a.png");
        assert_eq!(pictures[0].exposure_s, 32.0);
        // A quarter of the light through the aperture, twice the gain.
        let expected = 16.0 * 0.25 * 10f64.powf(0.3);
        assert!((pictures[1].exposure_s - expected).abs() < 1e-12);
        let short = parse("a 4\nb 0.5").unwrap();
        assert_eq!([short[0].exposure_s, short[1].exposure_s], [0.25, 2.0]);
    }

    #[test]
    fn what_is_no_list_is_refused() {
        let error = |text: &str| parse(text).unwrap_err().to_string();
        assert_eq!(error("# nothing\n"), "the list names no picture (allowed: 2 or more)");
        assert_eq!(
            error("a.png"),
            "line 1 has `1` columns (allowed: 2, name and 1/seconds; 3, with the seconds between; or 6)"
        );
        assert_eq!(
            error("a 1\nb zero"),
            "line 2: 1/shutter speed is `zero` (allowed: the inverse of 1e-9 to 86400)"
        );
        assert_eq!(
            error("a -1 2 8 0 0"),
            "line 1: the exposure is `-1` (allowed: 1e-9 to 86400)"
        );
        assert_eq!(
            error("a 2 2 8 0 0"),
            "line 1: the exposure `2` s is not the inverse of `2` (allowed: within 10 %)"
        );
        assert_eq!(error("a 2 0.5 0 0 0"), "line 1: f/stop is `0` (allowed: 0.1 to 1000)");
        assert_eq!(
            error("a nan"),
            "line 1: 1/shutter speed is `nan` (allowed: the inverse of 1e-9 to 86400)"
        );
    }

    proptest! {
        #[test]
        fn no_text_makes_it_stumble(text in "[a-z0-9.#\\-+e\t \n]{0,200}") {
            if let Ok(pictures) = parse(&text) {
                prop_assert!(!pictures.is_empty());
                prop_assert!(pictures.iter().all(|p| p.exposure_s > 0.0 && p.exposure_s.is_finite() && !p.file.is_empty()));
            }
        }

        #[test]
        fn what_is_written_is_read(times in prop::collection::vec(1e-5f64..1e3, 1..20)) {
            let text: String = times.iter().enumerate().map(|(i, t)| format!("p{i}.png {t} {} 8 0 0\n", 1.0 / t)).collect();
            let pictures = parse(&text).unwrap();
            for (i, (picture, time)) in pictures.iter().zip(&times).enumerate() {
                prop_assert_eq!(&picture.file, &format!("p{i}.png"));
                prop_assert!((picture.exposure_s / time - 1.0).abs() < 1e-12);
            }
        }
    }
}
