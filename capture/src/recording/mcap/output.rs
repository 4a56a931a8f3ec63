//! What a recording is written to: a file, which can be synchronised from another thread and cut to what is good.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};

/// Brings what was written so far to where a power cut cannot reach it.
pub(super) type Synchronise = Box<dyn FnMut() -> io::Result<()> + Send>;

/// Something that a recording can be written to.
pub(super) trait Output: Write + Seek + Send + 'static {
    /// A handle that synchronises, for use by another thread while this one writes on.
    fn synchronise(&self) -> io::Result<Synchronise>;

    /// Drops all beyond the first `n_bytes` and synchronises the rest.
    fn cut(&mut self, n_bytes: u64) -> io::Result<()>;
}

impl Output for File {
    fn synchronise(&self) -> io::Result<Synchronise> {
        let file = self.try_clone()?;
        Ok(Box::new(move || file.sync_data()))
    }

    fn cut(&mut self, n_bytes: u64) -> io::Result<()> {
        self.set_len(n_bytes)?;
        self.sync_data()
    }
}

/// An output that knows its length, keeps the first error as the system gave it and writes nothing after that.
pub(super) struct Guarded<O> {
    pub(super) output: O,
    position: u64,
    length: std::sync::Arc<std::sync::atomic::AtomicU64>,
    first_error: Option<io::Error>,
}

impl<O: Output> Guarded<O> {
    /// Guards an empty output; `length` is kept at its length in bytes.
    pub(super) fn new(output: O, length: std::sync::Arc<std::sync::atomic::AtomicU64>) -> Self {
        Self {
            output,
            position: 0,
            length,
            first_error: None,
        }
    }

    /// The first error, if there was one.
    pub(super) fn take_error(&mut self) -> Option<io::Error> {
        self.first_error.take()
    }

    fn check(&self) -> io::Result<()> {
        match &self.first_error {
            Some(error) => Err(error.kind().into()),
            None => Ok(()),
        }
    }

    fn keep_error<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        result.map_err(|error| {
            if error.kind() == io::ErrorKind::Interrupted {
                return error;
            }
            let kind = error.kind();
            self.first_error.get_or_insert(error);
            kind.into()
        })
    }
}

impl<O: Output> Write for Guarded<O> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.check()?;
        let written = self.output.write(bytes);
        let n_bytes = self.keep_error(written)?;
        self.position += n_bytes as u64;
        // Relaxed: the number guards no other data.
        self.length
            .fetch_max(self.position, std::sync::atomic::Ordering::Relaxed);
        Ok(n_bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.check()?;
        let flushed = self.output.flush();
        self.keep_error(flushed)
    }
}

impl<O: Output> Seek for Guarded<O> {
    fn seek(&mut self, place: SeekFrom) -> io::Result<u64> {
        self.check()?;
        let sought = self.output.seek(place);
        self.position = self.keep_error(sought)?;
        Ok(self.position)
    }
}
