//! Where the socket of the status server is.

use std::env;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Name of the socket in its folder.
const SOCKET_NAME: &str = "status.sock";

/// What in the environment decides the place.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SocketEnvironment {
    /// `RUNTIME_DIRECTORY`: folders that systemd has made for this service, with colons between them.
    pub runtime_directory: Option<PathBuf>,
    /// `XDG_RUNTIME_DIR`: the user's own folder for sockets.
    pub xdg_runtime_dir: Option<PathBuf>,
    /// Number of the user.
    pub uid: u32,
}

impl SocketEnvironment {
    /// That of this process.
    ///
    /// # Errors
    ///
    /// `/proc`, which knows the user's number, cannot be read.
    pub fn from_process() -> io::Result<Self> {
        let folder = |name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        Ok(Self {
            runtime_directory: folder("RUNTIME_DIRECTORY"),
            xdg_runtime_dir: folder("XDG_RUNTIME_DIR"),
            uid: std::fs::metadata("/proc/self")?.uid(),
        })
    }
}

/// Where the daemon puts its socket if it is not told: `$RUNTIME_DIRECTORY/status.sock`, else
/// `$XDG_RUNTIME_DIR/mirrorball/status.sock`, else `/tmp/mirrorball-UID/status.sock`.
#[must_use]
pub fn default_socket(environment: &SocketEnvironment) -> PathBuf {
    let folder = match (&environment.runtime_directory, &environment.xdg_runtime_dir) {
        (Some(folders), _) => first_of(folders),
        (None, Some(folder)) => folder.join("mirrorball"),
        (None, None) => PathBuf::from(format!("/tmp/mirrorball-{}", environment.uid)),
    };
    folder.join(SOCKET_NAME)
}

/// Where a client looks for the socket if it is not told: the first place with one of those that a daemon of the same
/// user, or the system's service, may have put it; if there is none, where this user's daemon would put it.
#[must_use]
pub fn find_socket(environment: &SocketEnvironment) -> PathBuf {
    let temporary = SocketEnvironment {
        uid: environment.uid,
        ..SocketEnvironment::default()
    };
    let places = [
        default_socket(environment),
        Path::new("/run/mirrorball").join(SOCKET_NAME),
        default_socket(&temporary),
    ];
    let found = places.iter().find(|place| place.exists());
    found.unwrap_or(&places[0]).clone()
}

/// The first of some folders with colons between them.
fn first_of(folders: &Path) -> PathBuf {
    env::split_paths(folders).next().unwrap_or_else(|| folders.to_owned())
}
