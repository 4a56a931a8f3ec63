//! The exposure and white balance that all cameras are to have, over time.

use std::collections::VecDeque;

/// Targets remembered; a frame older than all of them gets the oldest.
const TARGETS_MAX: usize = 64;

/// What all cameras are to have in common.
///
/// The signal of channel `c` for unit radiance is `exposure_s * white_balance[c]`, as fraction of full scale, whichever
/// camera: each gets there by its own time, gain, white balance and sensitivity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Exposure time times gain in seconds, for green, of a camera with sensitivity 1; above 0.
    pub exposure_s: f64,
    /// Gains of red, green and blue; green is 1.
    pub white_balance: [f64; 3],
    /// Colour temperature in kelvin of the light that `white_balance` makes white: cameras differ from each other by
    /// the light.
    pub light_k: f64,
    /// Exposure time that cameras should keep to, in seconds; without it they choose.
    pub time_s: Option<f64>,
}

impl Target {
    /// Signal of red, green and blue for unit radiance.
    #[must_use]
    pub fn factors(&self) -> [f64; 3] {
        self.white_balance.map(|gain| gain * self.exposure_s)
    }
}

/// Targets, each from some moment on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Timeline {
    targets: VecDeque<(u64, Target)>,
}

impl Timeline {
    /// One target, for ever.
    pub(super) fn new(target: Target) -> Self {
        let mut targets = VecDeque::with_capacity(TARGETS_MAX + 1);
        targets.push_back((0, target));
        Self { targets }
    }

    /// A new target from a moment on, or from the beginning of the last one if that is later.
    pub(super) fn push(&mut self, from_ns: u64, target: Target) {
        let last_ns = self.targets.back().map_or(0, |last| last.0);
        if from_ns <= last_ns {
            self.targets.pop_back();
        }
        self.targets.push_back((from_ns.max(last_ns), target));
        if self.targets.len() > TARGETS_MAX {
            self.targets.pop_front();
        }
    }

    /// The target of frames taken at a moment.
    pub(super) fn at(&self, timestamp_ns: u64) -> &Target {
        let mut newest_first = self.targets.iter().rev();
        let found = newest_first.find(|(from_ns, _)| *from_ns <= timestamp_ns);
        &found.unwrap_or(&self.targets[0]).1
    }

    /// The target decided on last, perhaps for frames yet to come.
    pub(super) fn last(&self) -> &Target {
        &self.targets[self.targets.len() - 1].1
    }
}
