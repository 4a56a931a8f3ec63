//! How the crate's programs log and end: the chain of causes on standard error, at most one hint, the exit code.

use std::error::Error;
use std::process::ExitCode;

use crate::error::RenderError;

/// Logs to standard error; `RUST_LOG` chooses what.
pub fn start_log() {
    let filter =
        tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn,mirrorball=info".into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
}

/// Exit code of a program that ends so: 0, 1 for failure, 2 for bad input. Prints the error with its causes and at most
/// one hint.
#[must_use]
pub fn exit_code(result: &Result<(), RenderError>) -> ExitCode {
    let Err(error) = result else {
        return ExitCode::SUCCESS;
    };
    eprintln!("error: {error}");
    let mut cause = error.source();
    while let Some(inner) = cause {
        eprintln!("  caused by: {inner}");
        cause = inner.source();
    }
    if let Some(hint) = error.hint() {
        eprintln!("  hint: {hint}");
    }
    ExitCode::from(if error.is_bad_input() { 2 } else { 1 })
}
