//! When and how often the frames of a recording are played.

use std::num::NonZeroU32;
use std::time::{Duration, Instant};

/// How fast a recording is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Each frame as long after the first one as its time stamp says; a late frame is sent at once.
    Recorded,
    /// As fast as the frames are asked for.
    Max,
}

/// How often a recording is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeat {
    /// This many times in all.
    Times(NonZeroU32),
    /// Until nobody asks any more.
    Forever,
}

impl Repeat {
    /// Once, without repetition.
    pub const ONCE: Self = Self::Times(NonZeroU32::MIN);

    /// True if there is a round with this number, counted from 0.
    pub(super) fn has_round(self, round: u64) -> bool {
        match self {
            Self::Times(times) => round < u64::from(times.get()),
            Self::Forever => true,
        }
    }
}

/// Interval put between two rounds of a recording that has only one frame of the leading camera.
pub(super) const LONE_FRAME_INTERVAL_NS: u64 = 33_333_333;

/// Lets frames pass when their moment has come.
#[derive(Debug)]
pub(super) struct Pacer {
    pace: Pace,
    /// Time stamp that is played at once.
    first_ns: u64,
    started: Option<Instant>,
}

impl Pacer {
    /// The clock starts with the first wait.
    pub(super) fn new(pace: Pace, first_ns: u64) -> Self {
        Self {
            pace,
            first_ns,
            started: None,
        }
    }

    /// Waits for the moment of `timestamp_ns`, at most `timeout`; true if the moment has come.
    pub(super) fn wait_for(&mut self, timestamp_ns: u64, timeout: Duration) -> bool {
        match self.pace {
            Pace::Max => true,
            Pace::Recorded => {
                let now = Instant::now();
                let started = *self.started.get_or_insert(now);
                let offset = Duration::from_nanos(timestamp_ns.saturating_sub(self.first_ns));
                let wait = offset.saturating_sub(now - started);
                std::thread::sleep(wait.min(timeout));
                wait <= timeout
            }
        }
    }
}
