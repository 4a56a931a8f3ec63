//! Puts frames that belong together into frame sets, by time stamps alone: no clock, no threads.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use crate::frame::{Frame, FrameSet};
use crate::source::{CameraDescription, CameraRole};

/// Frames of the leading camera that may wait for the others; one more, and the oldest goes without them.
pub const WAITING_MAX: usize = 8;

/// Frames of every other camera kept for leading frames that are yet to come.
const HISTORY_MAX: usize = 8;

/// Skew allowed where nothing else is asked for: more than half a period of free-running cameras at 15 frames/s.
pub const DEFAULT_MAX_SKEW: Duration = Duration::from_millis(50);

/// What became of the frames a [`Grouper`] was given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GroupingCounters {
    /// Frame sets made.
    pub sets: u64,
    /// Of these, sets that lack at least one camera.
    pub incomplete_sets: u64,
    /// Of these, sets that stopped waiting because too many leading frames were waiting.
    pub hurried_sets: u64,
    /// Frames of the other cameras that are in no set, those still kept for the next set included.
    pub unpaired_frames: u64,
    /// Frames dropped because they are not later than the one before of the same camera.
    pub out_of_order_frames: u64,
    /// Frames dropped because no camera of that name was announced.
    pub unknown_camera_frames: u64,
}

/// Makes one [`FrameSet`] of each frame of the leading camera.
///
/// To every leading frame it adds, of every other camera, the frame nearest in time; of two equally near the earlier.
/// That frame may be the later one, so a set waits until each camera has sent a frame that is not earlier than the
/// leading one, or the stream ends, or more than [`WAITING_MAX`] leading frames wait. If no frame is within the allowed
/// skew the set lacks that camera. One frame may be in several sets when its camera is the slower one.
///
/// The result depends on time stamps and on the order of the frames, never on when they come. Memory is bounded: at
/// most [`WAITING_MAX`] sets and a few frames of every camera.
#[derive(Debug)]
pub struct Grouper {
    leader: Arc<str>,
    max_skew_ns: u64,
    last_leader_ns: Option<u64>,
    tracks: Vec<Track>,
    waiting: VecDeque<Waiting>,
    counters: GroupingCounters,
}

/// What is known of one of the other cameras.
#[derive(Debug)]
struct Track {
    camera: Arc<str>,
    /// Nobody waits for a camera that is gone.
    is_gone: bool,
    last_ns: Option<u64>,
    history: VecDeque<Frame>,
    last_used_ns: Option<u64>,
}

/// A leading frame, and one choice for each track.
#[derive(Debug)]
struct Waiting {
    leader: Frame,
    choices: Vec<Choice>,
}

#[derive(Debug)]
struct Choice {
    nearest: Option<Frame>,
    is_final: bool,
}

impl Choice {
    /// Takes note of the next later frame of the camera.
    fn consider(&mut self, leader_ns: u64, frame: &Frame) {
        if self.is_final {
            return;
        }
        let frame_ns = frame.meta.timestamp_ns;
        let skew_ns = |frame: &Frame| frame.meta.timestamp_ns.abs_diff(leader_ns);
        if self
            .nearest
            .as_ref()
            .is_none_or(|nearest| skew_ns(frame) < skew_ns(nearest))
        {
            self.nearest = Some(frame.clone());
        }
        self.is_final = frame_ns >= leader_ns;
    }
}

impl Grouper {
    /// Makes a grouper for a leading camera and the others, allowing up to `max_skew` between a leading frame and the
    /// frames put beside it.
    #[must_use]
    pub fn new(leader: Arc<str>, others: &[Arc<str>], max_skew: Duration) -> Self {
        let track = |camera: &Arc<str>| Track {
            camera: camera.clone(),
            is_gone: false,
            last_ns: None,
            history: VecDeque::with_capacity(HISTORY_MAX),
            last_used_ns: None,
        };
        Self {
            max_skew_ns: u64::try_from(max_skew.as_nanos()).unwrap_or(u64::MAX),
            last_leader_ns: None,
            tracks: others.iter().filter(|&other| *other != leader).map(track).collect(),
            waiting: VecDeque::with_capacity(WAITING_MAX + 1),
            counters: GroupingCounters::default(),
            leader,
        }
    }

    /// Makes a grouper for the cameras of a source: the one with the role `scene` leads, else the first one.
    #[must_use]
    pub fn for_cameras(cameras: &[CameraDescription], max_skew: Duration) -> Self {
        let names: Vec<Arc<str>> = cameras.iter().map(|camera| camera.name.clone()).collect();
        let leader_index = cameras
            .iter()
            .position(|camera| camera.role == CameraRole::Scene)
            .unwrap_or(0);
        Self::new(names.get(leader_index).cloned().unwrap_or_default(), &names, max_skew)
    }

