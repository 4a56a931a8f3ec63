//! One camera's sequence numbers and time stamps, as the driver gives them, turned into ones that can be relied on.

use super::clock::ClockMap;

/// What kind of stamp the driver puts on its buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampKind {
    /// On the host's monotonic clock, says the driver.
    Monotonic,
    /// On a clock of its own, or on an unknown one.
    Other,
}

/// What the driver says about one buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BufferStamp {
    /// The driver's count, which wraps.
    pub sequence: u32,
    /// The driver's stamp in nanoseconds.
    pub stamp_ns: u64,
    /// What clock the stamp is on.
    pub kind: StampKind,
    /// The host's monotonic clock just after the buffer was dequeued, in nanoseconds.
    pub dequeued_ns: u64,
}

/// Whether stamps are believed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum StampPolicy {
    /// Monotonic stamps are believed until they prove wrong.
    #[default]
    Auto,
    /// Stamps are believed, monotonic or not, in the future or not; frames whose stamp does not rise are lost. For
    /// cameras that share a clock of their own, one that outlives a replug.
    Driver,
    /// Stamps are mapped to the host's clock from the first one on.
    Mapped,
}

/// How the stamps of one camera are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StampSettings {
    /// Whether stamps are believed.
    pub policy: StampPolicy,
    /// Added to every time stamp, in nanoseconds: calibrated per camera, negative if frames are taken before they are
    /// stamped.
    pub offset_ns: i64,
    /// Nominal time between frames in nanoseconds, above 0.
    pub interval_ns: u64,
}

/// Where a time stamp comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampBasis {
    /// The driver's stamp as it is.
    Driver,
    /// The driver's stamp, mapped to the host's clock; later than the truth by the least delay of the camera.
    Mapped,
    /// The time of arrival, less the least delay where it is known: the stamp of this one frame was wrong, or the
    /// camera has none.
    Arrival,
}

/// What is wrong with a stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampDoubt {
    /// Later than the arrival of its own frame.
    Future,
    /// The same as that of the frame before.
    Repeated,
    /// Earlier than that of the frame before.
    Backwards,
    /// On a clock of its own that has leapt forward by more than 100 ms.
    Jumped,
    /// Right in itself, but once mapped not later than the frame before.
    Overtaken,
}

/// What is remarkable about a sequence number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SequenceEvent {
    /// Nothing: it is higher than the one before.
    Continues,
    /// It has passed the end of 32 bits.
    Wrapped,
    /// It fell, stood still under a new stamp, or rose by more than time allows: the driver counts anew. What is
    /// missing here is known from the time stamps only.
    Restarted,
}

/// The number and time of a good frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CheckedStamp {
    /// Running number, rising over wraps, restarts and replugs.
    pub sequence: u64,
    /// Capture time in nanoseconds on the host's monotonic clock, later than that of the frame before.
    pub timestamp_ns: u64,
    /// Where the time comes from.
    pub basis: StampBasis,
    /// What was wrong with the driver's stamp, if anything.
    pub doubt: Option<StampDoubt>,
    /// What was remarkable about the sequence number.
    pub sequence_event: SequenceEvent,
}

/// What to do with a buffer that the driver calls good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Checked {
    /// A frame.
    Frame(CheckedStamp),
    /// A frame whose time is not known: nothing to pair it by. It is lost.
    BadStamp {
        /// Its running number.
        sequence: u64,
        /// What is wrong.
        doubt: StampDoubt,
    },
    /// The same sequence number and stamp as the frame before: no new frame.
    Duplicate,
}

/// How often what was found, since the checker was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StampCounters {
    /// Stamps later than the arrival of their frames, while stamps were believed.
    pub future: u64,
    /// Stamps equal to the one before.
    pub repeated: u64,
    /// Stamps earlier than the one before.
    pub backwards: u64,
    /// Leaps of the device's clock.
    pub jumped: u64,
    /// Stamps that came out not later than the frame before.
    pub overtaken: u64,
    /// Passes of the driver's count over the end of 32 bits.
    pub wrapped: u64,
    /// Times the driver began to count anew without being asked.
    pub restarted: u64,
    /// Changes from believing stamps to mapping them, or from that to going by arrival.
    pub mode_changes: u64,
}

/// A device clock that leaps by more than this has been set, in nanoseconds; less than this may be a late first frame.
const JUMP_NS: i64 = 100_000_000;

/// A doubt weighs this much, a good stamp takes 1 away ...
const DOUBT_WEIGHT: u32 = 8;

