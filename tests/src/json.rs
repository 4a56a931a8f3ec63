//! Reading JSON files with the file and line in the error.

use crate::ToolError;
use serde::de::DeserializeOwned;
use std::{fs, path::Path};

/// Reads one JSON value from a file; `role` is a phrase that says what the file is.
///
/// # Errors
/// When the file cannot be read or is not such a value.
pub fn read<T: DeserializeOwned>(path: &Path, role: &str) -> Result<T, ToolError> {
    serde_json::from_str(&read_text(path, role)?).map_err(|source| ToolError::Json {
        path: path.to_owned(),
        line: None,
        source,
    })
}

/// Reads a file with one JSON value per line, with the line numbers from 1; empty lines are passed over.
///
/// # Errors
/// When the file cannot be read or a line is not such a value.
pub fn read_lines<T: DeserializeOwned>(path: &Path, role: &str) -> Result<Vec<(usize, T)>, ToolError> {
    let text = read_text(path, role)?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(index, line)| match serde_json::from_str(line) {
            Ok(value) => Ok((index + 1, value)),
            Err(source) => Err(ToolError::Json {
                path: path.to_owned(),
                line: Some(index + 1),
                source,
            }),
        })
        .collect()
}

/// Reads a text file.
///
/// # Errors
/// When the file cannot be read or is not UTF-8.
pub fn read_text(path: &Path, role: &str) -> Result<String, ToolError> {
    fs::read_to_string(path).map_err(|source| ToolError::Unreadable {
        path: path.to_owned(),
        role: role.to_owned(),
        source,
    })
}