    /// Takes a frame and returns the sets it completes, in order of time.
    pub fn push(&mut self, frame: Frame) -> Vec<FrameSet> {
        if frame.meta.camera == self.leader {
            self.push_leader(frame);
        } else {
            self.push_other(frame);
        }
        let mut sets = self.take_complete();
        if self.waiting.len() > WAITING_MAX {
            self.counters.hurried_sets += 1;
            sets.extend(self.take_first());
            sets.extend(self.take_complete());
        }
        sets
    }

    /// Takes note that a camera is gone and returns the sets that waited for it. It is waited for again from its next
    /// frame on.
    pub fn lose(&mut self, camera: &str) -> Vec<FrameSet> {
        if let Some(index) = self.tracks.iter().position(|track| &*track.camera == camera) {
            self.tracks[index].is_gone = true;
            for waiting in &mut self.waiting {
                waiting.choices[index].is_final = true;
            }
        }
        self.take_complete()
    }

    /// Ends the stream: returns the sets of all leading frames that still wait, with what there is.
    pub fn finish(&mut self) -> Vec<FrameSet> {
        std::iter::from_fn(|| self.take_first()).collect()
    }

    /// What became of the frames so far.
    #[must_use]
    pub fn counters(&self) -> GroupingCounters {
        self.counters
    }

    fn push_leader(&mut self, leader: Frame) {
        let leader_ns = leader.meta.timestamp_ns;
        if self.last_leader_ns.is_some_and(|last_ns| leader_ns <= last_ns) {
            self.counters.out_of_order_frames += 1;
            return;
        }
        self.last_leader_ns = Some(leader_ns);
        let mut choices = Vec::with_capacity(self.tracks.len());
        for track in &mut self.tracks {
            let mut choice = Choice {
                nearest: None,
                is_final: false,
            };
            if track.is_gone {
                choice.is_final = true;
                choices.push(choice);
                continue;
            }
            for frame in &track.history {
                choice.consider(leader_ns, frame);
            }
            choices.push(choice);
            // Later leading frames need the last frame before this one, and what comes after it.
            while track
                .history
                .get(1)
                .is_some_and(|second| second.meta.timestamp_ns <= leader_ns)
            {
                track.history.pop_front();
            }
        }
        self.waiting.push_back(Waiting { leader, choices });
    }

    fn push_other(&mut self, frame: Frame) {
        let Some(index) = self.tracks.iter().position(|track| track.camera == frame.meta.camera) else {
            self.counters.unknown_camera_frames += 1;
            return;
        };
        let track = &mut self.tracks[index];
        let frame_ns = frame.meta.timestamp_ns;
        if track.last_ns.is_some_and(|last_ns| frame_ns <= last_ns) {
            self.counters.out_of_order_frames += 1;
            return;
        }
        track.last_ns = Some(frame_ns);
        track.is_gone = false;
        self.counters.unpaired_frames += 1;
        for waiting in &mut self.waiting {
            waiting.choices[index].consider(waiting.leader.meta.timestamp_ns, &frame);
        }
        if track.history.len() == HISTORY_MAX {
            track.history.pop_front();
        }
        track.history.push_back(frame);
    }

    fn take_complete(&mut self) -> Vec<FrameSet> {
        let mut sets = Vec::new();
        while self
            .waiting
            .front()
            .is_some_and(|first| first.choices.iter().all(|choice| choice.is_final))
        {
            sets.extend(self.take_first());
        }
        sets
    }

