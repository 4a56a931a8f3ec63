//! Board files: our TOML, and Kalibr's YAML. Which one it is, the text tells.

use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::{Board, CharucoPattern};
use crate::{rig::Place, tag::Family};

/// Most markers, squares or corners in a row or column.
const MAX_COUNT: i64 = 60;

/// Largest length of anything on a board, in metres.
const MAX_LENGTH_M: f64 = 10.0;

/// Border of Kalibr's markers, in cells.
const KALIBR_BORDER_BITS: i64 = 2;

/// Largest relative difference of a square's sides in Kalibr's files.
const SQUARE_TOLERANCE: f64 = 1e-6;

/// Why a text is not a board.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoardFileError {
    /// The text is neither TOML nor YAML, or a key is unknown or of the wrong type.
    #[error("{place}: {message}")]
    Syntax {
        /// Where.
        place: Place,
        /// What the reader says.
        message: String,
    },
    /// A value is outside its range.
    #[error("{place}: `{key}` is `{found}` (allowed: {allowed})")]
    Value {
        /// Where.
        place: Place,
        /// Key.
        key: &'static str,
        /// The value.
        found: String,
        /// What may stand there.
        allowed: String,
    },
    /// A key is missing.
    #[error("`{}` lacks `{key}`, which `{kind}` needs", .file.display())]
    Missing {
        /// The file.
        file: PathBuf,
        /// Key.
        key: &'static str,
        /// Kind of the board.
        kind: &'static str,
    },
    /// A key means nothing for this kind of board.
    #[error("{place}: `{key}` means nothing for `{kind}`")]
    Unwanted {
        /// Where.
        place: Place,
        /// Key.
        key: &'static str,
        /// Kind of the board.
        kind: &'static str,
    },
}

impl BoardFileError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Syntax { .. } | Self::Missing { .. } | Self::Unwanted { .. } => Some(concat!(
                "a board file has `kind` and: `family`, `columns`, `rows`, `side_m`, `spacing_m` for \"aprilgrid\" ",
                "(`border_bits`, `first_id` if not 1 and 0); `family`, `columns`, `rows`, `square_m`, `side_m` for ",
                "\"charuco\" (`first_id`, `legacy`); `columns`, `rows`, `square_m` for \"chessboard\""
            )),
            Self::Value { .. } => None,
        }
    }
}

