//! How both programs end: the chain of causes on standard error, at most one hint, the exit code.

use crate::ToolError;
use std::{error::Error, process::ExitCode};

/// Prints the error, its causes and its hint on standard error and returns the exit code it asks for.
pub fn report_failure(error: &ToolError) -> ExitCode {
    eprint!("{}", failure_text(error));
    ExitCode::from(error.exit_code())
}

/// Lays an error out as both programs print it.
pub fn failure_text(error: &ToolError) -> String {
    let mut text = format!("error: {error}\n");
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(&format!("  caused by: {}\n", error.to_string().trim_end()));
        cause = error.source();
    }
    if let Some(hint) = error.hint() {
        text.push_str(&format!("  hint: {hint}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_shows_cause_and_hint() {
        let error = ToolError::Unreadable {
            path: "out/frames.jsonl".into(),
            role: "the record of the run".into(),
            source: std::io::Error::from(std::io::ErrorKind::NotFound),
        };
        let text = failure_text(&error);
        assert!(
            text.starts_with("error: cannot read `out/frames.jsonl`, the record of the run\n  caused by: "),
            "{text}"
        );
        assert!(
            text.ends_with("  hint: give the folder that `mirrorball-render --out` wrote\n"),
            "{text}"
        );
        assert_eq!(error.exit_code(), 2);
    }
}