    fn take_first(&mut self) -> Option<FrameSet> {
        let Waiting { leader, choices } = self.waiting.pop_front()?;
        let leader_ns = leader.meta.timestamp_ns;
        let mut frames = Vec::with_capacity(1 + choices.len());
        frames.push(leader);
        for (track, choice) in self.tracks.iter_mut().zip(choices) {
            let near = choice
                .nearest
                .filter(|f| f.meta.timestamp_ns.abs_diff(leader_ns) <= self.max_skew_ns);
            let Some(frame) = near else { continue };
            // Choices move on in time with the leading frames, so a frame's second use follows its first one.
            if track.last_used_ns.replace(frame.meta.timestamp_ns) != Some(frame.meta.timestamp_ns) {
                self.counters.unpaired_frames -= 1;
            }
            frames.push(frame);
        }
        self.counters.sets += 1;
        self.counters.incomplete_sets += u64::from(frames.len() <= self.tracks.len());
        Some(FrameSet { frames })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::frame::{Exposure, FrameMeta, PixelFormat, Size};

    fn frame(camera: &str, timestamp_ns: u64) -> Frame {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let meta = FrameMeta::new(camera.into(), timestamp_ns, timestamp_ns, exposure);
        let size = Size { width: 1, height: 1 };
        Frame {
            meta,
            size,
            format: PixelFormat::Rgb8,
            pixels: vec![0; 3].into(),
        }
    }

    fn grouper(others: &[&str], max_skew_ns: u64) -> Grouper {
        let others: Vec<Arc<str>> = others.iter().map(|&name| name.into()).collect();
        Grouper::new("lead".into(), &others, Duration::from_nanos(max_skew_ns))
    }

    /// Time stamp of the leading frame, and that of each other camera's frame.
    fn stamps(sets: &[FrameSet], others: &[&str]) -> Vec<(u64, Vec<Option<u64>>)> {
        let stamp = |frame: &Frame| frame.meta.timestamp_ns;
        let of = |set: &FrameSet| others.iter().map(|name| set.camera(name).map(stamp)).collect();
        sets.iter().map(|set| (stamp(&set.frames[0]), of(set))).collect()
    }

    fn run(grouper: &mut Grouper, stream: &[(&str, u64)]) -> Vec<FrameSet> {
        let mut sets = Vec::new();
        for &(camera, timestamp_ns) in stream {
            sets.extend(grouper.push(frame(camera, timestamp_ns)));
        }
        sets.extend(grouper.finish());
        sets
    }

    #[test]
    fn one_camera_makes_a_set_of_every_frame_at_once() {
        let mut grouper = grouper(&[], 5);
        for timestamp_ns in [1, 2, 3] {
            assert_eq!(grouper.push(frame("lead", timestamp_ns)).len(), 1);
        }
        assert!(grouper.finish().is_empty());
    }

    #[test]
    fn a_set_waits_for_the_later_frame_if_it_may_be_nearer() {
        let mut grouper = grouper(&["ball"], 50);
        assert!(grouper.push(frame("ball", 90)).is_empty());
        assert!(grouper.push(frame("lead", 100)).is_empty());
        let sets = grouper.push(frame("ball", 104));
        assert_eq!(stamps(&sets, &["ball"]), [(100, vec![Some(104)])]);
    }

    #[test]
    fn of_two_equally_near_frames_the_earlier_is_taken() {
        let sets = run(
            &mut grouper(&["ball"], 50),
            &[("ball", 90), ("lead", 100), ("ball", 110)],
        );
        assert_eq!(stamps(&sets, &["ball"]), [(100, vec![Some(90)])]);
    }

    #[test]
    fn the_allowed_skew_includes_its_end() {
        for (max_skew_ns, expected) in [(10, Some(110)), (9, None)] {
            let mut grouper = grouper(&["ball"], max_skew_ns);
            let sets = run(&mut grouper, &[("lead", 100), ("ball", 110)]);
            assert_eq!(stamps(&sets, &["ball"]), [(100, vec![expected])]);
            assert_eq!(grouper.counters().incomplete_sets, u64::from(expected.is_none()));
        }
    }

    #[test]
    fn a_dead_camera_holds_up_only_so_many_frames() {
        let mut grouper = grouper(&["ball"], 50);
        let mut n_sets = 0;
        for index in 0..100 {
            n_sets += grouper.push(frame("lead", index)).len();
            assert!(grouper.waiting.len() <= WAITING_MAX);
        }
        assert_eq!(n_sets, 100 - WAITING_MAX);
        assert_eq!(grouper.finish().len(), WAITING_MAX);
        assert_eq!(grouper.counters().hurried_sets, 100 - WAITING_MAX as u64);
    }

    #[test]
    fn what_is_dropped_is_counted() {
        let mut grouper = grouper(&["ball"], 1);
        let stream = [
            ("ball", 5),
            ("ball", 5),
            ("moon", 6),
            ("lead", 9),
            ("lead", 8),
            ("ball", 9),
            ("ball", 30),
        ];
        assert_eq!(run(&mut grouper, &stream).len(), 1);
        let expected = GroupingCounters {
            sets: 1,
            incomplete_sets: 0,
            hurried_sets: 0,
            unpaired_frames: 2,
            out_of_order_frames: 2,
            unknown_camera_frames: 1,
        };
        assert_eq!(grouper.counters(), expected);
    }

    /// Rising time stamps with steps of the given range.
    fn rising(steps: std::ops::Range<u64>) -> impl Strategy<Value = Vec<u64>> {
        let sum = |steps: Vec<u64>| {
            steps
                .iter()
                .scan(0, |sum, step| {
                    Some({
                        *sum += step;
                        *sum
                    })
                })
                .collect()
        };
        proptest::collection::vec(steps, 0..40).prop_map(sum)
    }

    /// A stream in which every camera's frames come some time after they were taken.
    fn stream<'a>(cameras: &[(&'a str, &[u64], u64)]) -> Vec<(&'a str, u64)> {
        let arrivals = |&(name, stamps, delay): &(&'a str, &[u64], u64)| {
            stamps
                .iter()
                .map(move |&stamp| (stamp + delay, (name, stamp)))
                .collect::<Vec<_>>()
        };
        let mut stream: Vec<_> = cameras.iter().flat_map(arrivals).collect();
        stream.sort_by_key(|&(arrival, _)| arrival);
        stream.into_iter().map(|(_, frame)| frame).collect()
    }

    fn nearest(stamps: &[u64], leader_ns: u64, max_skew_ns: u64) -> Option<u64> {
        let nearest = stamps
            .iter()
            .copied()
            .min_by_key(|stamp| (stamp.abs_diff(leader_ns), *stamp));
        nearest.filter(|stamp| stamp.abs_diff(leader_ns) <= max_skew_ns)
    }

    #[test]
    fn a_camera_that_is_gone_is_not_waited_for() {
        let mut grouper = grouper(&["other"], 10);
        assert!(grouper.push(frame("lead", 100)).is_empty());
        assert_eq!(grouper.lose("other").len(), 1);
        assert_eq!(grouper.push(frame("lead", 200)).len(), 1);
        assert!(grouper.push(frame("other", 290)).is_empty());
        assert!(grouper.push(frame("lead", 300)).is_empty());
        let sets = grouper.push(frame("other", 305));
        assert_eq!((sets.len(), sets[0].frames.len()), (1, 2));
    }

    proptest! {
        // With these intervals and delays nobody waits for more than 6 leading frames, unless a camera has ended, and
        // no camera is more than 6 frames ahead of the leading one.
        #[test]
        fn the_nearest_is_found_whatever_the_delays(
            lead in rising(20..40), ball in rising(10..30), eye in rising(10..60),
            delays in proptest::array::uniform3(0u64..60), max_skew_ns in 0u64..40,
        ) {
            let others = ["ball", "eye"];
            let mut grouper = grouper(&others, max_skew_ns);
            let cameras = [("lead", &lead[..], delays[0]), ("ball", &ball, delays[1]), ("eye", &eye, delays[2])];
            let sets = run(&mut grouper, &stream(&cameras));
            let expected: Vec<_> = lead.iter().map(|&stamp| {
                (stamp, vec![nearest(&ball, stamp, max_skew_ns), nearest(&eye, stamp, max_skew_ns)])
            }).collect();
            prop_assert_eq!(stamps(&sets, &others), expected);
        }

        #[test]
        fn any_stream_keeps_the_promises(
            frames in proptest::collection::vec((0usize..4, 0u64..200), 0..200), max_skew_ns in 0u64..60,
        ) {
            let names = ["lead", "ball", "eye", "moon"];
            let stream: Vec<_> = frames.iter().map(|&(camera, stamp)| (names[camera], stamp)).collect();
            let mut grouper = grouper(&names[1..3], max_skew_ns);
            let sets = run(&mut grouper, &stream);
            let mut used = std::collections::BTreeSet::new();
            for set in &sets {
                prop_assert_eq!(&*set.frames[0].meta.camera, "lead");
                for other in &set.frames[1..] {
                    let skew_ns = other.meta.timestamp_ns.abs_diff(set.frames[0].meta.timestamp_ns);
                    prop_assert!(skew_ns <= max_skew_ns);
                    used.insert((other.meta.camera.clone(), other.meta.timestamp_ns));
                }
            }
            prop_assert!(sets.is_sorted_by_key(|set| set.frames[0].meta.timestamp_ns));
            let counters = grouper.counters();
            prop_assert_eq!(counters.sets, sets.len() as u64);
            let n_frames = counters.sets + used.len() as u64
                + counters.unpaired_frames + counters.out_of_order_frames + counters.unknown_camera_frames;
            prop_assert_eq!(n_frames, stream.len() as u64);
        }
    }
}
