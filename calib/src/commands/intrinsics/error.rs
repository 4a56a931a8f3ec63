//! What can go wrong around a calibration.

use std::{io, path::PathBuf};

use mirrorball_calib::{board::BoardFileError, intrinsics::IntrinsicsError, rig::RigError};

use crate::commands::explain::Explain;

/// Why there is no lens.
#[derive(Debug, thiserror::Error)]
pub(crate) enum IntrinsicsCommandError {
    #[error("cannot read board file `{}`", file.display())]
    ReadBoard {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("board file `{}` is not usable", file.display())]
    Board {
        file: PathBuf,
        #[source]
        source: Box<BoardFileError>,
    },
    #[error("rig file `{}` is not usable", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("cannot read corners `{}`", file.display())]
    ReadCorners {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("`{}` is no file of corners", file.display())]
    Corners {
        file: PathBuf,
        #[source]
        source: serde_json::Error,
    },
    #[error("cannot write corners `{}`", file.display())]
    WriteCorners {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("no picture is of camera `{camera}`")]
    NoPicture { camera: String },
    #[error("the board was found in `{found}` of `{pictures}` pictures (needed: at least `{needed}`){example}")]
    NoBoard {
        found: usize,
        pictures: usize,
        needed: usize,
        example: String,
    },
    #[error(
        "camera `{camera}` of rig file `{}` takes pictures of `{}×{}` pixels, these have `{}×{}`",
        file.display(), known_px[0], known_px[1], found_px[0], found_px[1]
    )]
    Size {
        file: PathBuf,
        camera: String,
        known_px: [u32; 2],
        found_px: [u32; 2],
    },
    #[error("cannot calibrate the camera")]
    Calibrate(#[source] IntrinsicsError),
}

impl Explain for IntrinsicsCommandError {
    fn is_bad_input(&self) -> bool {
        match self {
            Self::Calibrate(error) => error.is_bad_input(),
            Self::WriteCorners { .. } => false,
            Self::ReadBoard { .. }
            | Self::Board { .. }
            | Self::Rig { .. }
            | Self::ReadCorners { .. }
            | Self::Corners { .. }
            | Self::NoPicture { .. }
            | Self::NoBoard { .. }
            | Self::Size { .. } => true,
        }
    }

    fn hint(&self) -> Option<&str> {
        match self {
            Self::ReadBoard { .. } => Some("give the TOML or YAML file that describes the board with `--board`"),
            Self::Board { source, .. } => source.hint(),
            Self::Rig { source, .. } => source.hint(),
            Self::ReadCorners { .. } | Self::Corners { .. } => Some("`--corners-out FILE` writes such a file"),
            Self::WriteCorners { .. } => None,
            Self::NoPicture { .. } => Some("name a camera of the recording with `--camera`"),
            Self::Size { .. } => {
                Some("give pictures of the size that the rig has, or name another camera with `--camera`")
            }
            Self::NoBoard { found, pictures, .. } if found == pictures => {
                Some("take 20 to 40 pictures of the board, all over the picture and tilted by 20 to 45 degrees")
            }
            Self::NoBoard { .. } => Some(
                "the board file must describe the board in the pictures; it must be sharp, well lit and not mirrored",
            ),
            Self::Calibrate(error) => Some(error.hint()),
        }
    }
}