impl Board {
    /// Reads a board file: TOML, or Kalibr's YAML; `file` is its name for messages.
    ///
    /// TOML: `kind` is `"aprilgrid"`, `"charuco"` or `"chessboard"`. `columns` and `rows` count the markers of an AprilGrid,
    /// the squares of a ChArUco board, and the *inner corners* of a chessboard (a board of 10 by 7 squares has 9 by 6), the
    /// latter two as OpenCV does. `legacy = true` is OpenCV's legacy pattern of ChArUco boards.
    ///
    /// Kalibr: `target_type` `aprilgrid` (tag36h11 with two cells of border, as it prints them; `tagSpacing` is relative to
    /// `tagSize`) or `checkerboard` (`targetCols`, `targetRows` count inner corners).
    ///
    /// # Errors
    /// When the text is no such file, with the line where there is one.
    pub fn from_text(text: &str, file: &Path) -> Result<Self, BoardFileError> {
        let source = Source { text, file };
        if text.lines().any(|line| line.trim_start().starts_with("target_type:")) {
            source.kalibr()
        } else {
            source.own()
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoardEntry {
    kind: toml::Spanned<String>,
    family: Option<toml::Spanned<String>>,
    columns: Option<toml::Spanned<i64>>,
    rows: Option<toml::Spanned<i64>>,
    side_m: Option<toml::Spanned<f64>>,
    square_m: Option<toml::Spanned<f64>>,
    spacing_m: Option<toml::Spanned<f64>>,
    border_bits: Option<toml::Spanned<i64>>,
    first_id: Option<toml::Spanned<i64>>,
    legacy: Option<toml::Spanned<bool>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(non_snake_case, reason = "Kalibr's keys")]
struct KalibrEntry {
    target_type: serde_saphyr::Spanned<String>,
    tagCols: Option<serde_saphyr::Spanned<i64>>,
    tagRows: Option<serde_saphyr::Spanned<i64>>,
    tagSize: Option<serde_saphyr::Spanned<f64>>,
    tagSpacing: Option<serde_saphyr::Spanned<f64>>,
    codeOffset: Option<serde_saphyr::Spanned<i64>>,
    targetCols: Option<serde_saphyr::Spanned<i64>>,
    targetRows: Option<serde_saphyr::Spanned<i64>>,
    rowSpacingMeters: Option<serde_saphyr::Spanned<f64>>,
    colSpacingMeters: Option<serde_saphyr::Spanned<f64>>,
}

/// A key, what it says, and where.
#[derive(Clone, Copy)]
struct Value<T> {
    key: &'static str,
    value: T,
    line: usize,
}

/// Keys of a kind of board.
struct Keys<'a> {
    source: &'a Source<'a>,
    kind: &'static str,
    format: Format,
}

/// Whose keys they are.
#[derive(Clone, Copy)]
enum Format {
    Own,
    Kalibr,
}

/// The text being read, to turn positions into lines.
struct Source<'a> {
    text: &'a str,
    file: &'a Path,
}

impl Source<'_> {
    fn own(&self) -> Result<Board, BoardFileError> {
        let entry: BoardEntry = toml::from_str(self.text).map_err(|error| BoardFileError::Syntax {
            place: self.place(self.line(error.span().map_or(0, |span| span.start))),
            message: error.message().replace('\n', " "),
        })?;
        let whole = |key, value: &Option<toml::Spanned<i64>>| self.value(key, value);
        let length = |key, value: &Option<toml::Spanned<f64>>| self.value(key, value);
        let (columns, rows) = (whole("columns", &entry.columns), whole("rows", &entry.rows));
        let (side, square) = (length("side_m", &entry.side_m), length("square_m", &entry.square_m));
        let spacing = length("spacing_m", &entry.spacing_m);
        let (border, first) = (
            whole("border_bits", &entry.border_bits),
            whole("first_id", &entry.first_id),
        );
        let family = self.value("family", &entry.family);
        let legacy = self.value("legacy", &entry.legacy);
        match entry.kind.get_ref().as_str() {
            "aprilgrid" => {
                let keys = self.keys(Format::Own, "aprilgrid");
                keys.refuse(&[place_of(square.as_ref()), place_of(legacy.as_ref())])?;
                keys.aprilgrid(&family, [columns, rows, border, first], [side, spacing])
            }
            "charuco" => {
                let keys = self.keys(Format::Own, "charuco");
                keys.refuse(&[place_of(spacing.as_ref()), place_of(border.as_ref())])?;
                let pattern = match legacy.map(|legacy| legacy.value) {
                    Some(true) => CharucoPattern::BlackBottomLeft,
                    Some(false) | None => CharucoPattern::BlackTopLeft,
                };
                keys.charuco(&family, [columns, rows, first], [square, side], pattern)
            }
            "chessboard" => {
                let keys = self.keys(Format::Own, "chessboard");
                let others = [
                    place_of(family.as_ref()),
                    place_of(side.as_ref()),
                    place_of(spacing.as_ref()),
                    place_of(border.as_ref()),
                    place_of(first.as_ref()),
                    place_of(legacy.as_ref()),
                ];
                keys.refuse(&others)?;
                keys.chessboard([columns, rows], square)
            }
            other => Err(BoardFileError::Value {
                place: self.place(self.line(entry.kind.span().start)),
                key: "kind",
                found: other.to_owned(),
                allowed: "`aprilgrid`, `charuco`, `chessboard`".to_owned(),
            }),
        }
    }

