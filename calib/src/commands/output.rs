//! What a routine leaves behind: a rig file, JSON, a page to read.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use mirrorball_calib::{
    report::Report,
    rig::{RigDraft, RigError},
};
use serde::Serialize;

use super::explain::Explain;

/// Where the results go.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct OutputArgs {
    /// Rig file that the result is written into. What was there stays, and the old file is kept as `FILE.old`.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// File for a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,
}

/// Why results cannot be written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OutputError {
    #[error("cannot read rig file `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("the rig file `{}` cannot take the result", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("cannot write `{}`", file.display())]
    Write {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
}

impl Explain for OutputError {
    fn is_bad_input(&self) -> bool {
        matches!(self, Self::Rig { .. })
    }

    fn hint(&self) -> Option<&str> {
        match self {
            Self::Rig { source, .. } => source.hint().or(Some("mend it, or name a new file with `--out`")),
            Self::Read { .. } | Self::Write { .. } => None,
        }
    }
}

/// The rig file that a routine adds to: the one that is there, or an empty one.
pub(crate) fn draft(file: &Path) -> Result<RigDraft, OutputError> {
    let text = match fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(RigDraft::new()),
        Err(source) => {
            return Err(OutputError::Read {
                file: file.to_owned(),
                source,
            });
        }
    };
    RigDraft::from_toml(&text, file).map_err(|source| OutputError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    })
}

impl OutputArgs {
    /// Writes the rig file: whole or not at all, and the old one is kept.
    pub(crate) fn write_rig(&self, draft: &RigDraft) -> Result<(), OutputError> {
        let Some(file) = &self.out else { return Ok(()) };
        draft.parts(file).map_err(|source| OutputError::Rig {
            file: file.clone(),
            source: Box::new(source),
        })?;
        if file.exists() {
            let mut old = file.clone().into_os_string();
            old.push(".old");
            let old = PathBuf::from(old);
            let copy = || -> io::Result<()> { replace(&old, &fs::read(file)?) };
            copy().map_err(|source| write_error(&old, source))?;
        }
        replace(file, draft.to_toml().as_bytes()).map_err(|source| write_error(file, source))
    }

    /// Writes the numbers.
    pub(crate) fn write_json(&self, numbers: &impl Serialize) -> Result<(), OutputError> {
        let Some(file) = &self.json else { return Ok(()) };
        let write = || -> io::Result<()> {
            let mut text = serde_json::to_vec_pretty(numbers)?;
            text.push(b'\n');
            replace(file, &text)
        };
        write().map_err(|source| write_error(file, source))
    }

    /// Writes the page.
    pub(crate) fn write_report(&self, report: impl FnOnce() -> Report) -> Result<(), OutputError> {
        let Some(file) = &self.report else { return Ok(()) };
        replace(file, report().to_html().as_bytes()).map_err(|source| write_error(file, source))
    }
}

/// Writes a file: whole or not at all.
pub(crate) fn write_file(file: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    replace(file, bytes).map_err(|source| write_error(file, source))
}

/// Puts a file in the place of another in one step, so that a reader sees the old one or the new one, never a part.
fn replace(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut new = tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new(".")))?;
    new.write_all(bytes)?;
    new.as_file().sync_all()?;
    new.persist(file).map_err(|error| error.error)?;
    Ok(())
}

fn write_error(file: &Path, source: io::Error) -> OutputError {
    OutputError::Write {
        file: file.to_owned(),
        source,
    }
}
