//! The program's commands: each a file, with its options and what it does.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use mirrorball_capture::config::ConfigError;
use mirrorball_capture::daemon::DaemonError;
use mirrorball_capture::recording::FolderError;
use mirrorball_capture::recording::mcap::RecordError;
use mirrorball_capture::status::StatusError;
use mirrorball_capture::{HandoverError, SourceError};

pub(crate) mod devices;
pub(crate) mod doctor;
pub(crate) mod export;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod play;
pub(crate) mod record;
pub(crate) mod run;
pub(crate) mod status;

/// Why a command has failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CommandError {
    #[error(transparent)]
    Source(#[from] SourceError),
    #[error(transparent)]
    Record(#[from] RecordError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Handover(#[from] HandoverError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Daemon(#[from] DaemonError),
    #[error(transparent)]
    Status(#[from] StatusError),
    #[error("cannot find out which user this is")]
    Environment(#[source] io::Error),
    #[error("cannot reach the service manager that `NOTIFY_SOCKET` names")]
    Notify(#[source] io::Error),
    #[error("cannot read rig file `{}`", path.display())]
    ReadRig {
        path: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("recording `{}` has no rig file", path.display())]
    NoRig { path: PathBuf },
    #[error("the rig file does not have camera `{camera}` of {width}×{height} px, which sends frames")]
    NotInRig { camera: String, width: u32, height: u32 },
    #[error("nothing was received on service `{service}`")]
    NothingReceived { service: String },
    #[error("recording `{}` has {n_bad} bad parts", path.display())]
    Damaged { path: PathBuf, n_bad: u64 },
    #[error("cannot write to the standard output")]
    Print(#[source] io::Error),
    #[error("cannot install the handlers of SIGTERM and SIGINT")]
    Signals(#[source] io::Error),
}

impl CommandError {
    /// True if the user's input is to blame (exit code 2), false if the program has failed (exit code 1).
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            Self::Config(_)
            | Self::Source(_)
            | Self::ReadRig { .. }
            | Self::NoRig { .. }
            | Self::NotInRig { .. }
            | Self::Damaged { .. } => true,
            Self::Record(error) => error.is_bad_input(),
            Self::Folder(error) => error.is_bad_input(),
            Self::Handover(error) => error.is_bad_input(),
            Self::Daemon(error) => error.is_bad_input(),
            Self::Status(_)
            | Self::Environment(_)
            | Self::Notify(_)
            | Self::NothingReceived { .. }
            | Self::Print(_)
            | Self::Signals(_) => false,
        }
    }

    /// One line on what to do about it.
    pub(crate) fn hint(&self) -> String {
        let hint = match self {
            Self::Config(error) => return error.hint(),
            Self::Daemon(error) => error.hint(),
            Self::Source(error) => error.hint(),
            Self::Record(error) => error.hint(),
            Self::Folder(error) => error.hint(),
            Self::Handover(error) => error.hint(),
            Self::Status(error) => error.hint(),
            Self::Notify(_) => "let the service manager set it, or unset it",
            Self::Environment(_) => "mount `/proc`, or give `--socket`",
            Self::ReadRig { .. } | Self::NoRig { .. } => "give the rig file with `--rig`",
            Self::NotInRig { .. } => "give the rig file of these cameras",
            Self::NothingReceived { .. } => "start the daemon, and give both programs the same `--service`",
            Self::Damaged { .. } => "all else in it can be played; restore the file from a copy",
            Self::Print(_) => "look where the output goes",
            Self::Signals(_) => "run it where processes may handle signals",
        };
        hint.to_owned()
    }
}

/// Reads the text of a rig file.
fn read_rig_text(path: &Path) -> Result<String, CommandError> {
    std::fs::read_to_string(path).map_err(|source| CommandError::ReadRig {
        path: path.to_path_buf(),
        source,
    })
}

/// The exit code of a command that only writes to standard output: that may be a pipe whose reader has seen enough.
pub(crate) fn finish(result: io::Result<ExitCode>) -> ExitCode {
    match result {
        Ok(code) => code,
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: cannot write the output\n  caused by: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Writes text to the standard output.
pub(crate) fn print(text: &str) -> Result<(), CommandError> {
    io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}
