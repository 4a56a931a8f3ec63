//! Frames out of an open camera, one at a time, and everything else that comes instead of one.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::buffers::Buffers;
use super::controls::{ControlChange, V4l2Controls, Watched};
use super::error::StreamError;
use super::format::{Interval, Negotiated};
use super::ioctl::{Dequeued, Memory, Node, monotonic_ns};
use super::losses::{Accounts, Length, Loss, LossCause};
use crate::frame::{BufferFlags, Pixels};
use crate::pool::{Lease, Pool};

/// How pictures get from the driver into the pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Without a copy if the driver can, else with one.
    Auto,
    /// Copied out of the driver's memory.
    Mmap,
    /// Written by the driver into the pool's own memory.
    UserPtr,
}

impl fmt::Display for Method {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Auto => "auto",
            Self::Mmap => "mmap",
            Self::UserPtr => "userptr",
        })
    }
}

/// What clock a driver's stamps are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampClock {
    /// `CLOCK_MONOTONIC`.
    Monotonic,
    /// Copied from somewhere else.
    Copied,
    /// The driver does not say.
    Unknown,
}

/// A picture with all that the driver said about it.
#[derive(Debug, Clone)]
pub struct Raw {
    /// The picture, without padding; as long as its format asks for, or as the JPEG picture is.
    pub pixels: Pixels,
    /// Bytes that the driver says it wrote.
    pub bytes_used: u32,
    /// The driver's count, which wraps at 2³².
    pub sequence: u32,
    /// Numbers that the driver left out between the buffer before and this one: frames it dropped.
    pub dropped_before: u32,
    /// The driver's stamp in nanoseconds; since boot if its clock is monotonic. It may lie in the future.
    pub timestamp_ns: u64,
    /// When the buffer was taken back, in nanoseconds since boot.
    pub dequeued_ns: u64,
    /// All flags of the buffer.
    pub flags: BufferFlags,
}

impl Raw {
    /// What clock the stamp is on.
    #[must_use]
    pub fn clock(&self) -> StampClock {
        match self.flags.0 & 0xe000 {
            0x2000 => StampClock::Monotonic,
            0x4000 => StampClock::Copied,
            _ => StampClock::Unknown,
        }
    }

    /// True if the stamp says when exposure began, false if it says when the last byte came.
    #[must_use]
    pub fn is_start_of_exposure(&self) -> bool {
        self.flags.0 & 0x7_0000 == 0x1_0000
    }
}

/// What [`Stream::next`] found.
#[derive(Debug, Clone)]
pub enum Taken {
    /// A good picture.
    Frame(Raw),
    /// Nothing within the timeout; the stream goes on.
    TimedOut,
    /// A buffer that is no frame; the stream goes on.
    Lost(Loss),
    /// Somebody else changed a control.
    ControlChanged(ControlChange),
}

/// How a stream is to be run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamSettings {
    /// How pictures get into the pool.
    pub method: Method,
    /// Buffers that the driver has to write into, 2 to 32.
    pub n_buffers: u32,
}

impl Default for StreamSettings {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            n_buffers: 4,
        }
    }
}

/// Fewest buffers a driver streams with: one being written, one waiting.
const BUFFERS_MIN: usize = 2;

/// Most buffers that a driver may be asked for.
const BUFFERS_MAX: u32 = 32;

/// After so many intervals without a frame, and at least so many seconds, a stream that lost USB transfers is
/// given up. Frames of cameras that are well do not come that late.
const SILENCE_INTERVALS: f64 = 5.0;
const SILENCE_MIN_S: f64 = 0.3;

/// A running stream. Dropped, it stops and gives all buffers back.
pub struct Stream {
    buffers: Buffers,
    node: Arc<Node>,
    negotiated: Negotiated,
    accounts: Accounts,
    watched: Vec<(u32, Watched)>,
    last_buffer: Instant,
}

impl Stream {
    /// Makes buffers, hands them to the driver and starts it. `pool` is the one that frames are to be in.
    pub(super) fn start(
        node: Arc<Node>,
        negotiated: Negotiated,
        controls: &V4l2Controls,
        settings: StreamSettings,
        pool: &mut dyn Pool,
    ) -> Result<Self, StreamError> {
        let n_buffers = settings.n_buffers.clamp(BUFFERS_MIN as u32, BUFFERS_MAX);
        let buffers = make_buffers(&node, &negotiated, settings.method, n_buffers, pool)?;
        let length = match negotiated.kind.raw_bytes(negotiated.size) {
            Some(_) if negotiated.is_padded() => Length::Raw(padded_bytes(&negotiated)),
            Some(packed) => Length::Raw(u32::try_from(packed).unwrap_or(u32::MAX)),
            None => {
                let most = negotiated.format.max_bytes(negotiated.size).min(pool.buffer_bytes());
                Length::Compressed(u32::try_from(most).unwrap_or(u32::MAX))
            }
        };
        let accounts = Accounts::new(length);
        let mut stream = Self {
            buffers,
            node,
            negotiated,
            accounts,
            watched: Vec::new(),
            last_buffer: Instant::now(),
        };
        stream.run()?;
        stream.watched = controls.watch();
        Ok(stream)
    }

