//! From source to hand-over: reads frames, groups them, publishes the sets.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;

use crate::frame::FrameSet;
use crate::grouping::{Grouper, GroupingCounters};
use crate::handover::{HandoverError, PublishOutcome, Publisher, PublisherStats};
use crate::source::{Next, Source, SourceError};

/// What to do with a frame that cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BadFramePolicy {
    /// End with its error.
    Fail,
    /// Count it, say so once a second, and go on with the next frame.
    Skip,
}

/// How far one step has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// There may be more.
    Continues,
    /// The source has ended, and all it has sent is published; or the only reader is gone.
    Ended,
}

/// How long a reading thread waits for a frame before it looks whether it should stop.
const STEP_TIMEOUT: Duration = Duration::from_millis(100);

/// Shortest interval between two messages about skipped frames.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// A source on its way to a publisher, driven step by step.
pub struct Playback {
    source: Box<dyn Source>,
    grouper: Grouper,
    publisher: Publisher,
    policy: BadFramePolicy,
    frames: u64,
    skipped_frames: u64,
    reported_skipped_frames: u64,
    last_report: Option<Instant>,
}

/// What a playback has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PlaybackStats {
    /// Frames the source has sent.
    pub frames: u64,
    /// Frames that could not be read and were skipped.
    pub skipped_frames: u64,
    /// What became of the frames.
    pub grouping: GroupingCounters,
    /// What became of the sets.
    pub publisher: PublisherStats,
}

impl Playback {
    /// Joins a source to a publisher.
    #[must_use]
    pub fn new(source: Box<dyn Source>, grouper: Grouper, publisher: Publisher, policy: BadFramePolicy) -> Self {
        Self {
            source,
            grouper,
            publisher,
            policy,
            frames: 0,
            skipped_frames: 0,
            reported_skipped_frames: 0,
            last_report: None,
        }
    }

    /// Waits up to `timeout` for one frame and publishes the sets it completes.
    ///
    /// # Errors
    ///
    /// [`HandoverError::Source`] if the source fails, or a frame is bad and the policy is to fail; any other
    /// [`HandoverError`] if publishing fails.
    pub fn step(&mut self, timeout: Duration) -> Result<Progress, HandoverError> {
        match self.source.next_frame(timeout) {
            Ok(Next::Frame(frame)) => {
                self.frames += 1;
                let sets = self.grouper.push(frame);
                self.publish(sets)
            }
            Ok(Next::TimedOut) => Ok(Progress::Continues),
            Ok(Next::End) => {
                let sets = self.grouper.finish();
                self.publish(sets)?;
                Ok(Progress::Ended)
            }
            Err(error) if error.is_skippable() && self.policy == BadFramePolicy::Skip => {
                self.skip(&error);
                Ok(Progress::Continues)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// What was done so far.
    #[must_use]
    pub fn stats(&self) -> PlaybackStats {
        PlaybackStats {
            frames: self.frames,
            skipped_frames: self.skipped_frames,
            grouping: self.grouper.counters(),
            publisher: self.publisher.stats(),
        }
    }

    /// Counts the readers, see [`Publisher::count_readers`].
    #[must_use]
    pub fn count_readers(&self) -> usize {
        self.publisher.count_readers()
    }

    fn publish(&mut self, sets: Vec<FrameSet>) -> Result<Progress, HandoverError> {
        for set in sets {
            match self.publisher.publish(set)? {
                PublishOutcome::Delivered { .. } | PublishOutcome::NoReader => {}
                PublishOutcome::Closed => return Ok(Progress::Ended),
            }
        }
        Ok(Progress::Continues)
    }

    fn skip(&mut self, error: &SourceError) {
        self.skipped_frames += 1;
        if self.last_report.is_some_and(|last| last.elapsed() < REPORT_INTERVAL) {
            return;
        }
        self.last_report = Some(Instant::now());
        let n_new = self.skipped_frames - self.reported_skipped_frames;
        self.reported_skipped_frames = self.skipped_frames;
        let reason = std::error::Error::source(error).map_or_else(String::new, ToString::to_string);
        tracing::warn!(
            "skipped {n_new} bad frames, {} in all; the last: {error}: {reason}",
            self.skipped_frames
        );
    }
}

/// A thread that plays a source; it ends with the source, or with the next set after the reader is gone.
///
/// Dropping this lets the thread go on by itself.
#[derive(Debug)]
pub struct PlaybackThread {
    thread: JoinHandle<Result<(), HandoverError>>,
    latest: Arc<ArrayQueue<PlaybackStats>>,
    stats: PlaybackStats,
}

/// Starts a thread that reads `source`, groups its frames and publishes the sets, until the source ends.
///
/// An error ends the stream and reaches the reader, as [`HandoverError::Source`] when it comes from the source, after
/// all sets published before it. So does a panic.
///
/// ```
/// use std::path::Path;
/// use std::time::Duration;
/// use mirrorball_capture::{
///     BadFramePolicy, DEFAULT_MAX_SKEW, Grouper, Pace, Player, Received, Repeat, Source, handover, play_in_thread,
/// };
///
/// # fn main() -> Result<(), mirrorball_capture::HandoverError> {
/// # let folder = Path::new("no such recording");
/// # if folder.exists() {
/// let player = Player::open(folder, Pace::Max, Repeat::ONCE)?;
/// let grouper = Grouper::for_cameras(player.cameras(), DEFAULT_MAX_SKEW);
/// let (publisher, mut subscriber) = handover::lossless(2);
/// let thread = play_in_thread(Box::new(player), grouper, publisher, BadFramePolicy::Fail)?;
/// while let Received::Set(set) = subscriber.receive(Duration::MAX)? {
///     println!("{} frames", set.frames.len());
/// }
/// println!("{:?}", thread.join()?);
/// # }
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`HandoverError::StartThread`] if the system has no room for another thread.
pub fn play_in_thread(
    source: Box<dyn Source>,
    grouper: Grouper,
    publisher: Publisher,
    policy: BadFramePolicy,
) -> Result<PlaybackThread, HandoverError> {
    let latest = Arc::new(ArrayQueue::new(1));
    let newest = latest.clone();
    let mut playback = Playback::new(source, grouper, publisher, policy);
    let run = move || loop {
        let progress = playback.step(STEP_TIMEOUT);
        newest.force_push(playback.stats());
        match progress {
            Ok(Progress::Continues) => {}
            Ok(Progress::Ended) => return Ok(()),
            Err(error) => return playback.publisher.fail(error),
        }
    };
    let thread = std::thread::Builder::new()
        .name("playback".to_owned())
        .spawn(run)
        .map_err(HandoverError::StartThread)?;
    Ok(PlaybackThread {
        thread,
        latest,
        stats: PlaybackStats::default(),
    })
}

impl PlaybackThread {
    /// What the thread has done so far.
    pub fn stats(&mut self) -> PlaybackStats {
        if let Some(stats) = self.latest.pop() {
            self.stats = stats;
        }
        self.stats
    }

    /// Waits for the end of the thread and returns what it has done.
    ///
    /// With the lossless transport the thread may wait for the reader: receive to the end, or drop the subscriber
    /// first.
    ///
    /// # Errors
    ///
    /// The error that has ended the stream, if no reader was told of it.
    pub fn join(self) -> Result<PlaybackStats, HandoverError> {
        let Self { thread, latest, stats } = self;
        match thread.join() {
            Ok(result) => result.map(|()| latest.pop().unwrap_or(stats)),
            Err(_) => Err(HandoverError::PublisherPanicked),
        }
    }
}
