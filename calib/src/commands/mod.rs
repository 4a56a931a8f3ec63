//! The program's commands, and what can go wrong in them.

pub(crate) mod ball;
pub(crate) mod check;
pub(crate) mod color;
pub(crate) mod convert;
mod csv;
pub(crate) mod detect;
pub(crate) mod display;
mod explain;
pub(crate) mod extrinsics;
pub(crate) mod hand_eye;
mod input;
pub(crate) mod intrinsics;
pub(crate) mod markers;
mod mask;
pub(crate) mod merge;
mod output;
pub(crate) mod photometric;
pub(crate) mod probe;
mod progress;
mod sightings;
pub(crate) mod timing;
mod view_list;

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::ExitCode,
};

use mirrorball_calib::{
    rig::{Rig, RigError, RigParts, check::RigMismatch},
    tag::{Family, PictureError},
};
use mirrorball_capture::{Pace, Repeat, SourceError, recording::mcap::McapPlayer};

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CommandError {
    #[error("cannot read rig file `{}`", file.display())]
    ReadRig {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("rig file `{}` is not usable", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("rig file `{}` has no camera `{name}` (there are: {present})", file.display())]
    NoCamera {
        file: PathBuf,
        name: String,
        present: String,
    },
    #[error("cannot read picture `{}`", file.display())]
    ReadPicture {
        file: PathBuf,
        #[source]
        source: image::ImageError,
    },
    #[error("cannot search picture `{name}`")]
    Search {
        name: String,
        #[source]
        source: PictureError,
    },
    #[error("cannot play recording `{}`", folder.display())]
    Recording {
        folder: PathBuf,
        #[source]
        source: Box<SourceError>,
    },
    #[error("the pictures contradict the rig file")]
    Mismatch {
        #[source]
        source: RigMismatch,
    },
    #[error("`{lost}` of `{frames}` frames have no pose")]
    Lost { lost: usize, frames: usize },
    #[error(transparent)]
    Routine(explain::Explained),
    #[error(transparent)]
    Merge(#[from] merge::MergeError),
    #[error(transparent)]
    Probe(#[from] probe::ProbeError),
    #[error("cannot write the result")]
    Output(#[source] io::Error),
}

impl CommandError {
    /// 2 for bad input, 1 for failure.
    pub(crate) fn exit_code(&self) -> ExitCode {
        match self {
            Self::Routine(error) if error.0.is_bad_input() => ExitCode::from(2),
            Self::Merge(error) if error.is_bad_input() => ExitCode::from(2),
            Self::Probe(error) if error.is_bad_input() => ExitCode::from(2),
            Self::Routine(_) | Self::Merge(_) | Self::Probe(_) | Self::Lost { .. } | Self::Output(_) => {
                ExitCode::FAILURE
            }
            Self::ReadRig { .. }
            | Self::Rig { .. }
            | Self::NoCamera { .. }
            | Self::ReadPicture { .. }
            | Self::Search { .. }
            | Self::Recording { .. }
            | Self::Mismatch { .. } => ExitCode::from(2),
        }
    }

    /// What to do about it.
    pub(crate) fn hint(&self) -> Option<&str> {
        match self {
            Self::ReadRig { .. } => Some("give the `rig.toml` of the recording"),
            Self::Rig { source, .. } => source.hint(),
            Self::NoCamera { .. } => Some("choose one of these with `--camera`"),
            Self::ReadPicture { .. } => Some("give an undamaged PNG or JPEG picture"),
            Self::Search { .. } => Some("`size_px` in the rig file must be the size of the camera's pictures"),
            Self::Recording { source, .. } => Some(source.hint()),
            Self::Mismatch { source } => Some(source.hint()),
            Self::Lost { .. } => {
                Some("at least one marker of the rig must be sharp, whole and well lit in every frame")
            }
            Self::Routine(error) => error.0.hint(),
            Self::Merge(error) => error.hint(),
            Self::Probe(error) => Some(error.hint()),
            Self::Output(_) => None,
        }
    }
}

impl<E: explain::Explain + 'static> From<E> for CommandError {
    fn from(error: E) -> Self {
        Self::Routine(explain::Explained(Box::new(error)))
    }
}

/// Reads a rig file.
pub(crate) fn read_rig(file: &Path) -> Result<Rig, CommandError> {
    let text = fs::read_to_string(file).map_err(|source| CommandError::ReadRig {
        file: file.to_owned(),
        source,
    })?;
    Rig::from_toml(&text, file).map_err(|source| CommandError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    })
}

/// What the rig file in a recording says of the rig, and that file's name; `None` where the recording holds none, or an
/// empty one.
pub(crate) fn own_rig(recording: &Path) -> Result<Option<(PathBuf, RigParts)>, CommandError> {
    let (file, text) = if recording.is_file() {
        let player =
            McapPlayer::open(recording, Pace::Max, Repeat::ONCE).map_err(|source| CommandError::Recording {
                folder: recording.to_owned(),
                source: Box::new(source),
            })?;
        (recording.to_owned(), player.rig().unwrap_or_default().to_owned())
    } else {
        let file = recording.join("rig.toml");
        let text = match fs::read_to_string(&file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            read => read.map_err(|source| CommandError::ReadRig {
                file: file.clone(),
                source,
            })?,
        };
        (file, text)
    };
    if text.trim().is_empty() {
        return Ok(None);
    }
    let parts = parts(&text, &file)?;
    Ok(Some((file, parts)))
}

/// What there is of a rig in the text of a rig file.
pub(crate) fn parts(text: &str, file: &Path) -> Result<RigParts, CommandError> {
    RigParts::from_toml(text, file).map_err(|source| CommandError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    })
}

/// The error for a camera that the rig lacks.
pub(crate) fn no_camera(rig: &Rig, file: &Path, name: &str) -> CommandError {
    let present: Vec<String> = rig.cameras.iter().map(|camera| format!("`{}`", camera.name)).collect();
    CommandError::NoCamera {
        file: file.to_owned(),
        name: name.to_owned(),
        present: present.join(", "),
    }
}

/// The families that the rig's markers belong to.
pub(crate) fn families(rig: &Rig) -> Vec<Family> {
    let mut families: Vec<Family> = rig.markers.iter().map(|marker| marker.family).collect();
    families.sort();
    families.dedup();
    families
}
