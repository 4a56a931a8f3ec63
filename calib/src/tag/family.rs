//! Families of markers.

use std::{fmt, str::FromStr};

use super::Cell;

/// A family of markers: the shape of the code and the table of codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// AprilTag 36h11 (Olson 2011): 6×6 cells, Hamming distance 11, one black cell of border, one white around it.
    Tag36h11,
    /// AprilTag 25h9: 5×5 cells, border as above.
    Tag25h9,
    /// AprilTag 16h5: 4×4 cells, border as above. Things that are no markers look like one of its codes now and then.
    Tag16h5,
    /// AprilTag 3's standard family (Krogius et al. 2019): 3×3 cells within a white ring within a black one, and a ring of
    /// cells around it. Its corners are those between the white and the black ring.
    TagStandard41h12,
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
    "unknown marker family `{found}` (allowed: `tag36h11`, `tag25h9`, `tag16h5`, `tagStandard41h12`, and `aruco_4x4_50` and the like: 4x4, 5x5 or 6x6, 50, 100, 250 or 1000)"
)]
pub struct UnknownFamily {
    /// The name.
    pub found: String,
}

impl Family {
    /// Every family that can be detected.
    pub const ALL: [Self; 16] = {
        use DictionarySize::{N50, N100, N250, N1000};
        [
            Self::Tag36h11,
            Self::Tag25h9,
            Self::Tag16h5,
            Self::TagStandard41h12,
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
            Self::Tag25h9 => "tag25h9",
            Self::Tag16h5 => "tag16h5",
            Self::TagStandard41h12 => "tagStandard41h12",
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
            Self::Tag25h9 => 35,
            Self::Tag16h5 => 30,
            Self::TagStandard41h12 => 2115,
            Self::Aruco4x4(size) | Self::Aruco5x5(size) | Self::Aruco6x6(size) => match size {
                DictionarySize::N50 => 50,
                DictionarySize::N100 => 100,
                DictionarySize::N250 => 250,
                DictionarySize::N1000 => 1000,
            },
        }
    }

    /// A marker's code, its cells row by row from the top-left of the upright marker, the first the most significant bit; 1
    /// is white. `None` where there is no such id.
    #[must_use]
    pub fn code(self, id: u32) -> Option<u64> {
        self.table().codes.get(id as usize).copied()
    }

    /// Cells and codes of the family, from its file.
    pub(super) fn table(self) -> Table {
        let text = match self {
            Self::Tag36h11 => include_str!("codes/tag36h11.txt"),
            Self::Tag25h9 => include_str!("codes/tag25h9.txt"),
            Self::Tag16h5 => include_str!("codes/tag16h5.txt"),
            Self::TagStandard41h12 => include_str!("codes/tagStandard41h12.txt"),
            Self::Aruco4x4(_) => include_str!("codes/aruco_4x4.txt"),
            Self::Aruco5x5(_) => include_str!("codes/aruco_5x5.txt"),
            Self::Aruco6x6(_) => include_str!("codes/aruco_6x6.txt"),
        };
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let first = lines.next().expect("tested: the table has cells");
        let mut rows = vec![row_of_cells(first)];
        rows.extend(lines.by_ref().take(first.len() - 1).map(row_of_cells));
        let codes = lines
            .flat_map(str::split_whitespace)
            .map(|code| u64::from_str_radix(code, 16).expect("tested: the table holds hexadecimal numbers"))
            .take(self.codes() as usize)
            .collect();
        Table { rows, codes }
    }
}

/// A family's cells, ring of white or code included, row by row, and its codes.
pub(super) struct Table {
    pub(super) rows: Vec<Vec<Cell>>,
    pub(super) codes: Vec<u64>,
}

fn row_of_cells(line: &str) -> Vec<Cell> {
    let cell = |letter| match letter {
        'b' => Cell::Black,
        'w' => Cell::White,
        'd' => Cell::Code,
        _ => panic!("tested: the table has cells of `b`, `w` and `d`"),
    };
    line.chars().map(cell).collect()
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
    use crate::tag::Layout;

    #[test]
    fn names_round_trip() {
        for family in Family::ALL {
            assert_eq!(family.to_string().parse(), Ok(family));
        }
        let error = "tag36h10".parse::<Family>().unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("unknown marker family `tag36h10` (allowed: `tag36h11`"),
            "{error}"
        );
    }

    /// The cells of the code alone, row by row; families whose code is a square.
    fn rows(family: Family, id: u32) -> Vec<String> {
        let layout = Layout::new(family, 1);
        let side = layout.quad_cells() - 2;
        let picture = layout.picture(family.code(id).unwrap());
        let row = |row: &Vec<bool>| {
            row[2..2 + side]
                .iter()
                .map(|&white| if white { '.' } else { '#' })
                .collect()
        };
        picture[2..2 + side].iter().map(row).collect()
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
            assert!(family.code(family.codes() - 1).is_some(), "{family}");
            assert_eq!(family.code(family.codes()), None, "{family}");
        }
    }
}
