//! Keeps the exposure and white balance of all cameras in step: a state machine without threads, clocks and I/O.
//!
//! ```text
//! leader's Statistics --> auto_exposure, auto_white_balance --> Target, from a moment on (timeline)
//!                                                                  |
//!   for each camera, after each of its frames: which of its frames would a request made now come into force in?
//!   which target holds when that frame is taken? --> translate --> Request, if it differs from what was asked before
//!                                                                  |
//!   driver's answer --> in_force --> exposure in force of each frame, and its residual to the target of its moment
//! ```
//!
//! **The same frame.** A new target holds from the first moment on at which every camera can have it. A camera with two
//! frames of latency is asked two frames later than one with four, so both show it in frames nearest in time.
//!
//! **The truth.** What a frame carries is what the driver accepted, as read back, so many frames earlier as the camera's
//! [`latency`] is measured to be. The residual, target over what is in force, makes up for the steps of the
//! controls, for what they cannot reach, for a request that was late or refused, and for a bracket's offset alike.
//!
//! **How to drive it**, for each frame of each camera: [`Lockstep::on_frame`]; then, if its statistics were measured
//! (now or later), [`Lockstep::on_statistics`]; then at once [`Lockstep::request`]. Send what that gives to the driver
//! before the camera's next frame, read the values back, and say [`Lockstep::on_applied`] or [`Lockstep::on_refused`].
//! Cameras are indices from 0; calls with an index that no camera has do nothing.
//!
//! **What is not in here**: different latencies of one camera's controls. They are taken as one, measured by exposure
//! time and gain.

pub mod auto_exposure;
mod auto_white_balance;
pub mod in_force;
pub mod latency;
mod settings;
pub mod tables;
mod target;
#[cfg(test)]
mod tests;
mod track;
mod translate;

use crate::controls::ControlValues;
use crate::frame::Exposure;
use crate::meter::Statistics;
use auto_exposure::{AutoExposure, Observation};
use auto_white_balance::AutoWhiteBalance;
use latency::{Latency, LatencySource};
pub use settings::{
    BRACKET_STEPS_MAX, LockstepCamera, LockstepError, LockstepSettings, Mains, ManualWhiteBalance, Mode, OFFSET_MAX_EV,
};
pub use target::Target;
use target::Timeline;
use track::{FrameRecord, Track};
use translate::ExposurePolicy;

/// Light taken for granted before anything is known, in kelvin.
const DAYLIGHT_K: f64 = 5000.0;

/// Number of a request, unique over all cameras, rising.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RequestId(pub u64);

/// Controls to set on one camera, together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// To be given back with the answer.
    pub id: RequestId,
    /// Values within range and on the steps of the controls; controls not named keep theirs.
    pub values: ControlValues,
    /// True if automatic modes of the camera must be switched off first.
    pub asserts_manual: bool,
}

/// How a frame was exposed, as far as is known when it comes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameExposure {
    /// Exposure and white balance in force.
    pub exposure: Exposure,
    /// Linear factors for red, green and blue that take the frame to the target that all cameras have at its moment,
    /// sensitivity and bracket included; above 0.
    pub residual: [f64; 3],
    /// Which exposure of a bracket it is nearest to, from dark to bright, counted from 0; 0 without a bracket.
    pub bracket_step: u32,
    /// False if a request without an answer, a latency not yet measured or an automatic mode makes this doubtful.
    pub is_certain: bool,
    /// True if the exposure time is no multiple of the period of the lamps' flicker.
    pub flickers: bool,
}

/// What there is to tell about a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraState {
    /// True between its return and its loss.
    pub is_online: bool,
    /// How many frames late it shows changes.
    pub latency: Latency,
    /// True while that is being measured.
    pub is_probing: bool,
    /// Control values that the driver accepted last.
    pub accepted: ControlValues,
    /// Time, gain and white balance that they mean.
    pub exposure: Exposure,
}

/// Keeps 1 to 16 cameras in step.
#[derive(Debug, Clone)]
pub struct Lockstep {
    leader: usize,
    mode: Mode,
    tracks: Vec<Track>,
    timeline: Timeline,
    auto_exposure: AutoExposure,
    auto_white_balance: AutoWhiteBalance,
    /// Time stamp of the leader's last frame that was looked at.
    looked_ns: Option<u64>,
    next_id: u64,
}

