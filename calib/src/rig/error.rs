//! What can be wrong with a rig file.

use std::{fmt, path::PathBuf};

use crate::{camera::UnknownModel, pose::PoseError, response::ResponseError};

/// A line of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Name of the file, as given by the caller.
    pub file: PathBuf,
    /// Line, from 1.
    pub line: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "`{}`, line {}", self.file.display(), self.line)
    }
}

/// Why a text is not a rig.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// The text is no TOML, or a key is unknown, missing or of the wrong type.
    #[error("{place}: {message}")]
    Syntax {
        /// Where.
        place: Place,
        /// What the TOML reader says, with the keys it expects.
        message: String,
    },
    /// The file was written by a newer version of the program.
    #[error("{place}: `version` is `{found}`, from a newer program (this one knows up to `{known}`)")]
    Newer {
        /// Where.
        place: Place,
        /// The version.
        found: i128,
        /// The newest one that is known.
        known: i128,
    },
    /// A value is outside its range.
    #[error("{place}: `{key}` is `{found}` (allowed: {allowed})")]
    Value {
        /// Where.
        place: Place,
        /// Key, with the tables it is in.
        key: String,
        /// The value.
        found: String,
        /// What may stand there.
        allowed: String,
    },
    /// The lens model is not one that this program knows.
    #[error("{place}: {model}")]
    LensModel {
        /// Where.
        place: Place,
        /// The model, and those that there are.
        model: UnknownModel,
    },
    /// A matrix is not a pose.
    #[error("{place}: `{key}` is not a pose")]
    Pose {
        /// Where.
        place: Place,
        /// Key, with the tables it is in.
        key: String,
        /// What is wrong with the matrix.
        source: PoseError,
    },
    /// A list is not a response curve.
    #[error("{place}: `camera.photometry.response` is not a response curve")]
    Response {
        /// Where.
        place: Place,
        /// What is wrong with the list.
        source: ResponseError,
    },
    /// A key that this entry needs is missing, or one that it cannot have is there.
    #[error("{place}: {subject} {problem}")]
    Entry {
        /// Where the entry begins.
        place: Place,
        /// The entry.
        subject: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// Two entries have the same name or id.
    #[error("{place}: {kind} `{found}` is there twice (allowed: once)")]
    Duplicate {
        /// Where the second one is.
        place: Place,
        /// What is there twice.
        kind: &'static str,
        /// Its name or id.
        found: String,
    },
    /// The rig has no marker.
    #[error("`{}` has no marker (allowed: one `[[marker]]` or more)", .file.display())]
    NoMarkers {
        /// The file.
        file: PathBuf,
    },
    /// The rig does not say which marker defines the world.
    #[error("`{}` has no `main_marker` (allowed: the id of one `[[marker]]`)", .file.display())]
    NoMainMarker {
        /// The file.
        file: PathBuf,
    },
    /// The main marker is not among the markers.
    #[error("{place}: `main_marker` is `{found}`, but no `[[marker]]` has that id (there are: {present})")]
    MainMarkerMissing {
        /// Where.
        place: Place,
        /// The id.
        found: u32,
        /// Ids of the markers.
        present: String,
    },
    /// The main marker does not define the world.
    #[error("{place}: `world_from_marker` of the main marker `{id}` is not the identity")]
    MainMarkerMoved {
        /// Where.
        place: Place,
        /// The id.
        id: u32,
    },
    /// The wrong number of cameras has a role.
    #[error("`{}` has {found} cameras with role {role} (allowed: {allowed})", .file.display())]
    Roles {
        /// The file.
        file: PathBuf,
        /// The role or roles.
        role: &'static str,
        /// Number of such cameras.
        found: usize,
        /// How many there may be.
        allowed: &'static str,
    },
    /// There is neither a ball nor a fisheye camera.
    #[error("`{}` has neither a `[ball]` nor a camera with role `fisheye`", .file.display())]
    NoBall {
        /// The file.
        file: PathBuf,
    },
}

impl RigError {
    /// What to do about it, if there is something to say beyond the message.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Syntax { .. } => Some("`configs/README.md` lists every key of `rig.toml`"),
            Self::LensModel { .. } => Some(concat!(
                "`brown_conrady` takes OpenCV's k1 k2 p1 p2 k3, `rational` its k1 k2 p1 p2 k3 k4 k5 k6, `kannala_brandt` its ",
                "fisheye k1 k2 k3 k4, `equisolid` nothing, `eucm` alpha beta, `double_sphere` xi alpha"
            )),
            Self::Pose { .. } => {
                Some("a pose is three rows `[r00, r01, r02, t]` of a rotation and a translation in metres")
            }
            Self::NoMarkers { .. } => {
                Some("add a `[[marker]]` with `family`, `id`, `side_m` and `world_from_marker` for every printed tag")
            }
            Self::MainMarkerMoved { .. } => {
                Some("the main marker defines the world: give the other poses relative to it")
            }
            Self::NoBall { .. } => Some("the light is read from a mirror ball or a fisheye camera: describe one"),
            Self::Newer { .. } => Some("take the program that wrote the file, or a newer one"),
            Self::NoMainMarker { .. } => Some("run `mirrorball-calib markers`, or write which marker is the world"),
            Self::Value { .. }
            | Self::Response { .. }
            | Self::Entry { .. }
            | Self::Duplicate { .. }
            | Self::MainMarkerMissing { .. }
            | Self::Roles { .. } => None,
        }
    }
}
