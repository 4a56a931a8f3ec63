//! The rig and the recording that are held against each other.

use std::path::Path;

use mirrorball_calib::rig::Rig;
use mirrorball_capture::{
    Pace, Repeat, Source, SourceError,
    recording::{mcap::McapPlayer, open_recording},
};

use super::{
    super::{CommandError, read_rig},
    CheckError,
};

/// A rig file with a recording, or a recording with the rig file in it.
pub(super) fn open(subject: &Path, recording: Option<&Path>) -> Result<(Rig, Box<dyn Source>), CommandError> {
    let failed = |path: &Path| {
        let folder = path.to_owned();
        move |source: SourceError| CommandError::Recording {
            folder,
            source: Box::new(source),
        }
    };
    if let Some(recording) = recording {
        let source = open_recording(recording, Pace::Max, Repeat::ONCE).map_err(failed(recording))?;
        return Ok((read_rig(subject)?, source));
    }
    if subject.extension().is_some_and(|extension| extension == "toml") {
        return Err(CheckError::NoRecording {
            rig: subject.to_owned(),
        }
        .into());
    }
    if !subject.is_file() {
        let source = open_recording(subject, Pace::Max, Repeat::ONCE).map_err(failed(subject))?;
        return Ok((read_rig(&subject.join("rig.toml"))?, source));
    }
    let player = McapPlayer::open(subject, Pace::Max, Repeat::ONCE).map_err(failed(subject))?;
    let Some(text) = player.rig() else {
        let recording = subject.to_owned();
        return Err(CheckError::NoRig { recording }.into());
    };
    let rig = Rig::from_toml(text, subject).map_err(|source| CommandError::Rig {
        file: subject.to_owned(),
        source: Box::new(source),
    })?;
    Ok((rig, Box::new(player)))
}