impl Lockstep {
    /// Starts with cameras whose controls were read; what the leader has at first is the first target.
    ///
    /// # Errors
    /// When there is no camera or more than 16, or a setting or a control's range cannot be used.
    pub fn new(settings: LockstepSettings, cameras: Vec<LockstepCamera>) -> Result<Self, LockstepError> {
        settings::check_settings(&settings, &cameras)?;
        let policy = ExposurePolicy {
            max_time_s: settings.max_exposure_s,
            flicker_period_s: settings.mains.flicker_period_s(),
        };
        let track = |camera| Track::new(camera, policy, settings.measure_latency);
        let tracks: Vec<Track> = cameras.into_iter().map(track).collect();
        let leader = &tracks[settings.leader];
        let target = leader.translator.target(leader.history.accepted(), DAYLIGHT_K);
        let light_k = leader.translator.light_k(target.white_balance);
        let target = leader.translator.target(leader.history.accepted(), light_k);
        let mut lockstep = Self {
            leader: settings.leader,
            mode: Mode::Locked,
            timeline: Timeline::new(target),
            auto_exposure: AutoExposure::new(settings.auto_exposure, target.exposure_s.log2()),
            auto_white_balance: AutoWhiteBalance::new(target.white_balance),
            looked_ns: None,
            next_id: 0,
            tracks,
        };
        lockstep.enter(settings.mode);
        Ok(lockstep)
    }

    /// Changes what decides, from the next frames on.
    ///
    /// # Errors
    /// When the mode names a camera that is not there or a number out of range; nothing changes then.
    pub fn set_mode(&mut self, mode: Mode) -> Result<(), LockstepError> {
        settings::check_mode(&mode, self.tracks.len())?;
        self.enter(mode);
        Ok(())
    }

    /// What decides.
    #[must_use]
    pub fn mode(&self) -> &Mode {
        &self.mode
    }

    /// The target decided on last; it may hold for frames yet to come only.
    #[must_use]
    pub fn target(&self) -> &Target {
        self.timeline.last()
    }

    /// What there is to tell about a camera.
    #[must_use]
    pub fn camera(&self, camera: usize) -> Option<CameraState> {
        let track = self.tracks.get(camera)?;
        Some(CameraState {
            is_online: track.is_online,
            latency: track.estimator.latency(),
            is_probing: track.is_probing(),
            accepted: *track.history.accepted(),
            exposure: track.translator.exposure(track.history.accepted()),
        })
    }

    /// Takes note of a frame and says how it was exposed. None for a camera that is not there.
    ///
    /// `sequence` rises; gaps are frames that the driver lost. `timestamp_ns` is on the clock of all cameras.
    pub fn on_frame(&mut self, camera: usize, sequence: u64, timestamp_ns: u64) -> Option<FrameExposure> {
        let frame = self.tracks.get_mut(camera)?.on_frame(sequence, timestamp_ns);
        Some(self.frame_exposure(camera, frame))
    }

    /// How a frame was exposed, as far as is known now; the latency or an answer may have come meanwhile. None if the
    /// frame is not among the last 64 of its camera.
    #[must_use]
    pub fn exposure_of(&self, camera: usize, sequence: u64) -> Option<FrameExposure> {
        let frame = self.tracks.get(camera)?.frame(sequence)?;
        Some(self.frame_exposure(camera, frame))
    }

    /// Takes the statistics of a frame that came: of the leader to decide by, of the others to measure their latency.
    pub fn on_statistics(&mut self, camera: usize, sequence: u64, statistics: &Statistics) {
        let is_periodic = matches!(self.mode, Mode::Bracket { camera: bracketed, .. } if bracketed == camera);
        let Some(track) = self.tracks.get_mut(camera) else {
            return;
        };
        let Some(frame) = track.frame(sequence) else { return };
        // A bracket repeats itself: latencies that differ by its length look alike.
        if !(is_periodic && track.estimator.latency().source != LatencySource::Assumed) {
            track.on_statistics(frame, statistics);
        }
        let decides = match self.mode {
            Mode::FollowLeader | Mode::FixedRatio { .. } | Mode::Bracket { .. } => true,
            Mode::Locked | Mode::Manual { .. } => false,
        };
        if decides && camera == self.leader && self.tracks[camera].is_certain(frame.tick) {
            self.decide(frame, statistics);
        }
    }

