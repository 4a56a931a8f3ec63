//! `status`: how the daemon and its cameras are doing.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use mirrorball_capture::status::{SocketEnvironment, fetch, find_socket, table};

use super::CommandError;

#[derive(Debug, Args)]
pub(crate) struct StatusArgs {
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Socket of the daemon; without it the usual places are looked at.
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
}

/// Asks the daemon and prints what it says.
pub(crate) fn status(args: &StatusArgs) -> Result<(), CommandError> {
    let socket = match &args.socket {
        Some(socket) => socket.clone(),
        None => find_socket(&SocketEnvironment::from_process().map_err(CommandError::Environment)?),
    };
    let status = fetch(&socket)?;
    let text = if args.json {
        serde_json::to_string_pretty(&status).map_err(|error| CommandError::Print(error.into()))? + "\n"
    } else {
        table(&status)
    };
    match io::stdout().lock().write_all(text.as_bytes()) {
        // The reader has seen enough.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        printed => printed.map_err(CommandError::Print),
    }
}
