//! What can be wrong with a configuration file, with the line where it is.

use std::path::PathBuf;

use crate::lockstep::tables::TableError;
use crate::meter::ResponseError;

/// A configuration file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read config file `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The file is longer than any configuration.
    #[error("config file `{}` has more than {max_bytes} bytes (allowed: at most as many)", path.display())]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Most bytes read.
        max_bytes: u64,
    },
    /// The file is no TOML.
    #[error("config file `{}` line {line} is no TOML: {message}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What the TOML reader said.
        message: String,
    },
    /// A key that there is not.
    #[error("config file `{}` line {line} has the unknown key `{key}`{}", path.display(), did_you_mean(nearest))]
    UnknownKey {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The key found, with the tables it is in.
        key: String,
        /// The known key that is nearest to it, if one is near.
        nearest: Option<String>,
        /// All keys known in its place.
        known: Vec<String>,
    },
    /// A key that is needed.
    #[error("config file `{}` line {line} lacks the key `{key}`", path.display())]
    MissingKey {
        /// The file.
        path: PathBuf,
        /// Line number of the table that lacks it, from 1.
        line: usize,
        /// The key, with the tables it should be in.
        key: String,
    },
    /// A value of the wrong kind.
    #[error("config file `{}` line {line} has the wrong kind of value for `{key}`: {message}", path.display())]
    WrongKind {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The key, with the tables it is in.
        key: String,
        /// What there is and what should be.
        message: String,
    },
    /// A value that is not allowed.
    #[error("config file `{}` line {line} has `{key}` = `{found}` (allowed: {allowed})", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The key, with the tables it is in.
        key: String,
        /// The value found.
        found: String,
        /// What would be right.
        allowed: String,
    },
    /// A table of control values that cannot be used.
    #[error("config file `{}` line {line}: the tables of camera `{camera}` cannot be used", path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Name of the camera.
        camera: String,
        /// Why.
        #[source]
        source: TableError,
    },
    /// A response that cannot be used.
    #[error("config file `{}` line {line}: the response of camera `{camera}` cannot be used", path.display())]
    Response {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Name of the camera.
        camera: String,
        /// Why.
        #[source]
        source: ResponseError,
    },
}

impl ConfigError {
    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read { .. } => "give a file that this user may read; `configs/capture.toml` is an example".to_owned(),
            Self::TooLong { .. } => "give the configuration, not a recording".to_owned(),
            Self::Syntax { .. } => {
                "strings need quotes, tables a line `[name]`, cameras a line `[[camera]]`".to_owned()
            }
            Self::UnknownKey { known, .. } if known.is_empty() => "nothing can be set there".to_owned(),
            Self::UnknownKey { known, .. } => format!("keys known there: `{}`", known.join("`, `")),
            Self::MissingKey { .. } | Self::WrongKind { .. } | Self::Value { .. } => {
                "`configs/README.md` lists all keys with unit, range and default".to_owned()
            }
            Self::Table { source, .. } => source.hint().to_owned(),
            Self::Response { .. } => "give `\"srgb\"`, or the linear signal of each of the 256 codes".to_owned(),
        }
    }
}

fn did_you_mean(nearest: &Option<String>) -> String {
    nearest
        .as_ref()
        .map_or_else(String::new, |nearest| format!(" (did you mean `{nearest}`?)"))
}
