//! Every frame that is missing, with its cause.

use serde::{Deserialize, Serialize};

use super::checker::{CheckedStamp, SequenceEvent, StampBasis};

/// Why a frame is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LossCause {
    /// The driver counted it but never handed it over: a gap in its sequence numbers.
    DriverDrop,
    /// The driver handed it over as faulty.
    ErrorFrame,
    /// It has fewer bytes than its format needs, or more than it can have.
    ShortFrame,
    /// It has no bytes at all.
    ZeroLength,
    /// It is no whole JPEG picture.
    BadJpeg,
    /// It came when no buffer was free: readers or the recorder hold them all.
    Overrun,
    /// Its stamp repeats or precedes the one before and nothing better is known of its time.
    BadStamp,
    /// The driver never saw it: twice the time or more between two frames that it counted one after the other.
    SensorGap,
    /// It was to come while the stream was started anew; their number is estimated from the time that passed.
    StreamRestart,
    /// It was to come while the camera was unplugged; their number is estimated from the time that passed.
    Unplugged,
}

impl LossCause {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::DriverDrop,
        Self::ErrorFrame,
        Self::ShortFrame,
        Self::ZeroLength,
        Self::BadJpeg,
        Self::Overrun,
        Self::BadStamp,
        Self::SensorGap,
        Self::StreamRestart,
        Self::Unplugged,
    ];

    /// What it is called in tables and logs.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::DriverDrop => "driver drop",
            Self::ErrorFrame => "error frame",
            Self::ShortFrame => "short frame",
            Self::ZeroLength => "zero length",
            Self::BadJpeg => "bad JPEG",
            Self::Overrun => "overrun",
            Self::BadStamp => "bad stamp",
            Self::SensorGap => "sensor gap",
            Self::StreamRestart => "stream restart",
            Self::Unplugged => "unplugged",
        }
    }
}

/// Frames lost, by cause.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LossCounts([u64; LossCause::ALL.len()]);

impl LossCounts {
    /// Frames lost for this cause.
    #[must_use]
    pub fn get(&self, cause: LossCause) -> u64 {
        self.0[cause as usize]
    }

    /// Frames lost for whatever cause.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// All causes with a loss, in the order of [`LossCause::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (LossCause, u64)> + '_ {
        LossCause::ALL
            .into_iter()
            .map(|cause| (cause, self.get(cause)))
            .filter(|&(_, n_frames)| n_frames > 0)
    }

    fn add(&mut self, cause: LossCause, n_frames: u64) {
        self.0[cause as usize] += n_frames;
    }
}

/// Why a stream was interrupted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interruption {
    /// It was stopped and started again.
    StreamRestart,
    /// The camera was gone.
    Unplugged,
}

/// So many frames with the same distance in a row, and the camera has another rate: half a second at 30 frames/s.
const NEW_RATE_FRAMES: u32 = 16;

/// Share of one frame in the interval that is believed, as a divisor: 2 ms of jitter move it by 30 µs.
const SMOOTHING: u64 = 64;

/// Two distances are the same if they differ by less than this fraction.
const SAME_DISTANCE: f64 = 0.2;

/// The account of one camera: frames delivered plus frames lost are frames made, by two witnesses.
///
/// 1. **Sequence numbers.** A number that neither a good nor a bad buffer has is a `DriverDrop`.
/// 2. **Time stamps** of frames that have a good one. If more intervals have passed between two of them than frames are
///    accounted for, the rest is a `SensorGap`, or was lost in the interruption that came between.
///
/// Bad buffers whose number cannot be right are put to the first gap that either witness finds; as long as there is
/// none they stand for no frame ([`Self::empty_buffers`]).
///
/// The interval is the nominal one until 16 frames in a row have another distance: then that is the camera's rate, and
/// what was counted as sensor gaps until then stays counted. Stamps estimated from arrival are no witnesses.
/// Frames after the last good one are counted when the next one comes.
#[derive(Debug, Clone)]
pub struct LossLedger {
    nominal_ns: u64,
    interval_ns: u64,
    rate: Option<Candidate>,
    delivered: u64,
    duplicates: u64,
    counts: LossCounts,
    total_at_last_frame: u64,
    unplaced: Vec<LossCause>,
    empty_buffers: u64,
    last_sequence: Option<u64>,
    anchor: Option<Anchor>,
    interruption: Option<Interruption>,
}

