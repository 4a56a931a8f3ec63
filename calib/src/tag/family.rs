//! Families of markers.

use std::{fmt, str::FromStr};

use super::apriltag;

/// A family of markers: the shape of the code and the table of codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// AprilTag 36h11 (Olson 2011): 6×6 cells, Hamming distance 11, one black cell of border, one white around it.
    Tag36h11,
    /// OpenCV's ArUco dictionaries of 4×4 cells, border as above.
    Aruco4x4(DictionarySize),
    /// Those of 5×5 cells.
    Aruco5x5(DictionarySize),
    /// Those of 6×6 cells.
    Aruco6x6(DictionarySize),
}

/// How many codes of an ArUco dictionary are in use; smaller dictionaries are the first codes of larger ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DictionarySize {
    /// 50 codes.
    N50,
    /// 100 codes.
    N100,
    /// 250 codes.
    N250,
    /// 1000 codes.
    N1000,
}

/// The name is not that of a family.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown marker family `{found}` (allowed: `tag36h11`, and `aruco_4x4_50` and the like: 4x4, 5x5 or 6x6, 50, 100, 250 or 1000)"
)]
pub struct UnknownFamily {
    /// The name.
    pub found: String,
}

impl Family {
    /// Every family that can be detected.
    pub const ALL: [Self; 13] = {
        use DictionarySize::{N50, N100, N250, N1000};
        [
            Self::Tag36h11,
            Self::Aruco4x4(N50),
            Self::Aruco4x4(N100),
            Self::Aruco4x4(N250),
            Self::Aruco4x4(N1000),
            Self::Aruco5x5(N50),
            Self::Aruco5x5(N100),
            Self::Aruco5x5(N250),
            Self::Aruco5x5(N1000),
            Self::Aruco6x6(N50),
            Self::Aruco6x6(N100),
            Self::Aruco6x6(N250),
            Self::Aruco6x6(N1000),
        ]
    };

    /// Name, as in rig and board files; as in AprilRobotics' library, or `aruco_4x4_50` for OpenCV's `DICT_4X4_50`.
    #[must_use]
    pub fn name(self) -> &'static str {
        use DictionarySize::{N50, N100, N250, N1000};
        match self {
            Self::Tag36h11 => "tag36h11",
            Self::Aruco4x4(N50) => "aruco_4x4_50",
            Self::Aruco4x4(N100) => "aruco_4x4_100",
            Self::Aruco4x4(N250) => "aruco_4x4_250",
            Self::Aruco4x4(N1000) => "aruco_4x4_1000",
            Self::Aruco5x5(N50) => "aruco_5x5_50",
            Self::Aruco5x5(N100) => "aruco_5x5_100",
            Self::Aruco5x5(N250) => "aruco_5x5_250",
            Self::Aruco5x5(N1000) => "aruco_5x5_1000",
            Self::Aruco6x6(N50) => "aruco_6x6_50",
            Self::Aruco6x6(N100) => "aruco_6x6_100",
            Self::Aruco6x6(N250) => "aruco_6x6_250",
            Self::Aruco6x6(N1000) => "aruco_6x6_1000",
        }
    }

    /// Number of codes; ids are below it.
    #[must_use]
    pub fn codes(self) -> u32 {
        match self {
            Self::Tag36h11 => 587,
            Self::Aruco4x4(size) | Self::Aruco5x5(size) | Self::Aruco6x6(size) => match size {
                DictionarySize::N50 => 50,
                DictionarySize::N100 => 100,
                DictionarySize::N250 => 250,
                DictionarySize::N1000 => 1000,
            },
        }
    }

    /// Cells along a side of the code, without border.
    #[must_use]
    pub fn cells_per_side(self) -> u32 {
        match self {
            Self::Aruco4x4(_) => 4,
            Self::Aruco5x5(_) => 5,
            Self::Tag36h11 | Self::Aruco6x6(_) => 6,
        }
    }

    /// The cells of a marker's code, row by row from the top-left of the upright marker; true is white. `None` where there
    /// is no such id.
    #[must_use]
    pub fn cells(self, id: u32) -> Option<Vec<bool>> {
        let cells = self.cells_per_side() * self.cells_per_side();
        let code = match self {
            Self::Tag36h11 => apriltag::tag36h11_rows(id)?,
            Self::Aruco4x4(_) | Self::Aruco5x5(_) | Self::Aruco6x6(_) => {
                *self.dictionary().get(usize::try_from(id).ok()?)?
            }
        };
        Some((0..cells).rev().map(|bit| code >> bit & 1 == 1).collect())
    }

    /// The codes of an ArUco dictionary: cells row by row, the first the most significant bit. Empty for other families.
    pub(super) fn dictionary(self) -> Vec<u64> {
        let table = match self {
            Self::Tag36h11 => "",
            Self::Aruco4x4(_) => include_str!("codes/aruco_4x4.txt"),
            Self::Aruco5x5(_) => include_str!("codes/aruco_5x5.txt"),
            Self::Aruco6x6(_) => include_str!("codes/aruco_6x6.txt"),
        };
        table
            .lines()
            .filter(|line| !line.starts_with('#'))
            .flat_map(str::split_whitespace)
            .map(|code| u64::from_str_radix(code, 16).expect("tested: the table holds hexadecimal numbers"))
            .take(self.codes() as usize)
            .collect()
    }
}

impl fmt::Display for Family {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Family {
    type Err = UnknownFamily;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let family = Self::ALL.into_iter().find(|family| family.name() == name);
        family.ok_or_else(|| UnknownFamily { found: name.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for family in Family::ALL {
            assert_eq!(family.to_string().parse(), Ok(family));
        }
        let error = "tag25h9".parse::<Family>().unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("unknown marker family `tag25h9` (allowed: `tag36h11`"),
            "{error}"
        );
    }

    fn rows(family: Family, id: u32) -> Vec<String> {
        let cells = family.cells(id).unwrap();
        let side = family.cells_per_side() as usize;
        let row = |row: &[bool]| row.iter().map(|&white| if white { '.' } else { '#' }).collect();
        cells.chunks(side).map(row).collect()
    }

    /// As printed by AprilRobotics (apriltag-imgs) and drawn by OpenCV 5.0 (`generateImageMarker`).
    #[test]
    fn codes_are_those_of_the_printed_markers() {
        use DictionarySize::{N50, N250, N1000};
        let tag = rows(Family::Tag36h11, 586);
        assert_eq!(tag, ["...#.#", "####..", ".#....", ".##.##", ".#..#.", "..##.."]);
        assert_eq!(rows(Family::Aruco4x4(N50), 0), [".#..", "#.#.", "##..", "##.#"]);
        assert_eq!(rows(Family::Aruco4x4(N1000), 999), ARUCO_4X4_999);
        assert_eq!(rows(Family::Aruco5x5(N1000), 999), ARUCO_5X5_999);
        assert_eq!(rows(Family::Aruco6x6(N250), 249), ARUCO_6X6_249);
    }

    const ARUCO_4X4_999: [&str; 4] = ["....", "#...", ".#..", "...."];
    const ARUCO_5X5_999: [&str; 5] = [".....", "#....", "##.##", ".####", "...#."];
    const ARUCO_6X6_249: [&str; 6] = ["#...##", "####..", "..#.##", "...###", ".#.##.", ".#####"];

    #[test]
    fn tables_have_as_many_codes_as_they_say() {
        for family in Family::ALL {
            assert!(family.cells(family.codes() - 1).is_some(), "{family}");
            assert_eq!(family.cells(family.codes()), None, "{family}");
        }
    }
}