    /// What to ask a camera for now; to be called after each of its frames, once. Frames that it will be in force in
    /// are some way off, and the target of their moment is asked for.
    pub fn request(&mut self, camera: usize) -> Option<Request> {
        let track = self.tracks.get(camera).filter(|track| track.is_online)?;
        let last = track.last_frame()?;
        let shown_tick = track.shown_tick(last.tick);
        let target = self.timeline.at(track.taken_ns(last, shown_tick).max(0.0) as u64);
        let offset_ev = self.offset_ev(camera, shown_tick) + track.probe_offset_ev();
        let wanted = track.translator.translate(target, offset_ev);
        let request = self.tracks[camera].request(last.tick, &wanted, RequestId(self.next_id));
        self.next_id += u64::from(request.is_some());
        request
    }

    /// A driver accepted a request: `read_back` are the values it has now, which may be others than the ones asked for;
    /// `first_sequence_after` is the sequence number of the first frame that was, or will be, taken from the driver
    /// after that. Values that changed without a request may be told with an id never given.
    pub fn on_applied(&mut self, camera: usize, id: RequestId, read_back: &ControlValues, first_sequence_after: u64) {
        if let Some(track) = self.tracks.get_mut(camera) {
            track.on_applied(id, read_back, first_sequence_after);
        }
    }

    /// A driver refused a request; what was asked for is asked for again after some frames, ever more of them.
    pub fn on_refused(&mut self, camera: usize, id: RequestId) {
        if let Some(track) = self.tracks.get_mut(camera) {
            track.on_refused(id);
        }
    }

    /// Somebody switched an automatic mode of a camera on: its values are unknown until a request is accepted again.
    pub fn on_auto_mode_found(&mut self, camera: usize) {
        if let Some(track) = self.tracks.get_mut(camera) {
            track.is_automatic = true;
        }
    }

    /// A camera is gone. Without the leader nothing is decided; without another the rest goes on.
    pub fn on_lost(&mut self, camera: usize) {
        if let Some(track) = self.tracks.get_mut(camera) {
            track.on_lost();
        }
    }

    /// A camera is back, with control values read from the driver.
    pub fn on_returned(&mut self, camera: usize, values: ControlValues) {
        if let Some(track) = self.tracks.get_mut(camera) {
            track.on_returned(values);
        }
        if camera == self.leader {
            self.looked_ns = None;
            self.auto_exposure.restart(self.timeline.last().exposure_s.log2());
        }
    }

    fn frame_exposure(&self, camera: usize, frame: FrameRecord) -> FrameExposure {
        let track = &self.tracks[camera];
        let values = track.values(frame.tick);
        let exposure = track.translator.exposure(values);
        let target = self.timeline.at(frame.timestamp_ns);
        let factors = track.translator.factors(values, target.light_k);
        let target = target.factors();
        let off_ev = (factors[1] / target[1]).log2();
        FrameExposure {
            exposure,
            residual: std::array::from_fn(|channel| target[channel] / factors[channel]),
            bracket_step: self.bracket_step(camera, off_ev),
            is_certain: track.is_certain(frame.tick),
            flickers: track.translator.flickers(exposure.time_s),
        }
    }

    /// Which exposure of the bracket is nearest to one that is off by so many steps.
    fn bracket_step(&self, camera: usize, off_ev: f64) -> u32 {
        match self.mode {
            Mode::Bracket {
                camera: bracketed,
                n_steps,
                step_ev,
            } if bracketed == camera => {
                let step = off_ev / step_ev + 0.5 * f64::from(n_steps - 1);
                step.round().clamp(0.0, f64::from(n_steps - 1)) as u32
            }
            _ => 0,
        }
    }

    /// By how many steps a frame of a camera is to be brighter than the target.
    fn offset_ev(&self, camera: usize, tick: i64) -> f64 {
        match &self.mode {
            Mode::Locked | Mode::FollowLeader | Mode::Manual { .. } => 0.0,
            Mode::FixedRatio { offsets_ev } => offsets_ev[camera],
            Mode::Bracket {
                camera: bracketed,
                n_steps,
                step_ev,
            } => {
                // Not before the latency is known: a bracket does not tell it.
                if *bracketed != camera || self.tracks[camera].is_probing() {
                    return 0.0;
                }
                let step = tick.rem_euclid(i64::from(*n_steps)) as f64;
                (step - 0.5 * f64::from(n_steps - 1)) * step_ev
            }
        }
    }

