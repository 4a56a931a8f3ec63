//! What is known of one camera: its frames, what it was asked for, what it accepted, how late it shows it.

use std::collections::VecDeque;

use super::in_force::InForce;
use super::latency::{LATENCY_MAX_FRAMES, LatencyEstimator, LatencySource};
use super::settings::LockstepCamera;
use super::translate::{ExposurePolicy, Translator};
use super::{Request, RequestId};
use crate::controls::{ControlKind, ControlValues};
use crate::meter::{BLACK_LOG2, Statistics};

/// Frames remembered: statistics may come so many frames late.
const FRAMES_MAX: usize = 64;

/// Requests that may wait for their answer; with more, nothing is asked for.
const OUTSTANDING_MAX: usize = 16;

/// Frames after which a request without an answer counts as refused.
const ANSWER_FRAMES: i64 = 30;

/// Frames to wait after a refusal before asking again, doubled each time.
const RETRY_FRAMES: (i64, i64) = (4, 64);

/// Size of the steps that measure the latency.
const PROBE_EV: f64 = 0.5;

/// Frames between those steps: uneven, so that no lamp keeps time with them, and further apart than any latency, so
/// that there are frames of known exposure between.
const PROBE_GAPS: [i64; 8] = [13, 11, 16, 12, 19, 14, 11, 17];

/// Steps after which measuring is given up.
const PROBES_MAX: usize = 32;

/// A frame that came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameRecord {
    pub(super) sequence: u64,
    pub(super) tick: i64,
    pub(super) timestamp_ns: u64,
}

/// A request without an answer yet.
#[derive(Debug, Clone, Copy)]
struct Outstanding {
    id: RequestId,
    /// Frame after which it was made.
    tick: i64,
    values: ControlValues,
}

/// Half-step changes of exposure that measure the latency.
#[derive(Debug, Clone, Copy)]
struct Probe {
    next_tick: i64,
    n_done: usize,
    offset_ev: f64,
}

/// One camera.
#[derive(Debug, Clone)]
pub(super) struct Track {
    pub(super) translator: Translator,
    pub(super) estimator: LatencyEstimator,
    pub(super) history: InForce,
    pub(super) is_online: bool,
    /// True from when an automatic mode of the camera was found until values were accepted again.
    pub(super) is_automatic: bool,
    interval_ns: f64,
    nominal_ns: f64,
    frames: VecDeque<FrameRecord>,
    /// Frame after which it was last seen to what the camera should be asked for.
    handled_tick: i64,
    /// What the controls will be once all answers have come.
    asked: ControlValues,
    outstanding: VecDeque<Outstanding>,
    retry_tick: i64,
    retry_frames: i64,
    probe: Option<Probe>,
}

impl Track {
    pub(super) fn new(camera: LockstepCamera, policy: ExposurePolicy, measures_latency: bool) -> Self {
        let interval_s = camera.interval_ns as f64 * 1e-9;
        let policy = ExposurePolicy {
            max_time_s: policy.max_time_s.min(interval_s),
            ..policy
        };
        let translator = Translator::new(camera.tables, &camera.ranges, policy, interval_s);
        let has_time = translator.drives(ControlKind::ExposureTime) || translator.drives(ControlKind::Gain);
        let probes = measures_latency && camera.latency_frames.is_none() && has_time;
        Self {
            history: InForce::new(camera.values, translator.signal_log2(&camera.values)),
            translator,
            estimator: LatencyEstimator::new(camera.latency_frames),
            is_online: true,
            is_automatic: false,
            interval_ns: camera.interval_ns as f64,
            nominal_ns: camera.interval_ns as f64,
            frames: VecDeque::with_capacity(FRAMES_MAX + 1),
            handled_tick: -1,
            asked: camera.values,
            outstanding: VecDeque::with_capacity(OUTSTANDING_MAX),
            retry_tick: 0,
            retry_frames: RETRY_FRAMES.0,
            probe: probes.then_some(Probe {
                next_tick: 0,
                n_done: 0,
                offset_ev: 0.0,
            }),
        }
    }

