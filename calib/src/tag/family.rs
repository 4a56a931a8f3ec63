//! Families of markers.

use std::{fmt, str::FromStr};

/// A family of markers: the shape of the code and the table of codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// AprilTag 36h11 (Olson 2011): 6×6 cells, Hamming distance 11, one black cell of border, one white around it.
    Tag36h11,
}

/// The name is not that of a family.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown marker family `{found}` (allowed: `tag36h11`)")]
pub struct UnknownFamily {
    /// The name.
    pub found: String,
}

impl Family {
    /// Every family that can be detected.
    pub const ALL: [Self; 1] = [Self::Tag36h11];

    /// Name, as in AprilRobotics' library and in rig files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tag36h11 => "tag36h11",
        }
    }

    /// Number of codes; ids are below it.
    #[must_use]
    pub fn codes(self) -> u32 {
        match self {
            Self::Tag36h11 => 587,
        }
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
        assert_eq!(
            error.to_string(),
            "unknown marker family `tag25h9` (allowed: `tag36h11`)"
        );
    }
}