/// ... and at this weight stamps are no longer believed: three wrong ones in a row, or one in nine for long.
const DOUBT_MAX: u32 = 22;

/// After so many repeated stamps in a row a clock stands still.
const STANDING_STILL: u32 = 3;

/// Frames that may be missing beside what time allows: what a driver may hold back in its buffers.
const BUFFERED_FRAMES: u64 = 64;

/// Checks the buffers of one camera, in the order in which they are dequeued.
///
/// **Time stamps.** A stamp is in doubt if it is not later than the last good one, or, while stamps are trusted, later
/// than its own arrival (`Future`), or, while they are mapped, on a clock that has leapt (`Jumped`).
///
/// | mode | time of a frame | time of a frame in doubt |
/// | --- | --- | --- |
/// | trusted | the stamp | arrival less the least delay seen |
/// | mapped | the stamp, mapped by [`ClockMap`]: never later than its arrival | arrival |
/// | arrival | arrival | |
///
/// A frame in doubt whose time would be less than half an interval after the frame before is lost (`BadStamp`).
/// A stream begins trusted if its stamps are monotonic, else mapped; if its very first stamp lies in the future, mapped.
/// When three stamps in a row are in doubt, or one in nine for long, trusted becomes mapped and mapped begins its map
/// anew; if all three were repeated, either becomes arrival. With the policy [`StampPolicy::Driver`] a stream stays trusted,
/// only stamps that do not rise are in doubt, and their frames are lost.
///
/// **Sequence numbers** are the driver's, continued over 32 bits. After [`Self::begin_stream`], or when the driver begins
/// to count anew by itself, numbers go on with the one after the last.
#[derive(Debug, Clone)]
pub struct StampChecker {
    settings: StampSettings,
    mode: Mode,
    map: ClockMap,
    doubt_weight: u32,
    repeated_in_row: u32,
    last_buffer: Option<LastBuffer>,
    last_good_stamp_ns: Option<u64>,
    last_sequence: Option<u64>,
    last_timestamp_ns: Option<u64>,
    counters: StampCounters,
}

/// The buffer before, good or bad.
#[derive(Debug, Clone, Copy)]
struct LastBuffer {
    sequence: u32,
    /// If it was a bad one, that of the last good one; None if there is none.
    stamp_ns: Option<u64>,
    dequeued_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Undecided,
    Trusted,
    Mapped,
    Arrival,
}

impl StampChecker {
    /// Makes a checker for one camera.
    #[must_use]
    pub fn new(settings: StampSettings) -> Self {
        Self {
            settings,
            mode: Mode::Undecided,
            map: ClockMap::new(),
            doubt_weight: 0,
            repeated_in_row: 0,
            last_buffer: None,
            last_good_stamp_ns: None,
            last_sequence: None,
            last_timestamp_ns: None,
            counters: StampCounters::default(),
        }
    }

    /// Takes note that the stream was started anew, after an error or a replug, perhaps with another interval: the
    /// driver's count and the device's clock begin anew, the published ones go on.
    pub fn begin_stream(&mut self, interval_ns: u64) {
        self.settings.interval_ns = interval_ns;
        self.mode = Mode::Undecided;
        self.map.clear();
        self.doubt_weight = 0;
        self.repeated_in_row = 0;
        self.last_buffer = None;
        self.last_good_stamp_ns = None;
    }

    /// Checks a buffer that the driver calls good.
    pub fn check(&mut self, buffer: BufferStamp) -> Checked {
        if self
            .last_buffer
            .is_some_and(|last| (last.sequence, last.stamp_ns) == (buffer.sequence, Some(buffer.stamp_ns)))
        {
            return Checked::Duplicate;
        }
        let (sequence, sequence_event) = self.continue_sequence(buffer.sequence, buffer.dequeued_ns);
        let (basis, host_ns, doubt) = self.time(&buffer);
        self.last_buffer = Some(LastBuffer {
            sequence: buffer.sequence,
            stamp_ns: Some(buffer.stamp_ns),
            dequeued_ns: buffer.dequeued_ns,
        });
        if let (StampPolicy::Driver, Some(doubt)) = (self.settings.policy, doubt) {
            return Checked::BadStamp { sequence, doubt };
        }
        let timestamp_ns = host_ns.saturating_add_signed(self.settings.offset_ns);
        let distance_ns = match doubt {
            Some(_) if basis == StampBasis::Arrival => (self.settings.interval_ns / 2).max(1),
            _ => 1,
        };
        let is_too_early = |last_ns: u64| timestamp_ns < last_ns.saturating_add(distance_ns);
        if self.last_timestamp_ns.is_some_and(is_too_early) {
            let doubt = doubt.unwrap_or(StampDoubt::Overtaken);
            self.counters.overtaken += u64::from(doubt == StampDoubt::Overtaken);
            return Checked::BadStamp { sequence, doubt };
        }
        self.last_timestamp_ns = Some(timestamp_ns);
        Checked::Frame(CheckedStamp {
            sequence,
            timestamp_ns,
            basis,
            doubt,
            sequence_event,
        })
    }

