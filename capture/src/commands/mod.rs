//! Commands of the program that do one thing and end.

pub(crate) mod devices;
pub(crate) mod doctor;

use std::io;
use std::process::ExitCode;

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
