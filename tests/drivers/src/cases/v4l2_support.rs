//! What the cases of the V4L2 source share: opening, streaming, counting.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use mirrorball_capture::Size;
use mirrorball_capture::pool::{HeapPool, Pool};
use mirrorball_capture::v4l2::{
    Camera, CameraAddress, FormatKind, LossCause, Method, Negotiated, Raw, Stream, StreamError, StreamSettings, Taken,
    Wish,
};

/// Longest wait for a frame of a camera that is well. The machine is emulated and slow.
pub(super) const PATIENCE: Duration = Duration::from_secs(3);

pub(super) fn say(error: impl std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

/// Fails with what was expected and what was found.
pub(super) fn expect<T: std::fmt::Debug>(is_right: bool, expected: &str, found: T) -> Result<(), String> {
    if is_right {
        Ok(())
    } else {
        Err(format!("expected {expected}, found {found:?}"))
    }
}

pub(super) fn wish(size: (u32, u32), frames_per_s: f64, formats: &[FormatKind]) -> Wish {
    Wish {
        size: Size {
            width: size.0,
            height: size.1,
        },
        frames_per_s,
        formats: formats.to_vec(),
    }
}

pub(super) fn open(node: &Path) -> Result<Camera, String> {
    Camera::open(&CameraAddress::Path(node.into())).map_err(say)
}

pub(super) fn settings(method: Method) -> StreamSettings {
    StreamSettings { method, n_buffers: 4 }
}

/// A camera that streams into a pool.
pub(super) struct Running {
    pub(super) stream: Stream,
    pub(super) pool: HeapPool,
    pub(super) negotiated: Negotiated,
    pub(super) camera: Camera,
}

impl Running {
    pub(super) fn start(node: &Path, wish: &Wish, method: Method) -> Result<Self, String> {
        let mut camera = open(node)?;
        let negotiated = camera.negotiate(wish).map_err(say)?;
        let mut pool = HeapPool::new(10, negotiated.buffer_bytes());
        let stream = camera.start(&negotiated, settings(method), &mut pool).map_err(say)?;
        Ok(Self {
            stream,
            pool,
            negotiated,
            camera,
        })
    }

    pub(super) fn next(&mut self) -> Result<Taken, StreamError> {
        self.stream.next(&mut self.pool, PATIENCE)
    }

    /// The next frame; anything else that comes first is a failure.
    pub(super) fn frame(&mut self) -> Result<Raw, String> {
        match self.next().map_err(say)? {
            Taken::Frame(raw) => Ok(raw),
            other => Err(format!("expected a frame, found {other:?}")),
        }
    }

    /// Takes whatever comes until `n_frames` frames were among it.
    pub(super) fn count(&mut self, n_frames: usize) -> Result<Counts, String> {
        let mut counts = Counts::default();
        let deadline = Instant::now() + Duration::from_secs(60);
        while counts.n_frames < n_frames {
            let taken = self
                .next()
                .map_err(|error| format!("{} after {counts:?}", say(error)))?;
            counts.add(&taken);
            if Instant::now() > deadline {
                return Err(format!("too slow: {counts:?}"));
            }
        }
        Ok(counts)
    }

    /// Takes until the stream fails.
    pub(super) fn until_failure(&mut self) -> Result<(StreamError, Counts), String> {
        let mut counts = Counts::default();
        let deadline = Instant::now() + Duration::from_secs(20);
        while Instant::now() < deadline {
            match self.next() {
                Ok(taken) => counts.add(&taken),
                Err(error) => return Ok((error, counts)),
            }
        }
        Err(format!("the stream does not fail: {counts:?}"))
    }
}

/// Buffers of a pool that nobody uses.
pub(super) fn free_buffers(pool: &mut dyn Pool) -> usize {
    let leases: Vec<_> = std::iter::from_fn(|| pool.lease()).collect();
    leases.len()
}

/// What came out of a stream.
#[derive(Debug, Clone, Default)]
pub(super) struct Counts {
    pub(super) n_frames: usize,
    pub(super) n_dropped: u64,
    /// Different frames with the same number, which vivid sends when it is overloaded.
    pub(super) n_repeated: u64,
    pub(super) n_timeouts: usize,
    pub(super) losses: Vec<LossCause>,
    pub(super) first: Option<u32>,
    pub(super) last: Option<u32>,
    pub(super) last_stamp_ns: u64,
    /// Stamps that were not after the one before.
    pub(super) n_stamps_back: usize,
}

impl Counts {
    fn add(&mut self, taken: &Taken) {
        match taken {
            Taken::Frame(raw) => {
                self.n_frames += 1;
                self.n_repeated += u64::from(self.last == Some(raw.sequence));
                self.see(Some(raw.sequence), raw.dropped_before);
                self.n_stamps_back += usize::from(raw.timestamp_ns <= self.last_stamp_ns);
                self.last_stamp_ns = raw.timestamp_ns;
            }
            Taken::Lost(loss) => {
                self.losses.push(loss.cause);
                self.see(loss.sequence, loss.dropped_before);
            }
            Taken::TimedOut => self.n_timeouts += 1,
            Taken::ControlChanged(_) => {}
        }
    }

    fn see(&mut self, sequence: Option<u32>, dropped_before: u32) {
        if self.first.is_some() {
            self.n_dropped += u64::from(dropped_before);
        }
        self.first = self.first.or(sequence);
        self.last = sequence.or(self.last);
    }

    /// Checks that frames, losses and drops are exactly what the driver numbered.
    pub(super) fn check_sum(&self) -> Result<(), String> {
        let (Some(first), Some(last)) = (self.first, self.last) else {
            return Err(format!("nothing came: {self:?}"));
        };
        let numbered = u64::from(last.wrapping_sub(first)) + 1 + self.n_repeated;
        let counted = self.n_frames as u64 + self.losses.len() as u64 + self.n_dropped;
        expect(
            numbered == counted,
            &format!("{numbered} buffers numbered by the driver"),
            (counted, self),
        )
    }
}

/// Open files, mappings and resident memory of this process.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    pub(super) files: usize,
    pub(super) mappings: usize,
    pub(super) resident_bytes: usize,
}

pub(super) fn footprint() -> Footprint {
    let pages = fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let resident_pages: usize = pages
        .split_whitespace()
        .nth(1)
        .and_then(|text| text.parse().ok())
        .unwrap_or(0);
    Footprint {
        files: fs::read_dir("/proc/self/fd").map_or(0, Iterator::count),
        mappings: fs::read_to_string("/proc/self/maps")
            .unwrap_or_default()
            .lines()
            .count(),
        resident_bytes: resident_pages * 4096,
    }
}

/// Checks that nothing has piled up: as many files and, but for what the allocator keeps, as much memory.
pub(super) fn expect_no_growth(before: Footprint, after: Footprint) -> Result<(), String> {
    // The allocator keeps a few freed mappings; one buffer leaked per stream would be many times that.
    let slack_bytes = 2 << 20;
    let is_same = after.files <= before.files
        && after.mappings <= before.mappings + 8
        && after.resident_bytes <= before.resident_bytes + slack_bytes;
    expect(is_same, &format!("no more than {before:?}"), after)
}