    /// The running number of a buffer that is no good frame, from the driver's count and the host's time of dequeueing
    /// in nanoseconds; None if the count cannot be right, as that of buffers which a driver hands back empty.
    pub fn place(&mut self, driver_sequence: u32, dequeued_ns: u64) -> Option<u64> {
        if let Some(last) = &self.last_buffer {
            let n_frames = u64::from(driver_sequence.wrapping_sub(last.sequence));
            if n_frames == 0 || n_frames > self.most_frames_since(last, dequeued_ns) {
                return None;
            }
        }
        let (sequence, _) = self.continue_sequence(driver_sequence, dequeued_ns);
        self.last_buffer = Some(LastBuffer {
            sequence: driver_sequence,
            stamp_ns: self.last_buffer.and_then(|last| last.stamp_ns),
            dequeued_ns,
        });
        Some(sequence)
    }

    /// How often what was found.
    #[must_use]
    pub fn counters(&self) -> StampCounters {
        self.counters
    }

    /// Where time stamps come from at present, single frames aside; None before the stream's first frame.
    #[must_use]
    pub fn basis(&self) -> Option<StampBasis> {
        match self.mode {
            Mode::Undecided => None,
            Mode::Trusted => Some(StampBasis::Driver),
            Mode::Mapped => Some(StampBasis::Mapped),
            Mode::Arrival => Some(StampBasis::Arrival),
        }
    }

    /// The map from the camera's clock to the host's, over the good stamps of this stream.
    #[must_use]
    pub fn map(&self) -> &ClockMap {
        &self.map
    }

    fn continue_sequence(&mut self, driver_sequence: u32, dequeued_ns: u64) -> (u64, SequenceEvent) {
        let (n_frames, event) = match &self.last_buffer {
            None => (1, SequenceEvent::Continues),
            Some(last) => {
                let n_frames = u64::from(driver_sequence.wrapping_sub(last.sequence));
                if n_frames == 0 || n_frames > self.most_frames_since(last, dequeued_ns) {
                    (1, SequenceEvent::Restarted)
                } else if driver_sequence < last.sequence {
                    (n_frames, SequenceEvent::Wrapped)
                } else {
                    (n_frames, SequenceEvent::Continues)
                }
            }
        };
        self.counters.wrapped += u64::from(event == SequenceEvent::Wrapped);
        self.counters.restarted += u64::from(event == SequenceEvent::Restarted);
        let sequence = match self.last_sequence {
            Some(last_sequence) => last_sequence.saturating_add(n_frames),
            None => driver_sequence.into(),
        };
        self.last_sequence = Some(sequence);
        (sequence, event)
    }

    /// Most frames the camera can have taken since a buffer, at twice its nominal rate.
    fn most_frames_since(&self, last: &LastBuffer, dequeued_ns: u64) -> u64 {
        let passed_ns = dequeued_ns.saturating_sub(last.dequeued_ns);
        let n_frames = passed_ns / (self.settings.interval_ns / 2).max(1) + BUFFERED_FRAMES;
        n_frames.min(u64::from(u32::MAX / 2))
    }

