//! Removes shared memory whose maker was killed after it named it and before it gave it a size.
//!
//! iceoryx2 0.10 waits without end for such memory to get its size (`open_impl` in `dynamic_storage` of iceoryx2-cal:
//! the one case that its time-out leaves out). Whoever clears away after the killed process then waits for ever, and
//! with it everybody who waits for the lock of [`super::service`].

use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, SystemTime};

use iceoryx2::prelude::Config;

/// Where the system keeps named shared memory.
const SHARED_MEMORY_FOLDER: &str = "/dev/shm";

/// How long memory may be without size. A living maker gives it one in some microseconds.
const UNBORN_MAX: Duration = Duration::from_millis(500);

/// Pause between two looks.
const PAUSE: Duration = Duration::from_millis(100);

/// Does `work`, and meanwhile removes what it might wait for in vain.
pub(super) fn while_removing<T>(config: &Config, work: impl FnOnce() -> T) -> T {
    let prefix = config.global.prefix.to_string();
    let (done, is_done) = channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while is_done.recv_timeout(PAUSE) == Err(RecvTimeoutError::Timeout) {
                // What cannot be listed or removed is no worse than before: it belongs to another user.
                let _ = remove_unborn(Path::new(SHARED_MEMORY_FOLDER), &prefix);
            }
        });
        let result = work();
        drop(done);
        result
    })
}

/// Removes the files of `folder` whose names begin with `prefix` and that have been empty for [`UNBORN_MAX`].
fn remove_unborn(folder: &Path, prefix: &str) -> std::io::Result<()> {
    let now = SystemTime::now();
    for entry in std::fs::read_dir(folder)?.flatten() {
        if !entry.file_name().to_string_lossy().starts_with(prefix) {
            continue;
        }
        let Ok(metadata) = entry.metadata() else { continue };
        let is_old = metadata
            .modified()
            .is_ok_and(|made| now.duration_since(made).is_ok_and(|age| age > UNBORN_MAX));
        if metadata.is_file() && metadata.len() == 0 && is_old {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;

    #[test]
    fn only_old_empty_memory_of_iceoryx2_goes() {
        let folder = tempfile::tempdir().unwrap();
        let make = |name: &str, content: &str, age: Duration| {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            let made = SystemTime::now() - age;
            File::options()
                .write(true)
                .open(path)
                .unwrap()
                .set_modified(made)
                .unwrap();
        };
        let old = 2 * UNBORN_MAX;
        make("iox2_a.connection", "", old);
        make("iox2_b.connection", "", Duration::ZERO);
        make("iox2_c.connection", "x", old);
        make("other", "", old);
        remove_unborn(folder.path(), "iox2_").unwrap();
        let mut left: Vec<_> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        left.sort();
        assert_eq!(left, ["iox2_b.connection", "iox2_c.connection", "other"]);
    }
}