    fn enter(&mut self, mode: Mode) {
        let before = *self.timeline.last();
        if let Mode::Manual {
            exposure_s,
            gain,
            white_balance,
        } = mode
        {
            let translator = &self.tracks[self.leader].translator;
            let white_balance = match white_balance {
                ManualWhiteBalance::Kelvin(kelvin) => translator.white_balance_at(kelvin),
                ManualWhiteBalance::Gains(gains) => Some(gains.map(|gain| gain / gains[1])),
            };
            let white_balance = white_balance.unwrap_or(before.white_balance);
            let green = translator.green_factor(white_balance);
            self.aim(Target {
                exposure_s: exposure_s * gain * green,
                white_balance,
                light_k: translator.light_k(white_balance),
                time_s: Some(exposure_s),
            });
        } else if before.time_s.is_some() {
            self.aim(Target { time_s: None, ..before });
        }
        self.mode = mode;
        let target = self.timeline.last();
        self.auto_exposure.restart(target.exposure_s.log2());
        self.auto_white_balance.restart(target.white_balance);
    }

    /// Looks at a picture of the leader whose exposure is certain.
    fn decide(&mut self, frame: FrameRecord, statistics: &Statistics) {
        let leader = &self.tracks[self.leader];
        let values = leader.values(frame.tick);
        let light_k = self.timeline.last().light_k;
        let factors = leader.translator.factors(values, light_k);
        let looked_ns = self.looked_ns.replace(frame.timestamp_ns);
        let elapsed_ns = looked_ns.map_or(0.0, |before| frame.timestamp_ns.saturating_sub(before) as f64);
        let elapsed_s = elapsed_ns.max(leader.interval_ns()) * 1e-9;
        let observation = Observation {
            statistics,
            in_force_log2: factors[1].log2(),
            range_log2: leader.translator.range_log2(values, light_k),
            elapsed_s: elapsed_s.min(1.0),
        };
        let exposure_log2 = self.auto_exposure.update(&observation);
        let limit = |white_balance| leader.translator.nearest_white_balance(white_balance, values);
        // While the exposure moves, other parts of the picture are clipped from frame to frame; colour can wait.
        let white_balance = if self.auto_exposure.is_moving() {
            None
        } else {
            self.auto_white_balance
                .update(statistics, factors, observation.elapsed_s, limit)
        };
        if exposure_log2.is_none() && white_balance.is_none() {
            return;
        }
        let ideal = Target {
            exposure_s: self.auto_exposure.asked_log2().exp2(),
            white_balance: self.auto_white_balance.asked(),
            light_k: leader.translator.light_k(self.auto_white_balance.asked()),
            time_s: None,
        };
        // What the leader's steps allow is the target, so that the leader's own picture needs no correction.
        let mut leader_values = *leader.history.accepted();
        for (kind, value) in leader.translator.translate(&ideal, 0.0).iter() {
            leader_values.set(kind, value);
        }
        self.aim(leader.translator.target(&leader_values, ideal.light_k));
    }

    /// Makes a target hold from the first moment on at which every camera can have it.
    ///
    /// The moment is half an interval before a frame of the leader: frames of the others that are nearest to that frame
    /// are after it, and those nearest to the frame before are before it.
    fn aim(&mut self, target: Target) {
        if target == *self.timeline.last() {
            return;
        }
        let effects = self.tracks.iter().filter_map(Track::earliest_effect_ns);
        let earliest_ns = effects.fold(0.0, f64::max);
        let leader = &self.tracks[self.leader];
        let from_ns = match leader.last_frame().filter(|_| leader.is_online) {
            None => earliest_ns,
            Some(last) => {
                let interval_ns = leader.interval_ns();
                let last_ns = last.timestamp_ns as f64;
                let n_frames = ((earliest_ns - last_ns) / interval_ns - 0.25).ceil();
                last_ns + (n_frames - 0.5) * interval_ns
            }
        };
        self.timeline.push(from_ns.max(0.0) as u64, target);
    }
}