    fn kalibr(&self) -> Result<Board, BoardFileError> {
        let entry: KalibrEntry = serde_saphyr::from_str(self.text).map_err(|error| BoardFileError::Syntax {
            place: self.place(error.location().map_or(1, |location| location.line() as usize)),
            message: error.without_snippet().to_string().replace('\n', " "),
        })?;
        let (columns, rows) = (kalibr("tagCols", &entry.tagCols), kalibr("tagRows", &entry.tagRows));
        let (size, ratio) = (
            kalibr("tagSize", &entry.tagSize),
            kalibr("tagSpacing", &entry.tagSpacing),
        );
        let first = kalibr("codeOffset", &entry.codeOffset);
        let inner = [
            kalibr("targetCols", &entry.targetCols),
            kalibr("targetRows", &entry.targetRows),
        ];
        let row_m = kalibr("rowSpacingMeters", &entry.rowSpacingMeters);
        let column_m = kalibr("colSpacingMeters", &entry.colSpacingMeters);
        match entry.target_type.value.as_str() {
            "aprilgrid" => {
                let keys = self.keys(Format::Kalibr, "aprilgrid");
                let [across, up] = &inner;
                let others = [across.as_ref(), up.as_ref()].map(place_of);
                keys.refuse(&others)?;
                keys.refuse(&[row_m.as_ref(), column_m.as_ref()].map(place_of))?;
                let line = entry.target_type.referenced.line() as usize;
                let family = Some(Value {
                    key: "target_type",
                    value: Family::Tag36h11.name().to_owned(),
                    line,
                });
                let border = Some(Value {
                    key: "target_type",
                    value: KALIBR_BORDER_BITS,
                    line,
                });
                let side = keys.length(size, "tagSize")?;
                let spacing = keys.require(ratio, "tagSpacing")?;
                keys.check(
                    &spacing,
                    |ratio| (0.01..=2.0).contains(ratio),
                    "0.01 to 2, relative to `tagSize`",
                )?;
                let spacing = Value {
                    value: spacing.value * side,
                    ..spacing
                };
                keys.aprilgrid(&family, [columns, rows, border, first], [size, Some(spacing)])
            }
            "checkerboard" => {
                let keys = self.keys(Format::Kalibr, "checkerboard");
                keys.refuse(&[columns.as_ref(), rows.as_ref(), first.as_ref()].map(place_of))?;
                keys.refuse(&[size.as_ref(), ratio.as_ref()].map(place_of))?;
                let square = keys.length(column_m, "colSpacingMeters")?;
                let row = keys.require(row_m, "rowSpacingMeters")?;
                let is_square = |row: &f64| (row / square - 1.0).abs() < SQUARE_TOLERANCE;
                keys.check(&row, is_square, "the same as `colSpacingMeters`: squares")?;
                keys.chessboard(inner, column_m)
            }
            other => Err(BoardFileError::Value {
                place: self.place(entry.target_type.referenced.line() as usize),
                key: "target_type",
                found: other.to_owned(),
                allowed: "`aprilgrid`, `checkerboard`".to_owned(),
            }),
        }
    }

    fn keys(&self, format: Format, kind: &'static str) -> Keys<'_> {
        Keys {
            source: self,
            kind,
            format,
        }
    }

    fn value<T: Clone>(&self, key: &'static str, value: &Option<toml::Spanned<T>>) -> Option<Value<T>> {
        value.as_ref().map(|value| Value {
            key,
            value: value.get_ref().clone(),
            line: self.line(value.span().start),
        })
    }

    fn line(&self, position: usize) -> usize {
        let before = &self.text.as_bytes()[..position.min(self.text.len())];
        1 + before.iter().filter(|&&byte| byte == b'\n').count()
    }

    fn place(&self, line: usize) -> Place {
        Place {
            file: self.file.to_owned(),
            line,
        }
    }
}

fn kalibr<T: Clone>(key: &'static str, value: &Option<serde_saphyr::Spanned<T>>) -> Option<Value<T>> {
    value.as_ref().map(|value| Value {
        key,
        value: value.value.clone(),
        line: value.referenced.line() as usize,
    })
}

/// Key and line of a value, if it is there.
fn place_of<T>(value: Option<&Value<T>>) -> Option<(&'static str, usize)> {
    value.map(|value| (value.key, value.line))
}

impl Keys<'_> {
    fn aprilgrid(
        &self,
        family: &Option<Value<String>>,
        [columns, rows, border_bits, first_id]: [Option<Value<i64>>; 4],
        [side, spacing]: [Option<Value<f64>>; 2],
    ) -> Result<Board, BoardFileError> {
        let family = self.family(family)?;
        let (columns, rows) = (
            self.count(columns, self.name("columns", "tagCols"), 1)?,
            self.count(rows, self.name("rows", "tagRows"), 1)?,
        );
        let border_bits = match border_bits {
            Some(bits) => {
                self.check(&bits, |bits| (1..=2).contains(bits), "1 or 2")?;
                bits.value as u32
            }
            None => 1,
        };
        Ok(Board::AprilGrid {
            family,
            columns,
            rows,
            side_m: self.length(side, "side_m")?,
            spacing_m: self.length(spacing, "spacing_m")?,
            border_bits,
            first_id: self.first_id(first_id, family, columns * rows)?,
        })
    }

