//! Sheets of coloured patches: what is where.

use glam::DVec2;
use serde::Deserialize;

use super::difference::{linear_rgb_from_lab_d50, linear_rgb_from_xyz};

/// Most patches of a sheet.
const MAX_PATCHES: usize = 1000;

/// Width of a ColorChecker's patch and distance between the middles of two, in metres, on the classic chart of 279 × 210 mm.
///
/// Editions differ: a patch is 0.876 of the distance in ArgyllCMS' `ref/ColorChecker.cht`, 0.909 in OpenCV's `mcc` module. Placed by
/// the patches' own outer corners, the middles then differ by less than a hundredth of the distance, far less than the margin of
/// each patch that is not read.
const CHECKER_PATCH_M: f64 = 0.040;
const CHECKER_PITCH_M: f64 = 0.0445;

/// From this lightness and to this chroma (L*a*b*) a patch of the ColorChecker is grey: not its black, which is mostly gloss.
const GREY_LIGHTNESS: f64 = 30.0;
const GREY_CHROMA: f64 = 4.0;

/// A sheet of patches.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchSheet {
    /// Id of the rig's marker whose frame the patches are given in.
    pub marker: Option<u32>,
    /// Side of the black square of that marker in metres, if it is printed on the sheet: it then says by itself where the sheet is, and
    /// need not be in the rig. Its family is tag36h11.
    pub marker_side_m: Option<f64>,
    /// Points of the sheet by which it can be placed by hand: bottom-left, bottom-right, top-right, top-left, in metres.
    pub corners_m: Option<[DVec2; 4]>,
    /// The patches; at least one, names unique.
    pub patches: Vec<Patch>,
}

/// One patch.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// Name, unique on the sheet.
    pub name: String,
    /// Its middle on the sheet, in metres.
    pub center_m: DVec2,
    /// Its side, in metres.
    pub side_m: f64,
    /// Its colour as linear Rec. 709, 1 for a perfect white, if known.
    pub reference: Option<[f64; 3]>,
    /// Whether it is white or grey, so that cameras' white balance can be compared by it.
    pub is_neutral: bool,
    /// What a printer is told, sRGB; `None` for the bare paper, and for patches that are not printed.
    pub print: Option<[u8; 3]>,
}