    /// Takes note of a frame.
    pub(super) fn on_frame(&mut self, sequence: u64, timestamp_ns: u64) -> FrameRecord {
        let tick = match self.frames.back() {
            None => self.handled_tick + 1,
            Some(last) => {
                let counted = sequence.saturating_sub(last.sequence).clamp(1, 1 << 32) as i64;
                let elapsed_ns = timestamp_ns.saturating_sub(last.timestamp_ns) as f64;
                // A stamp may be late by half an interval and more; only beyond that was a frame lost in the sensor.
                let timed = (elapsed_ns / self.interval_ns - 0.25).round().min(1e9) as i64;
                let n_ticks = counted.max(timed);
                if n_ticks <= 4 {
                    let measured_ns = elapsed_ns / n_ticks as f64;
                    let measured_ns = measured_ns.clamp(0.5 * self.nominal_ns, 2.0 * self.nominal_ns);
                    self.interval_ns += 0.05 * (measured_ns - self.interval_ns);
                }
                last.tick + n_ticks
            }
        };
        let record = FrameRecord {
            sequence,
            tick,
            timestamp_ns,
        };
        if self.frames.len() == FRAMES_MAX {
            self.frames.pop_front();
        }
        self.frames.push_back(record);
        while self
            .outstanding
            .front()
            .is_some_and(|request| request.tick + ANSWER_FRAMES < tick)
        {
            self.outstanding.pop_front();
            self.give_up();
        }
        record
    }

    /// The frame with this sequence number, if it came lately.
    pub(super) fn frame(&self, sequence: u64) -> Option<FrameRecord> {
        self.frames
            .iter()
            .rev()
            .find(|frame| frame.sequence == sequence)
            .copied()
    }

    pub(super) fn last_frame(&self) -> Option<FrameRecord> {
        self.frames.back().copied()
    }

    pub(super) fn interval_ns(&self) -> f64 {
        self.interval_ns
    }

    /// First frame that can show what is asked for after the last frame.
    pub(super) fn shown_tick(&self, tick: i64) -> i64 {
        tick + 1 + i64::from(self.estimator.latency().frames)
    }

    /// Values in force in a frame.
    pub(super) fn values(&self, tick: i64) -> &ControlValues {
        self.history.values(tick, self.estimator.latency().frames)
    }

    /// True if nothing makes the values in force in a frame doubtful.
    pub(super) fn is_certain(&self, tick: i64) -> bool {
        let latency = self.estimator.latency();
        let may_show = |request: &Outstanding| self.shown_tick(request.tick) <= tick;
        let is_guess =
            latency.source == LatencySource::Assumed && self.history.changed_within(tick, LATENCY_MAX_FRAMES);
        !self.is_automatic && !is_guess && !self.outstanding.iter().any(may_show)
    }

    /// When, in nanoseconds, the first frame is taken that can have values decided on now; none without frames.
    pub(super) fn earliest_effect_ns(&self) -> Option<f64> {
        let last = self.last_frame().filter(|_| self.is_online)?;
        let asks_now = self.handled_tick < last.tick;
        let tick = self.shown_tick(if asks_now { last.tick } else { last.tick + 1 });
        Some(self.taken_ns(last, tick))
    }

    /// When a frame yet to come will be taken.
    pub(super) fn taken_ns(&self, last: FrameRecord, tick: i64) -> f64 {
        last.timestamp_ns as f64 + (tick - last.tick) as f64 * self.interval_ns
    }

    /// The request that takes the controls to `wanted`, if they are not on their way there.
    pub(super) fn request(&mut self, tick: i64, wanted: &ControlValues, id: RequestId) -> Option<Request> {
        self.handled_tick = tick;
        if tick < self.retry_tick || self.outstanding.len() == OUTSTANDING_MAX {
            return None;
        }
        let mut values = ControlValues::default();
        for (kind, value) in wanted.iter() {
            if self.is_automatic || self.asked.get(kind) != Some(value) {
                values.set(kind, value);
            }
        }
        values.iter().next()?;
        let asserts_manual = self.is_automatic;
        if asserts_manual && !self.outstanding.is_empty() {
            return None;
        }
        merge(&mut self.asked, &values);
        self.outstanding.push_back(Outstanding { id, tick, values });
        Some(Request {
            id,
            values,
            asserts_manual,
        })
    }