    /// How pictures get into the pool, once [`Method::Auto`] has been decided.
    #[must_use]
    pub fn method(&self) -> Method {
        match self.buffers.memory() {
            Memory::Mmap => Method::Mmap,
            Memory::UserPtr => Method::UserPtr,
        }
    }

    /// What the frames are like.
    #[must_use]
    pub fn negotiated(&self) -> &Negotiated {
        &self.negotiated
    }

    /// Number of buffers that the driver has to write into.
    #[must_use]
    pub fn n_buffers(&self) -> usize {
        self.buffers.len()
    }

    /// Waits up to `timeout` for the next thing to happen. Frames are in buffers of `pool`.
    ///
    /// # Errors
    ///
    /// The camera is gone, or the stream stands still until [`Stream::restart`].
    pub fn next(&mut self, pool: &mut dyn Pool, timeout: Duration) -> Result<Taken, StreamError> {
        let began = Instant::now();
        if self.accounts.losses_in_a_row() >= self.patience() {
            let n_losses = self.accounts.losses_in_a_row();
            return Err(StreamError::OnlyErrors {
                path: self.path(),
                n_losses,
            });
        }
        self.lend_all()?;
        loop {
            let left = timeout.saturating_sub(began.elapsed());
            let ready = self
                .node
                .poll(left)
                .map_err(|error| self.error("wait for frames", error))?;
            if ready.has_event
                && let Some(change) = self.take_change()?
            {
                return Ok(Taken::ControlChanged(change));
            }
            if ready.has_buffer || ready.has_failed {
                match self.buffers.dequeue() {
                    Ok(dequeued) => return Ok(self.settle(dequeued, pool)),
                    // Somebody was quicker, or a failure that only poll knows of.
                    Err(error) if error.kind() == std::io::ErrorKind::WouldBlock && !ready.has_failed => {}
                    Err(error) => return Err(self.error("take a frame", error)),
                }
            }
            if began.elapsed() >= timeout {
                return self.silence();
            }
        }
    }

    /// What it means that nothing came: a camera that hangs may go on, a stream that lost its transfers will not.
    fn silence(&self) -> Result<Taken, StreamError> {
        let interval_s = self.negotiated.interval.map_or(0.0, Interval::seconds);
        let patience_s = SILENCE_MIN_S.max(SILENCE_INTERVALS * interval_s);
        let n_empty = self.accounts.n_empty();
        if n_empty > 0 && self.last_buffer.elapsed().as_secs_f64() > patience_s {
            return Err(StreamError::Stuck {
                path: self.path(),
                n_empty,
            });
        }
        Ok(Taken::TimedOut)
    }

    /// Stops and starts the stream on the same open device: what brings back a stream that failed.
    ///
    /// # Errors
    ///
    /// The camera is gone or does not start; it may be tried again.
    pub fn restart(&mut self) -> Result<(), StreamError> {
        self.buffers
            .stop()
            .map_err(|error| self.error("stop the stream", error))?;
        self.accounts.restart();
        self.run()
    }

    fn run(&mut self) -> Result<(), StreamError> {
        self.lend_all()?;
        self.node
            .stream_on()
            .map_err(|error| self.error("start the stream", error))
    }

