//! What can go wrong with a picture of the probe.

use std::path::PathBuf;

use mirrorball_calib::{probe::NoProbe, resection::NoPose};

/// Why there is no map of the light.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ProbeError {
    #[error(
        "picture `{}` has `{}×{}` pixels, camera `{camera}` takes `{}×{}`",
        file.display(), found[0], found[1], expected[0], expected[1]
    )]
    Size {
        file: PathBuf,
        camera: String,
        found: [u32; 2],
        expected: [u32; 2],
    },
    #[error("the exposure of picture `{}` is not known", file.display())]
    NoExposure { file: PathBuf },
    #[error("the {what} of picture `{}` is `{found}` (allowed: {allowed})", file.display())]
    Exposure {
        file: PathBuf,
        what: &'static str,
        found: String,
        allowed: &'static str,
    },
    #[error("the room's distance is `{found} m` (allowed: 0.1 to 1e6)")]
    RoomDistance { found: f32 },
    #[error("`{}` was taken by camera `{recorded}`, not by `{asked}`", file.display())]
    OtherCamera {
        file: PathBuf,
        recorded: String,
        asked: String,
    },
    #[error("where camera `{camera}` was when it took `{}` is not known", file.display())]
    Pose {
        file: PathBuf,
        camera: String,
        #[source]
        source: NoPose,
    },
    #[error("the rig has no light probe for camera `{camera}`")]
    NoProbe {
        camera: String,
        #[source]
        source: NoProbe,
    },
    #[error("picture `{}` does not show the probe: {place}", file.display())]
    NotSeen { file: PathBuf, place: String },
    #[error("all that picture `{}` shows of the light is clipped", file.display())]
    AllClipped { file: PathBuf },
    #[error("all that picture `{}` shows of the light is black", file.display())]
    AllBlack { file: PathBuf },
    #[error("no picture was given (allowed: one or more)")]
    NoPicture,
    #[error("`{found}` exposure times were given for `{pictures}` pictures (allowed: one for all, or one each)")]
    ExposureTimes { found: usize, pictures: usize },
    #[error("cannot write `{}`", file.display())]
    Write {
        file: PathBuf,
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl ProbeError {
    /// Whether the input is to blame, and not the place where the result goes.
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            Self::Write { .. } => false,
            Self::Size { .. }
            | Self::NoExposure { .. }
            | Self::Exposure { .. }
            | Self::RoomDistance { .. }
            | Self::OtherCamera { .. }
            | Self::Pose { .. }
            | Self::NoProbe { .. }
            | Self::NotSeen { .. }
            | Self::AllClipped { .. }
            | Self::AllBlack { .. }
            | Self::NoPicture
            | Self::ExposureTimes { .. } => true,
        }
    }

    /// What to do about it.
    pub(crate) fn hint(&self) -> &'static str {
        match self {
            Self::Size { .. } => "`size_px` in the rig file must be the size of the camera's pictures",
            Self::NoExposure { .. } => {
                "give `--exposure-s`, `--gain` and `--wb`, or a picture in a recording with `frames.csv`"
            }
            Self::Exposure { .. } => "give the exposure in force when the picture was taken",
            Self::RoomDistance { .. } => "give `--room-distance-m` in metres",
            Self::OtherCamera { .. } => "leave out `--camera`, or give a picture of that camera",
            Self::Pose { .. } => "at least one marker of the rig must be sharp, whole and well lit in the picture",
            Self::NoProbe { .. } => "choose the camera that films the ball, or the fisheye camera, with `--camera`",
            Self::NotSeen { .. } => "the ball must be in the picture, where `[ball]` in the rig file says that it is",
            Self::AllClipped { .. } => "expose shorter, or check `--exposure-s` and the rig's `response`",
            Self::AllBlack { .. } => "expose longer, and check that the lens is open",
            Self::NoPicture => "name a picture of the probe",
            Self::ExposureTimes { .. } => {
                "give `--exposure-s` times in the order of the pictures, with commas between them"
            }
            Self::Write { .. } => "give a folder that can be written with `--out`",
        }
    }
}