    /// The driver has these values now.
    pub(super) fn on_applied(&mut self, id: RequestId, read_back: &ControlValues, first_sequence_after: u64) {
        let answered = self.outstanding.iter().find(|request| request.id == id).copied();
        self.outstanding.retain(|request| request.id != id);
        let before = *self.history.accepted();
        let mut values = before;
        merge(&mut values, read_back);
        let tick = self.tick_of(first_sequence_after);
        self.history.accept(tick, values, self.translator.signal_log2(&values));
        let Some(request) = answered else {
            // Somebody else changed them; what is wanted is asked for again.
            merge(&mut self.asked, read_back);
            return;
        };
        self.is_automatic = false;
        // A value that the driver made another one of stays as it is. One that did not move at all was refused.
        let did_not_move = |(kind, value): (ControlKind, i64)| {
            let found = read_back.get(kind);
            found.is_some() && found != Some(value) && found == before.get(kind)
        };
        if request.values.iter().any(did_not_move) {
            self.give_up();
        } else {
            self.retry_frames = RETRY_FRAMES.0;
        }
    }

    /// The driver did not take a request.
    pub(super) fn on_refused(&mut self, id: RequestId) {
        let n_before = self.outstanding.len();
        self.outstanding.retain(|request| request.id != id);
        if self.outstanding.len() < n_before {
            self.give_up();
        }
    }

    pub(super) fn on_lost(&mut self) {
        self.is_online = false;
        self.outstanding.clear();
    }

    /// Starts again with values read from the driver.
    pub(super) fn on_returned(&mut self, values: ControlValues) {
        self.is_online = true;
        self.is_automatic = false;
        self.history = InForce::new(values, self.translator.signal_log2(&values));
        self.asked = values;
        self.outstanding.clear();
        self.handled_tick = self.last_frame().map_or(self.handled_tick, |last| last.tick);
        self.retry_tick = 0;
        self.retry_frames = RETRY_FRAMES.0;
        self.frames.clear();
        self.interval_ns = self.nominal_ns;
        self.estimator.doubt();
    }

    /// Takes a picture's brightness to measure the latency with.
    pub(super) fn on_statistics(&mut self, frame: FrameRecord, statistics: &Statistics) {
        // Both quartiles must move with the exposure: neither near clipping nor among the darkest codes.
        let [_, _, low, _, high, _, _] = statistics.percentiles_log2;
        let is_telling = high < -0.35 && low > BLACK_LOG2 + 3.0 && !self.is_automatic;
        let signal_log2 = is_telling.then_some(statistics.mid_log2);
        self.estimator.observe(&self.history, frame.tick, signal_log2);
        if is_telling {
            self.move_probe(frame.tick);
        }
    }

    /// Steps by which the exposure is off to measure the latency.
    pub(super) fn probe_offset_ev(&self) -> f64 {
        self.probe.map_or(0.0, |probe| probe.offset_ev)
    }

    /// True while the latency is being measured.
    pub(super) fn is_probing(&self) -> bool {
        self.probe.is_some()
    }

    fn move_probe(&mut self, tick: i64) {
        let Some(probe) = &mut self.probe else { return };
        let is_known = self.estimator.latency().source != LatencySource::Assumed;
        if is_known || probe.n_done >= PROBES_MAX {
            self.probe = None;
        } else if tick >= probe.next_tick {
            // Down and back, up and back: where the controls end one way, the other way still tells.
            probe.offset_ev = match probe.n_done % 4 {
                1 => -PROBE_EV,
                3 => PROBE_EV,
                _ => 0.0,
            };
            probe.next_tick = tick + PROBE_GAPS[probe.n_done % PROBE_GAPS.len()];
            probe.n_done += 1;
        }
    }

    /// After a refusal: what will be is what was accepted and what is still asked for; the rest has to wait.
    fn give_up(&mut self) {
        self.asked = *self.history.accepted();
        for request in &self.outstanding {
            merge(&mut self.asked, &request.values);
        }
        let tick = self.last_frame().map_or(0, |last| last.tick);
        self.retry_tick = tick + self.retry_frames;
        self.retry_frames = (2 * self.retry_frames).min(RETRY_FRAMES.1);
    }

    /// The tick of a frame, from its sequence number, whether it came or is yet to come.
    fn tick_of(&self, sequence: u64) -> i64 {
        let later = self.frames.iter().find(|frame| frame.sequence >= sequence);
        match (later, self.frames.back()) {
            (Some(frame), _) => frame.tick,
            (None, Some(last)) => last.tick + (sequence - last.sequence).min(1 << 32) as i64,
            (None, None) => self.handled_tick + 1,
        }
    }
}

fn merge(values: &mut ControlValues, newer: &ControlValues) {
    for (kind, value) in newer.iter() {
        values.set(kind, value);
    }
}