    /// Lends the driver every buffer it has not. One that it refused is offered again with the next frame.
    fn lend_all(&mut self) -> Result<(), StreamError> {
        let (n_queued, refusal) = self.buffers.queue_all();
        match refusal {
            Some(error) if n_queued == 0 || error.raw_os_error() == Some(libc::ENODEV) => {
                Err(self.error("lend buffers to the driver", error))
            }
            Some(error) => {
                tracing::debug!("camera `{}` refused a buffer: {error}", self.node.path().display());
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Makes a frame of a buffer that came back, or says why it is none.
    fn settle(&mut self, dequeued: Dequeued, pool: &mut dyn Pool) -> Taken {
        let dequeued_ns = monotonic_ns();
        self.last_buffer = Instant::now();
        let Dequeued {
            index,
            bytes_used,
            flags,
            sequence,
            timestamp_ns,
        } = dequeued;
        let verdict = self.accounts.judge(flags, bytes_used, sequence);
        let dropped_before = verdict.dropped_before;
        let loss = |cause| {
            Taken::Lost(Loss {
                cause,
                sequence: verdict.sequence,
                dropped_before,
                dequeued_ns,
            })
        };
        if let Some(cause) = verdict.cause {
            self.lend(index as usize);
            return loss(cause);
        }
        let lease = pool.lease();
        let pixels = lease.and_then(|lease| self.pixels(index as usize, bytes_used as usize, lease));
        self.lend(index as usize);
        let Some(pixels) = pixels else {
            return loss(LossCause::Overrun);
        };
        let flags = BufferFlags(flags);
        Taken::Frame(Raw {
            pixels,
            bytes_used,
            sequence,
            dropped_before,
            timestamp_ns,
            dequeued_ns,
            flags,
        })
    }

    /// The picture of a buffer that is ours: its copy in `lease`, or its own memory, in whose place `lease` then is.
    fn pixels(&mut self, index: usize, bytes_used: usize, mut lease: Box<dyn Lease>) -> Option<Pixels> {
        let packed = self.negotiated.kind.raw_bytes(self.negotiated.size);
        let n_bytes = packed.unwrap_or(bytes_used);
        if self.buffers.memory() == Memory::UserPtr {
            return Some(self.buffers.exchange(index, lease)?.freeze(n_bytes));
        }
        let source = self.buffers.pixels(index)?;
        copy_rows(source, lease.bytes_mut().get_mut(..n_bytes)?, &self.negotiated)?;
        Some(lease.freeze(n_bytes))
    }

    /// Lends a buffer again at once. If the driver refuses, the next call tries again and reports.
    fn lend(&mut self, index: usize) {
        if let Err(error) = self.buffers.queue(index) {
            tracing::debug!("camera `{}` refused a buffer: {error}", self.node.path().display());
        }
    }

    fn take_change(&self) -> Result<Option<ControlChange>, StreamError> {
        let change = self
            .node
            .changed_control()
            .map_err(|error| self.error("read an event", error))?;
        let Some((id, value)) = change else { return Ok(None) };
        let watched = self.watched.iter().find(|(watched, _)| *watched == id);
        Ok(watched.map(|(_, what)| ControlChange { what: *what, value }))
    }

    /// Losses in a row after which the stream is not believed to recover by itself: each buffer came back twice.
    fn patience(&self) -> u32 {
        u32::try_from(self.buffers.len() * 2).unwrap_or(u32::MAX)
    }

    fn path(&self) -> PathBuf {
        self.node.path().into()
    }

    fn error(&self, action: &'static str, error: std::io::Error) -> StreamError {
        StreamError::from_call(action, self.node.path(), error)
    }
}

impl fmt::Debug for Stream {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = formatter.debug_struct("Stream");
        debug
            .field("node", &self.node)
            .field("method", &self.method())
            .finish_non_exhaustive()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // Fails only when the camera is gone, and the events with it. The buffers stop the stream themselves.
        let _ = self.node.unsubscribe_all();
    }
}

fn make_buffers(
    node: &Arc<Node>,
    negotiated: &Negotiated,
    method: Method,
    n_buffers: u32,
    pool: &mut dyn Pool,
) -> Result<Buffers, StreamError> {
    match method {
        Method::Mmap => mapped_buffers(node, negotiated, n_buffers, pool),
        Method::UserPtr => lent_buffers(node, negotiated, n_buffers, pool),
        Method::Auto => lent_buffers(node, negotiated, n_buffers, pool).or_else(|error| match error {
            StreamError::NoUserPtr { reason, .. } => {
                tracing::info!("camera `{}`: frames are copied, as {reason}", node.path().display());
                mapped_buffers(node, negotiated, n_buffers, pool)
            }
            error => Err(error),
        }),
    }
}

fn mapped_buffers(
    node: &Arc<Node>,
    negotiated: &Negotiated,
    n_buffers: u32,
    pool: &dyn Pool,
) -> Result<Buffers, StreamError> {
    let bytes_needed = negotiated
        .format
        .max_bytes(negotiated.size)
        .min(negotiated.image_bytes as usize);
    if pool.buffer_bytes() < bytes_needed {
        return Err(too_small(node, pool, bytes_needed, (0, 0)));
    }
    Buffers::mapped(node.clone(), n_buffers).map_err(|error| StreamError::from_call("make buffers", node.path(), error))
}

fn lent_buffers(
    node: &Arc<Node>,
    negotiated: &Negotiated,
    n_buffers: u32,
    pool: &mut dyn Pool,
) -> Result<Buffers, StreamError> {
    let refuse = |reason: &str| StreamError::NoUserPtr {
        path: node.path().into(),
        reason: reason.into(),
    };
    if negotiated.is_padded() {
        return Err(refuse("its rows are padded"));
    }
    if pool.buffer_bytes() < negotiated.image_bytes as usize {
        return Err(too_small(node, pool, negotiated.image_bytes as usize, (0, 0)));
    }
    let buffers = Buffers::lent(node.clone(), pool, n_buffers).map_err(|error| match error.raw_os_error() {
        Some(libc::EINVAL) => refuse("its driver does not take lent memory"),
        _ => StreamError::from_call("make buffers", node.path(), error),
    })?;
    if buffers.len() < BUFFERS_MIN {
        return Err(too_small(
            node,
            pool,
            negotiated.image_bytes as usize,
            (buffers.len(), BUFFERS_MIN),
        ));
    }
    Ok(buffers)
}

fn too_small(node: &Node, pool: &dyn Pool, bytes_needed: usize, buffers: (usize, usize)) -> StreamError {
    let (n_buffers, n_needed) = buffers;
    StreamError::PoolTooSmall {
        path: node.path().into(),
        n_buffers,
        n_needed,
        buffer_bytes: pool.buffer_bytes(),
        bytes_needed,
    }
}

/// Bytes up to the end of the last row, whose padding may be missing.
fn padded_bytes(negotiated: &Negotiated) -> u32 {
    let rows = negotiated.kind.rows(negotiated.size).unwrap_or(0);
    let row_bytes = negotiated.kind.row_bytes(negotiated.size).unwrap_or(0);
    let n_bytes = rows.saturating_sub(1) * negotiated.bytes_per_line as usize + row_bytes;
    u32::try_from(n_bytes).unwrap_or(u32::MAX)
}

/// Copies a picture without the padding of its rows; none if the source is too short.
fn copy_rows(source: &[u8], target: &mut [u8], negotiated: &Negotiated) -> Option<()> {
    let row_bytes = negotiated.kind.row_bytes(negotiated.size);
    match row_bytes {
        Some(row_bytes) if negotiated.is_padded() => {
            let stride = negotiated.bytes_per_line as usize;
            for (row, target) in target.chunks_exact_mut(row_bytes).enumerate() {
                target.copy_from_slice(source.get(row * stride..row * stride + row_bytes)?);
            }
        }
        _ => target.copy_from_slice(source.get(..target.len())?),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{PixelFormat, Size};
    use crate::v4l2::format::FormatKind;

    fn grey(bytes_per_line: u32) -> Negotiated {
        Negotiated {
            format: PixelFormat::Grey8,
            kind: FormatKind::Grey,
            size: Size { width: 3, height: 2 },
            interval: None,
            bytes_per_line,
            image_bytes: bytes_per_line * 2,
            remarks: Vec::new(),
        }
    }

    #[test]
    fn padding_is_left_out() {
        let source = [1, 2, 3, 99, 4, 5, 6, 99];
        let mut target = [0; 6];
        copy_rows(&source, &mut target, &grey(4)).unwrap();
        assert_eq!(target, [1, 2, 3, 4, 5, 6]);
        // The last row's padding may be missing.
        assert_eq!(padded_bytes(&grey(4)), 7);
        copy_rows(&source[..7], &mut target, &grey(4)).unwrap();
        assert_eq!(copy_rows(&source[..6], &mut target, &grey(4)), None);
    }

    #[test]
    fn without_padding_it_is_one_copy() {
        let source = [1, 2, 3, 4, 5, 6, 99];
        let mut target = [0; 6];
        copy_rows(&source, &mut target, &grey(3)).unwrap();
        assert_eq!(target, [1, 2, 3, 4, 5, 6]);
        assert_eq!(copy_rows(&source[..5], &mut target, &grey(3)), None);
    }

    #[test]
    fn stamps_are_explained() {
        let raw = |flags| Raw {
            pixels: Vec::new().into(),
            bytes_used: 0,
            sequence: 0,
            dropped_before: 0,
            timestamp_ns: 0,
            dequeued_ns: 0,
            flags: BufferFlags(flags),
        };
        assert_eq!(
            (raw(0x1_2001).clock(), raw(0x1_2001).is_start_of_exposure()),
            (StampClock::Monotonic, true)
        );
        assert_eq!(
            (raw(0x4001).clock(), raw(0x4001).is_start_of_exposure()),
            (StampClock::Copied, false)
        );
        assert_eq!(raw(1).clock(), StampClock::Unknown);
    }
}