    fn charuco(
        &self,
        family: &Option<Value<String>>,
        [columns, rows, first_id]: [Option<Value<i64>>; 3],
        [square, side]: [Option<Value<f64>>; 2],
        pattern: CharucoPattern,
    ) -> Result<Board, BoardFileError> {
        let family = self.family(family)?;
        let (columns, rows) = (self.count(columns, "columns", 3)?, self.count(rows, "rows", 3)?);
        let square_m = self.length(square, "square_m")?;
        let side = self.require(side, "side_m")?;
        let allowed = format!("more than 0, less than `square_m`, which is `{square_m}`");
        self.check(&side, |side| *side > 0.0 && *side < square_m, &allowed)?;
        let markers = super::markers::charuco_squares(columns, rows, pattern).count() as u32;
        Ok(Board::Charuco {
            family,
            columns,
            rows,
            square_m,
            side_m: side.value,
            first_id: self.first_id(first_id, family, markers)?,
            pattern,
        })
    }

    fn chessboard(
        &self,
        [columns, rows]: [Option<Value<i64>>; 2],
        square: Option<Value<f64>>,
    ) -> Result<Board, BoardFileError> {
        Ok(Board::Chessboard {
            columns: self.count(columns, self.name("columns", "targetCols"), 3)?,
            rows: self.count(rows, self.name("rows", "targetRows"), 3)?,
            square_m: self.length(square, self.name("square_m", "colSpacingMeters"))?,
        })
    }

    /// What a key is called in this format.
    fn name(&self, own: &'static str, kalibr: &'static str) -> &'static str {
        match self.format {
            Format::Own => own,
            Format::Kalibr => kalibr,
        }
    }

    fn family(&self, family: &Option<Value<String>>) -> Result<Family, BoardFileError> {
        let family = self.require(family.clone(), "family")?;
        family
            .value
            .parse()
            .map_err(|_| self.value_error(&family, &Family::ALL.map(|family| format!("`{family}`")).join(", ")))
    }

    fn count(&self, value: Option<Value<i64>>, key: &'static str, least: i64) -> Result<u32, BoardFileError> {
        let value = self.require(value, key)?;
        let allowed = format!("{least} to {MAX_COUNT}");
        self.check(&value, |count| (least..=MAX_COUNT).contains(count), &allowed)?;
        Ok(value.value as u32)
    }

    fn length(&self, value: Option<Value<f64>>, key: &'static str) -> Result<f64, BoardFileError> {
        let value = self.require(value, key)?;
        let allowed = format!("more than 0, at most {MAX_LENGTH_M}, in metres");
        self.check(&value, |length| *length > 0.0 && *length <= MAX_LENGTH_M, &allowed)?;
        Ok(value.value)
    }

    /// The id of the first marker, so that all markers have one.
    fn first_id(&self, value: Option<Value<i64>>, family: Family, markers: u32) -> Result<u32, BoardFileError> {
        let last = i64::from(family.codes()) - i64::from(markers);
        let value = value.unwrap_or(Value {
            key: "first_id",
            value: 0,
            line: 1,
        });
        let allowed = if last < 0 {
            format!(
                "nothing: the board has `{markers}` markers, `{family}` only `{}`",
                family.codes()
            )
        } else {
            format!(
                "0 to {last}: the board has `{markers}` markers, `{family}` has `{}`",
                family.codes()
            )
        };
        self.check(&value, |id| (0..=last).contains(id), &allowed)?;
        Ok(value.value as u32)
    }

    fn require<T>(&self, value: Option<Value<T>>, key: &'static str) -> Result<Value<T>, BoardFileError> {
        value.ok_or_else(|| BoardFileError::Missing {
            file: self.source.file.to_owned(),
            key,
            kind: self.kind,
        })
    }

    fn check<T: Display>(
        &self,
        value: &Value<T>,
        is_allowed: impl Fn(&T) -> bool,
        allowed: &str,
    ) -> Result<(), BoardFileError> {
        if is_allowed(&value.value) {
            Ok(())
        } else {
            Err(self.value_error(value, allowed))
        }
    }

    fn value_error<T: Display>(&self, value: &Value<T>, allowed: &str) -> BoardFileError {
        BoardFileError::Value {
            place: self.source.place(value.line),
            key: value.key,
            found: value.value.to_string(),
            allowed: allowed.to_owned(),
        }
    }

    fn refuse(&self, values: &[Option<(&'static str, usize)>]) -> Result<(), BoardFileError> {
        match values.iter().flatten().next() {
            None => Ok(()),
            Some(&(key, line)) => Err(BoardFileError::Unwanted {
                place: self.source.place(line),
                key,
                kind: self.kind,
            }),
        }
    }
}

#[cfg(test)]
mod tests;
