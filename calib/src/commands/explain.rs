//! Errors of routines as the program tells them.

use std::{error::Error, fmt};

/// An error that knows whose fault it is and what to do about it.
pub(crate) trait Explain: Error + Send + Sync {
    /// Whether the input is to blame (exit code 2) or something failed (1).
    fn is_bad_input(&self) -> bool;

    /// What to do about it.
    fn hint(&self) -> Option<&str>;
}

/// Any such error.
#[derive(Debug)]
pub(crate) struct Explained(pub(crate) Box<dyn Explain>);

impl fmt::Display for Explained {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

impl Error for Explained {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.0.source()
    }
}
