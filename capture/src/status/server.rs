//! The status server and its client.

use std::fs::{self, Permissions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::Status;

/// Who may connect: the daemon's user and group.
const SOCKET_MODE: u32 = 0o660;

/// Who may look into a folder that the server makes: the same.
const FOLDER_MODE: u32 = 0o750;

/// Longest that a client that does not read can hold up the server; a status fits into the socket's buffer anyway.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Longest that a client waits for the whole answer.
const FETCH_TIMEOUT: Duration = Duration::from_secs(3);

/// Longest answer that a client reads, in bytes.
const ANSWER_MAX_BYTES: u64 = 1 << 20;

/// Pause after a failed accept, which may come from too many open files.
const PAUSE: Duration = Duration::from_millis(100);

/// Why the status cannot be served or had.
#[derive(Debug, thiserror::Error)]
pub enum StatusError {
    /// The folder of the socket cannot be made.
    #[error("cannot make folder `{}` for the status socket", path.display())]
    MakeFolder {
        /// The folder.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The folder belongs to somebody else, who could put another socket there.
    #[error("folder `{}` of the status socket belongs to user {owner} (allowed: root or user {uid})", path.display())]
    ForeignFolder {
        /// The folder.
        path: PathBuf,
        /// Whose it is.
        owner: u32,
        /// Who we are.
        uid: u32,
    },
    /// There is something else in the place of the socket.
    #[error("`{}` is there already and is no socket", path.display())]
    NotASocket {
        /// The place.
        path: PathBuf,
    },
    /// Another daemon serves there.
    #[error("another daemon serves its status on `{}`", path.display())]
    InUse {
        /// The place.
        path: PathBuf,
    },
    /// The socket cannot be made.
    #[error("cannot serve the status on `{}`", path.display())]
    Bind {
        /// The place.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// No daemon answers.
    #[error("no daemon answers on `{}`", path.display())]
    Connect {
        /// The place.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// What answers is no status.
    #[error("what came from `{}` is no status", path.display())]
    Answer {
        /// The place.
        path: PathBuf,
        /// Why.
        #[source]
        source: serde_json::Error,
    },
}

impl StatusError {
    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::MakeFolder { .. } | Self::ForeignFolder { .. } | Self::NotASocket { .. } | Self::Bind { .. } => {
                "set `status_socket` in the configuration to a place of your own, of at most 107 bytes"
            }
            Self::InUse { .. } => "stop the other daemon, or give this one another `status_socket`",
            Self::Connect { .. } => "start the daemon, or say with `--socket` where its status is served",
            Self::Answer { .. } => "give the socket of a daemon of the same version",
        }
    }
}

/// Where the daemon puts its newest status for the server to read. A clone is the same board.
#[derive(Debug, Clone)]
pub struct StatusBoard(Arc<Mutex<Status>>);

impl StatusBoard {
    /// A board with a first status.
    #[must_use]
    pub fn new(status: Status) -> Self {
        Self(Arc::new(Mutex::new(status)))
    }

    /// Replaces the status; meant to be called about once a second.
    pub fn put(&self, status: Status) {
        // The old one is dropped after the lock is.
        let _old = std::mem::replace(&mut *self.lock(), status);
    }

    /// The newest status.
    #[must_use]
    pub fn get(&self) -> Status {
        self.lock().clone()
    }

    fn lock(&self) -> MutexGuard<'_, Status> {
        // A status is replaced as a whole, so even a panic elsewhere leaves a good one.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A thread that answers whoever connects to a socket; ends, and takes the socket away, when it is dropped.
#[derive(Debug)]
pub struct StatusServer {
    path: PathBuf,
    inode: u64,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StatusServer {
    /// Serves what is on `board` on the socket `path`, which the daemon's user and group may connect to. A socket that
    /// a killed daemon has left there is removed.
    ///
    /// # Errors
    ///
    /// The socket cannot be made, or another daemon serves there.
    pub fn start(path: &Path, board: StatusBoard) -> Result<Self, StatusError> {
        make_folder(path)?;
        remove_stale(path)?;
        let bind_error = |source| StatusError::Bind {
            path: path.to_owned(),
            source,
        };
        let listener = bind(path).map_err(bind_error)?;
        let inode = fs::symlink_metadata(path).map_err(bind_error)?.ino();
        let stop = Arc::new(AtomicBool::new(false));
        let is_stopped = stop.clone();
        let thread = std::thread::Builder::new()
            .name("status".to_owned())
            .spawn(move || serve(&listener, &board, &is_stopped))
            .map_err(bind_error)?;
        Ok(Self {
            path: path.to_owned(),
            inode,
            stop,
            thread: Some(thread),
        })
    }

    /// Where it serves.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for StatusServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let is_ours = fs::symlink_metadata(&self.path).is_ok_and(|found| found.ino() == self.inode);
        if !is_ours {
            // Somebody has taken the place: the thread cannot be woken and ends with the process.
            return;
        }
        let is_woken = UnixStream::connect(&self.path).is_ok();
        // A failure leaves a stale socket, which the next daemon removes.
        let _ = fs::remove_file(&self.path);
        if let Some(thread) = self.thread.take().filter(|_| is_woken) {
            // It has nothing to say but that it has panicked, which is on standard error already.
            let _ = thread.join();
        }
    }
}

/// Asks the daemon that serves on `path`.
///
/// # Errors
///
/// Nobody serves there, the answer takes longer than 3 s, or it is no status.
pub fn fetch(path: &Path) -> Result<Status, StatusError> {
    let answer = read_answer(path).map_err(|source| StatusError::Connect {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_slice(&answer).map_err(|source| StatusError::Answer {
        path: path.to_owned(),
        source,
    })
}

fn read_answer(path: &Path) -> io::Result<Vec<u8>> {
    let deadline = Instant::now() + FETCH_TIMEOUT;
    let mut stream = UnixStream::connect(path)?;
    let mut answer = Vec::new();
    let mut part = [0; 4096];
    while answer.len() as u64 <= ANSWER_MAX_BYTES {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut part) {
            Ok(0) => return Ok(answer),
            Ok(n_bytes) => answer.extend_from_slice(&part[..n_bytes]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Err(io::ErrorKind::TimedOut.into()),
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::new(io::ErrorKind::InvalidData, "the answer does not end"))
}

fn make_folder(path: &Path) -> Result<(), StatusError> {
    let Some(folder) = path.parent().filter(|folder| *folder != Path::new("")) else {
        return Ok(());
    };
    let make_error = |source| StatusError::MakeFolder {
        path: folder.to_owned(),
        source,
    };
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true).mode(FOLDER_MODE);
    builder.create(folder).map_err(make_error)?;
    // In `/tmp` anybody could have made it before us.
    let found = fs::symlink_metadata(folder).map_err(make_error)?;
    let uid = fs::metadata("/proc/self").map_err(make_error)?.uid();
    if found.is_dir() && found.uid() != uid && found.uid() != 0 {
        return Err(StatusError::ForeignFolder {
            path: folder.to_owned(),
            owner: found.uid(),
            uid,
        });
    }
    Ok(())
}

/// Removes a socket that nobody answers on.
fn remove_stale(path: &Path) -> Result<(), StatusError> {
    let bind_error = |source| StatusError::Bind {
        path: path.to_owned(),
        source,
    };
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(bind_error(error)),
        Ok(found) if !found.file_type().is_socket() => {
            return Err(StatusError::NotASocket { path: path.to_owned() });
        }
        Ok(_) => {}
    }
    match UnixStream::connect(path) {
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => fs::remove_file(path).map_err(bind_error),
        // It answers, or it would if we were allowed or it had room.
        Ok(_) | Err(_) => Err(StatusError::InUse { path: path.to_owned() }),
    }
}

/// Makes the socket under another name first, so that nobody meets it before its permissions are set.
fn bind(path: &Path) -> io::Result<UnixListener> {
    let mut new_name = path.as_os_str().to_owned();
    new_name.push(format!(".{}", std::process::id()));
    let new_path = PathBuf::from(new_name);
    // Left by a daemon with the same process number, killed just here.
    let _ = fs::remove_file(&new_path);
    let listener = UnixListener::bind(&new_path)?;
    let placed =
        fs::set_permissions(&new_path, Permissions::from_mode(SOCKET_MODE)).and_then(|()| fs::rename(&new_path, path));
    if let Err(error) = placed {
        let _ = fs::remove_file(&new_path);
        return Err(error);
    }
    Ok(listener)
}

fn serve(listener: &UnixListener, board: &StatusBoard, stop: &AtomicBool) {
    for connection in listener.incoming() {
        // The flag guards no other data; the connection that wakes us comes after it.
        if stop.load(Ordering::Relaxed) {
            return;
        }
        match connection {
            // Whoever leaves before the answer does not want it.
            Ok(stream) => drop(answer(stream, board)),
            Err(error) => {
                tracing::debug!("cannot accept a connection for the status: {error}");
                std::thread::sleep(PAUSE);
            }
        }
    }
}

fn answer(mut stream: UnixStream, board: &StatusBoard) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
    let mut json = serde_json::to_vec(&board.get())?;
    json.push(b'\n');
    stream.write_all(&json)
}