/// Why a text is not a sheet of patches.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SheetError {
    /// No TOML, or an unknown or missing key.
    #[error("{0}")]
    Syntax(String),
    /// No patches, or too many.
    #[error("the sheet has `{found}` patches (allowed: 1 to 1000)")]
    Count {
        /// Number of patches.
        found: usize,
    },
    /// A marker's side that cannot be, or the side of no marker.
    #[error("`marker_side_m` is not allowed (allowed: finite and above 0, with `marker`)")]
    MarkerSide,
    /// A colour that cannot be read.
    #[error("`print` of patch `{name}` is `{found}` (allowed: `#` and six hexadecimal digits)")]
    Print {
        /// Name of the patch.
        name: String,
        /// The text.
        found: String,
    },
    /// A name twice.
    #[error("two patches have the name `{name}`")]
    Twice {
        /// The name.
        name: String,
    },
    /// A number that cannot be.
    #[error("`{key}` of patch `{name}` is not allowed (allowed: finite; `side_m` above 0)")]
    Number {
        /// Name of the patch.
        name: String,
        /// Key of the number.
        key: &'static str,
    },
    /// The colour is given twice.
    #[error("patch `{name}` has both `xyz` and `linear_srgb` (allowed: one of them)")]
    TwoReferences {
        /// Name of the patch.
        name: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SheetFile {
    marker: Option<u32>,
    marker_side_m: Option<f64>,
    corners_m: Option<[[f64; 2]; 4]>,
    #[serde(default)]
    patch: Vec<PatchEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PatchEntry {
    name: String,
    x_m: f64,
    y_m: f64,
    side_m: f64,
    xyz: Option<[f64; 3]>,
    linear_srgb: Option<[f64; 3]>,
    #[serde(default)]
    neutral: bool,
    print: Option<String>,
}

/// Names and colours of the ColorChecker Classic, row by row from the top left: L*a*b* under D50 (X-Rite, charts made since
/// November 2014).
const CHECKER: [(&str, [f64; 3]); 24] = [
    ("dark skin", [37.54, 14.37, 14.92]),
    ("light skin", [64.66, 19.27, 17.50]),
    ("blue sky", [49.32, -3.82, -22.54]),
    ("foliage", [43.46, -12.74, 22.72]),
    ("blue flower", [54.94, 9.61, -24.79]),
    ("bluish green", [70.48, -32.26, -0.37]),
    ("orange", [62.73, 35.83, 56.50]),
    ("purplish blue", [39.43, 10.75, -45.17]),
    ("moderate red", [50.57, 48.64, 16.67]),
    ("purple", [30.10, 22.54, -20.87]),
    ("yellow green", [71.77, -24.13, 58.19]),
    ("orange yellow", [71.51, 18.24, 67.37]),
    ("blue", [28.37, 15.42, -49.80]),
    ("green", [54.38, -39.72, 32.27]),
    ("red", [42.43, 51.05, 28.62]),
    ("yellow", [81.80, 2.67, 80.41]),
    ("magenta", [50.63, 51.28, -14.12]),
    ("cyan", [49.57, -29.71, -28.32]),
    ("white", [95.19, -1.03, 2.93]),
    ("neutral 8", [81.29, -0.57, 0.44]),
    ("neutral 6.5", [66.89, -0.75, -0.06]),
    ("neutral 5", [50.76, -0.13, 0.14]),
    ("neutral 3.5", [35.63, -0.46, -0.48]),
    ("black", [20.64, 0.07, -0.46]),
];

impl PatchSheet {
    /// Reads a sheet: `marker` (id, optional), `marker_side_m` (optional), `corners_m` (four points, optional) and `[[patch]]` with `name`, `x_m`, `y_m`,
    /// `side_m` and, if known, `xyz` (D65, white Y = 1) or `linear_srgb`; `neutral = true` says that it is white or grey, `print` (as
    /// `"#rrggbb"`) how it is printed.
    ///
    /// # Errors
    /// When the text is not such a sheet.
    pub fn from_toml(text: &str) -> Result<Self, SheetError> {
        let file: SheetFile = toml::from_str(text).map_err(|error| SheetError::Syntax(error.to_string()))?;
        if !(1..=MAX_PATCHES).contains(&file.patch.len()) {
            return Err(SheetError::Count {
                found: file.patch.len(),
            });
        }
        let is_side = |side: f64| side > 0.0 && side.is_finite() && file.marker.is_some();
        if !file.marker_side_m.is_none_or(is_side) {
            return Err(SheetError::MarkerSide);
        }
        let mut patches: Vec<Patch> = Vec::new();
        for entry in file.patch {
            if patches.iter().any(|patch| patch.name == entry.name) {
                return Err(SheetError::Twice { name: entry.name });
            }
            patches.push(entry.check()?);
        }
        Ok(Self {
            marker: file.marker,
            marker_side_m: file.marker_side_m,
            corners_m: file.corners_m.map(|corners| corners.map(DVec2::from)),
            patches,
        })
    }

    /// The sheet to print: greys and colours around a marker (see [`super::print`]).
    #[must_use]
    pub fn printed() -> Self {
        Self::from_toml(include_str!("sheet.toml")).expect("the sheet is valid, as its test shows")
    }

    /// Corners of the sheet's own marker: bottom-left, bottom-right, top-right, top-left; `None` without `marker_side_m`.
    #[must_use]
    pub fn marker_corners_m(&self) -> Option<[DVec2; 4]> {
        let half = 0.5 * self.marker_side_m?;
        Some([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|corner| half * DVec2::from(corner)))
    }

    /// The ColorChecker Classic. Its corners are the outer corners of its four corner patches (not the marks in the frame, whose
    /// place differs between editions), of the chart held upright.
    #[must_use]
    pub fn color_checker() -> Self {
        let patches = CHECKER.iter().enumerate().map(|(index, &(name, lab))| {
            let (column, row) = (index % 6, 3 - index / 6);
            Patch {
                name: name.to_owned(),
                center_m: DVec2::splat(0.5 * CHECKER_PATCH_M) + CHECKER_PITCH_M * DVec2::new(column as f64, row as f64),
                side_m: CHECKER_PATCH_M,
                reference: Some(linear_rgb_from_lab_d50(lab)),
                is_neutral: lab[0] > GREY_LIGHTNESS && lab[1].hypot(lab[2]) < GREY_CHROMA,
                print: None,
            }
        });
        let size = 2.0 * DVec2::splat(0.5 * CHECKER_PATCH_M) + CHECKER_PITCH_M * DVec2::new(5.0, 3.0);
        Self {
            marker: None,
            marker_side_m: None,
            corners_m: Some([DVec2::ZERO, DVec2::new(size.x, 0.0), size, DVec2::new(0.0, size.y)]),
            patches: patches.collect(),
        }
    }
}

impl PatchEntry {
    fn check(self) -> Result<Patch, SheetError> {
        let number = |key: &'static str, is_allowed: bool| {
            let name = self.name.clone();
            if is_allowed {
                Ok(())
            } else {
                Err(SheetError::Number { name, key })
            }
        };
        let finite = |values: &Option<[f64; 3]>| values.iter().flatten().all(|value| value.is_finite());
        number("x_m", self.x_m.is_finite())?;
        number("y_m", self.y_m.is_finite())?;
        number("side_m", self.side_m > 0.0 && self.side_m.is_finite())?;
        number("xyz", finite(&self.xyz))?;
        number("linear_srgb", finite(&self.linear_srgb))?;
        let reference = match (self.xyz, self.linear_srgb) {
            (Some(_), Some(_)) => return Err(SheetError::TwoReferences { name: self.name }),
            (Some(xyz), None) => Some(linear_rgb_from_xyz(xyz)),
            (None, rgb) => rgb,
        };
        let print = match &self.print {
            None => None,
            Some(text) => Some(print_color(text).ok_or_else(|| SheetError::Print {
                name: self.name.clone(),
                found: text.clone(),
            })?),
        };
        Ok(Patch {
            name: self.name,
            center_m: DVec2::new(self.x_m, self.y_m),
            side_m: self.side_m,
            reference,
            is_neutral: self.neutral,
            print,
        })
    }
}

/// Red, green, blue of `#rrggbb`.
fn print_color(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6)?;
    if !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    let [_, red, green, blue] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
    Some([red, green, blue])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_are_read() {
        let text = "marker = 3\n[[patch]]\nname = \"grey\"\nx_m = 0.06\ny_m = -0.02\nside_m = 0.02\nlinear_srgb = [0.2, 0.2, 0.2]\n\
                    [[patch]]\nname = \"white\"\nx_m = 0.09\ny_m = -0.02\nside_m = 0.02\nxyz = [0.9505, 1.0, 1.0888]\n";
        let sheet = PatchSheet::from_toml(text).unwrap();
        assert_eq!(sheet.marker, Some(3));
        assert_eq!(sheet.patches[0].center_m, DVec2::new(0.06, -0.02));
        let white = sheet.patches[1].reference.unwrap();
        assert!(white.iter().all(|value| (value - 1.0).abs() < 1e-3), "{white:?}");
        let error = |from: &str, to: &str| {
            PatchSheet::from_toml(&text.replacen(from, to, 1))
                .unwrap_err()
                .to_string()
        };
        assert_eq!(error("\"white\"", "\"grey\""), "two patches have the name `grey`");
        assert_eq!(
            error("side_m = 0.02", "side_m = 0.0"),
            "`side_m` of patch `grey` is not allowed (allowed: finite; `side_m` above 0)"
        );
        assert_eq!(
            error("xyz", "print = \"#12345\"\nxyz"),
            "`print` of patch `white` is `#12345` (allowed: `#` and six hexadecimal digits)"
        );
        assert_eq!(
            error("marker = 3", "marker_side_m = 0.1"),
            "`marker_side_m` is not allowed (allowed: finite and above 0, with `marker`)"
        );
        assert!(error("marker", "maker").contains("unknown field `maker`"));
        assert_eq!(
            PatchSheet::from_toml("marker = 1").unwrap_err(),
            SheetError::Count { found: 0 }
        );
    }

    #[test]
    fn the_color_checker_is_as_known() {
        let sheet = PatchSheet::color_checker();
        let of = |name: &str| sheet.patches.iter().find(|patch| patch.name == name).unwrap();
        // The grey row is at the bottom, brightest at the left.
        let (white, black) = (of("white"), of("black"));
        assert!(white.center_m.x < black.center_m.x && white.center_m.y < of("dark skin").center_m.y);
        // The chart is symmetric about its middle.
        let [_, _, size, _] = sheet.corners_m.unwrap();
        assert!((size - of("bluish green").center_m).distance(white.center_m) < 1e-12);
        let neutral: Vec<&str> = sheet
            .patches
            .iter()
            .filter(|patch| patch.is_neutral)
            .map(|patch| patch.name.as_str())
            .collect();
        assert_eq!(
            neutral,
            ["white", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5"]
        );
        // Computed apart, with the same tables: dark skin and cyan.
        for (name, expected) in [
            ("dark skin", [0.1737, 0.0788, 0.0528]),
            ("cyan", [-0.0439, 0.2337, 0.3772]),
        ] {
            let found = of(name).reference.unwrap();
            assert!(
                found
                    .iter()
                    .zip(expected)
                    .all(|(found, expected)| (found - expected).abs() < 1e-3),
                "{found:?}"
            );
        }
    }
}
