//! Sheets of coloured patches: what is where.

use glam::DVec2;
use serde::Deserialize;

use super::difference::{linear_rgb_from_lab_d50, linear_rgb_from_xyz};

/// Most patches of a sheet.
const MAX_PATCHES: usize = 1000;

/// Width of a ColorChecker's patch and distance between the middles of two, in metres: the classic chart of 279 × 210 mm
/// between its registration corners.
const CHECKER_PATCH_M: f64 = 0.040;
const CHECKER_PITCH_M: f64 = 0.0445;

/// Distance from the chart's corner marks to the middle of the nearest patch.
const CHECKER_MARGIN_M: [f64; 2] = [0.0282, 0.0382];

/// A sheet of patches.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchSheet {
    /// Id of the rig's marker whose frame the patches are given in.
    pub marker: Option<u32>,
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
    /// Reads a sheet: `marker` (id, optional), `corners_m` (four points, optional) and `[[patch]]` with `name`, `x_m`, `y_m`,
    /// `side_m` and, if known, `xyz` (D65, white Y = 1) or `linear_srgb`.
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
        let mut patches: Vec<Patch> = Vec::new();
        for entry in file.patch {
            if patches.iter().any(|patch| patch.name == entry.name) {
                return Err(SheetError::Twice { name: entry.name });
            }
            patches.push(entry.check()?);
        }
        Ok(Self {
            marker: file.marker,
            corners_m: file.corners_m.map(|corners| corners.map(DVec2::from)),
            patches,
        })
    }

    /// The ColorChecker Classic. Its corners are the marks outside of the patches, as they frame the chart held upright.
    #[must_use]
    pub fn color_checker() -> Self {
        let [left, bottom] = CHECKER_MARGIN_M;
        let patches = CHECKER.iter().enumerate().map(|(index, &(name, lab))| {
            let (column, row) = (index % 6, 3 - index / 6);
            Patch {
                name: name.to_owned(),
                center_m: DVec2::new(left, bottom) + CHECKER_PITCH_M * DVec2::new(column as f64, row as f64),
                side_m: CHECKER_PATCH_M,
                reference: Some(linear_rgb_from_lab_d50(lab)),
            }
        });
        let size = 2.0 * DVec2::new(left, bottom) + CHECKER_PITCH_M * DVec2::new(5.0, 3.0);
        Self {
            marker: None,
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
        Ok(Patch {
            name: self.name,
            center_m: DVec2::new(self.x_m, self.y_m),
            side_m: self.side_m,
            reference,
        })
    }
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