    /// The host's time of a frame, where it comes from, and what was wrong with its stamp.
    fn time(&mut self, buffer: &BufferStamp) -> (StampBasis, u64, Option<StampDoubt>) {
        if self.mode == Mode::Undecided {
            self.mode = self.first_mode(buffer);
        }
        let doubt = self.doubt(buffer);
        self.repeated_in_row = match doubt {
            Some(StampDoubt::Repeated) => self.repeated_in_row.saturating_add(1),
            _ => 0,
        };
        match doubt {
            None => self.doubt_weight = self.doubt_weight.saturating_sub(1),
            Some(doubt) => {
                self.count(doubt);
                self.doubt_weight = (self.doubt_weight + DOUBT_WEIGHT).min(DOUBT_MAX);
                if self.doubt_weight < DOUBT_MAX || self.settings.policy == StampPolicy::Driver {
                    // The map is left alone: this pair is wrong.
                    return (StampBasis::Arrival, self.arrival_ns(buffer), Some(doubt));
                }
                self.fall_back();
            }
        }
        self.last_good_stamp_ns = Some(buffer.stamp_ns);
        let (basis, host_ns) = match self.mode {
            Mode::Trusted => {
                self.map.push(buffer.stamp_ns, buffer.dequeued_ns);
                (StampBasis::Driver, buffer.stamp_ns)
            }
            Mode::Mapped => {
                self.map.push(buffer.stamp_ns, buffer.dequeued_ns);
                let host_ns = self.map.host_ns(buffer.stamp_ns).unwrap_or(buffer.dequeued_ns);
                (StampBasis::Mapped, host_ns)
            }
            Mode::Undecided | Mode::Arrival => (StampBasis::Arrival, self.arrival_ns(buffer)),
        };
        (basis, host_ns, doubt)
    }

    fn first_mode(&mut self, buffer: &BufferStamp) -> Mode {
        let is_future = buffer.stamp_ns > buffer.dequeued_ns;
        match (self.settings.policy, buffer.kind) {
            (StampPolicy::Driver, _) => Mode::Trusted,
            (StampPolicy::Auto, StampKind::Monotonic) if !is_future => Mode::Trusted,
            (StampPolicy::Auto, StampKind::Monotonic) => {
                self.count(StampDoubt::Future);
                self.counters.mode_changes += 1;
                Mode::Mapped
            }
            (StampPolicy::Auto, StampKind::Other) | (StampPolicy::Mapped, _) => Mode::Mapped,
        }
    }

    fn doubt(&self, buffer: &BufferStamp) -> Option<StampDoubt> {
        if self.mode == Mode::Arrival {
            return None;
        }
        if let Some(last_good_ns) = self.last_good_stamp_ns {
            let last_ns = self.last_buffer.and_then(|last| last.stamp_ns);
            if buffer.stamp_ns == last_good_ns || Some(buffer.stamp_ns) == last_ns {
                return Some(StampDoubt::Repeated);
            }
            if buffer.stamp_ns < last_good_ns {
                return Some(StampDoubt::Backwards);
            }
        }
        if self.mode == Mode::Trusted {
            let is_future = buffer.stamp_ns > buffer.dequeued_ns && self.settings.policy != StampPolicy::Driver;
            return is_future.then_some(StampDoubt::Future);
        }
        let delay_ns = self.map.delay_ns(buffer.stamp_ns, buffer.dequeued_ns)?;
        (delay_ns < -JUMP_NS).then_some(StampDoubt::Jumped)
    }

    /// Gives up the present mode: maps stamps that were believed, begins the map anew if it was one already, or goes by
    /// arrival if stamps stand still.
    fn fall_back(&mut self) {
        self.counters.mode_changes += 1;
        self.doubt_weight = 0;
        self.map.clear();
        self.mode = if self.repeated_in_row >= STANDING_STILL {
            Mode::Arrival
        } else {
            Mode::Mapped
        };
    }

    /// Arrival less the least delay: what frames whose stamps were trusted took to arrive at least; 0 where stamps are
    /// mapped, since mapped stamps are arrivals too.
    fn arrival_ns(&self, buffer: &BufferStamp) -> u64 {
        let least_delay_ns = match self.mode {
            Mode::Trusted => self.map.host_ns(buffer.dequeued_ns).map_or(0, |host_ns| {
                host_ns
                    .saturating_sub(buffer.dequeued_ns)
                    .min(self.settings.interval_ns)
            }),
            Mode::Undecided | Mode::Mapped | Mode::Arrival => 0,
        };
        buffer.dequeued_ns.saturating_sub(least_delay_ns)
    }

    fn count(&mut self, doubt: StampDoubt) {
        let counter = match doubt {
            StampDoubt::Future => &mut self.counters.future,
            StampDoubt::Repeated => &mut self.counters.repeated,
            StampDoubt::Backwards => &mut self.counters.backwards,
            StampDoubt::Jumped => &mut self.counters.jumped,
            StampDoubt::Overtaken => &mut self.counters.overtaken,
        };
        *counter += 1;
    }
}

#[cfg(test)]
#[path = "checker_tests.rs"]
mod tests;