/// The last frame with a good stamp.
#[derive(Debug, Clone, Copy)]
struct Anchor {
    timestamp_ns: u64,
    /// Frames accounted for since, itself not among them.
    accounted: u64,
    /// Frames accounted for before it for which there was no time: its stamp is so many intervals too early.
    surplus: u64,
}

/// Another distance between frames than the one believed, and how many frames in a row have had it.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    interval_ns: u64,
    frames: u32,
}

/// Bad buffers without a number that are remembered: more than a driver has buffers.
const UNPLACED_MAX: usize = 64;

impl LossLedger {
    /// Opens the account of a camera with this nominal time between frames, in nanoseconds, above 0.
    #[must_use]
    pub fn new(interval_ns: u64) -> Self {
        let interval_ns = interval_ns.max(1);
        Self {
            nominal_ns: interval_ns,
            interval_ns,
            rate: None,
            delivered: 0,
            duplicates: 0,
            counts: LossCounts::default(),
            total_at_last_frame: 0,
            unplaced: Vec::with_capacity(UNPLACED_MAX),
            empty_buffers: 0,
            last_sequence: None,
            anchor: None,
            interruption: None,
        }
    }

    /// Accounts for a good frame and returns how many were lost between the good one before and this one.
    pub fn delivered(&mut self, stamp: &CheckedStamp) -> u32 {
        if stamp.sequence_event == SequenceEvent::Restarted && self.interruption.is_none() {
            self.interruption = Some(Interruption::StreamRestart);
        }
        self.account(Some(stamp.sequence));
        self.delivered += 1;
        if matches!(stamp.basis, StampBasis::Driver | StampBasis::Mapped) {
            self.account_for_time(stamp.timestamp_ns);
        }
        let total = self.counts.total();
        let lost_before = total - self.total_at_last_frame;
        self.total_at_last_frame = total;
        u32::try_from(lost_before).unwrap_or(u32::MAX)
    }

    /// Accounts for a frame that is lost, with the running number it would have had, if that is known.
    pub fn lost(&mut self, cause: LossCause, sequence: Option<u64>) {
        if sequence.is_some() {
            self.account(sequence);
            self.counts.add(cause, 1);
        } else if self.unplaced.len() < UNPLACED_MAX {
            self.unplaced.push(cause);
        } else {
            self.empty_buffers += 1;
        }
    }

    /// Accounts for a buffer that holds the frame before once more.
    pub fn duplicate(&mut self) {
        self.duplicates += 1;
    }

    /// Takes note that the stream has stopped; it goes on with the next frame, perhaps with another interval.
    pub fn interrupted(&mut self, interruption: Interruption, interval_ns: u64) {
        // Who is unplugged is started anew as well: the graver cause stays.
        if self.interruption != Some(Interruption::Unplugged) {
            self.interruption = Some(interruption);
        }
        let interval_ns = interval_ns.max(1);
        if interval_ns != self.nominal_ns {
            (self.nominal_ns, self.interval_ns) = (interval_ns, interval_ns);
        }
        self.rate = None;
    }

    /// Good frames.
    #[must_use]
    pub fn delivered_frames(&self) -> u64 {
        self.delivered
    }

    /// Frames lost, by cause.
    #[must_use]
    pub fn counts(&self) -> &LossCounts {
        &self.counts
    }

    /// Buffers that held the frame before once more.
    #[must_use]
    pub fn duplicates(&self) -> u64 {
        self.duplicates
    }

    /// Bad buffers that stand for no frame, as far as is known.
    #[must_use]
    pub fn empty_buffers(&self) -> u64 {
        self.empty_buffers + self.unplaced.len() as u64
    }

    /// Time between frames that is believed at present, in nanoseconds.
    #[must_use]
    pub fn interval_ns(&self) -> u64 {
        self.interval_ns
    }

    /// Accounts for one frame and for the gap before it in the sequence numbers.
    fn account(&mut self, sequence: Option<u64>) {
        let gap = match (self.last_sequence, sequence) {
            (Some(last), Some(sequence)) => sequence.saturating_sub(last).saturating_sub(1),
            _ => 0,
        };
        self.last_sequence = sequence.or(self.last_sequence);
        let unexplained = self.explain_by_unplaced(gap);
        self.counts.add(LossCause::DriverDrop, unexplained);
        if let Some(anchor) = &mut self.anchor {
            anchor.accounted = anchor.accounted.saturating_add(gap).saturating_add(1);
        }
    }

    /// Compares the frames accounted for since the last good stamp with the time that has passed.
    fn account_for_time(&mut self, timestamp_ns: u64) {
        let interruption = self.interruption.take();
        let before = self.anchor.replace(Anchor {
            timestamp_ns,
            accounted: 0,
            surplus: 0,
        });
        let Some(before) = before else { return };
        let passed_ns = timestamp_ns.saturating_sub(before.timestamp_ns);
        let n_intervals = (passed_ns + self.interval_ns / 2) / self.interval_ns;
        let missing = n_intervals.saturating_sub(before.accounted + before.surplus);
        if let Some(anchor) = &mut self.anchor {
            anchor.surplus = before.accounted.saturating_sub(n_intervals);
        }
        let unexplained = self.explain_by_unplaced(missing);
        let cause = match interruption {
            None => LossCause::SensorGap,
            Some(Interruption::StreamRestart) => LossCause::StreamRestart,
            Some(Interruption::Unplugged) => LossCause::Unplugged,
        };
        self.counts.add(cause, unexplained);
        // What has found no frame by now stands for none.
        self.empty_buffers += self.unplaced.drain(..).count() as u64;
        if interruption.is_none() {
            self.watch_rate(passed_ns, before.accounted);
        }
    }

    /// Puts bad buffers without a number to frames that are missing, and returns how many are left.
    fn explain_by_unplaced(&mut self, missing: u64) -> u64 {
        let n_explained = usize::try_from(missing).map_or(self.unplaced.len(), |n| n.min(self.unplaced.len()));
        for cause in self.unplaced.drain(..n_explained) {
            self.counts.add(cause, 1);
        }
        missing - n_explained as u64
    }

    /// Believes another rate when 16 frames in a row have had it.
    fn watch_rate(&mut self, passed_ns: u64, accounted: u64) {
        let distance_ns = passed_ns / accounted.max(1);
        let is_same = |a: u64, b: u64| (a as f64 - b as f64).abs() < SAME_DISTANCE * b as f64;
        if is_same(distance_ns, self.interval_ns) || distance_ns == 0 {
            // Followed slowly: the true interval counts the frames of a long gap, and one frame's jitter does not matter.
            self.interval_ns = (self.interval_ns * (SMOOTHING - 1) + distance_ns) / SMOOTHING;
            self.rate = None;
            return;
        }
        self.rate = Some(match self.rate {
            Some(rate) if is_same(distance_ns, rate.interval_ns) => Candidate {
                // The mean so far, so that jitter of one frame does not become the rate.
                interval_ns: (rate.interval_ns * u64::from(rate.frames) + distance_ns) / u64::from(rate.frames + 1),
                frames: rate.frames + 1,
            },
            _ => Candidate {
                interval_ns: distance_ns,
                frames: 1,
            },
        });
        if let Some(rate) = self.rate.filter(|rate| rate.frames >= NEW_RATE_FRAMES) {
            self.interval_ns = rate.interval_ns;
            self.rate = None;
        }
    }
}

#[cfg(test)]
#[path = "losses_tests.rs"]
mod tests;
