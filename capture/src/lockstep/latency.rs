//! How many frames after the driver accepted a change a camera shows it, measured from the pictures themselves.
//!
//! For every number of frames that comes into question, the changes that were asked for predict how the brightness
//! moves from frame to frame. Each number collects the logarithm of its likelihood; the one that leads by enough is
//! believed. The room's light changes too, so one frame may not say much: the likelihood has the long tails of
//! Student's t (Lange, Little and Taylor 1989), and stops at a floor. Steps at irregular intervals keep a lamp that
//! flickers from agreeing with a wrong number.

use super::in_force::InForce;

/// Most frames of latency that are told apart.
pub const LATENCY_MAX_FRAMES: u32 = 8;

/// Latency taken for granted until it is known: what most UVC cameras have.
pub const LATENCY_ASSUMED_FRAMES: u32 = 2;

const CANDIDATES: usize = LATENCY_MAX_FRAMES as usize + 1;

/// Most that one frame can say against a candidate, in nats.
const LOSS_MAX: f64 = 6.0;

/// Lead over the second best at which a candidate is believed: three changes of full weight, each of which shows in two
/// frames (one where it is and one where it should be), or more of less weight.
const LEAD_NEEDED: f64 = 30.0;

/// Greatest lead: a camera that comes back with another latency is believed after twice as many changes.
const LEAD_MAX: f64 = 60.0;

/// Changes of brightness between frames below this cannot be told from noise: about a code of 8 bits.
const NOISE_LEAST_EV: f64 = 0.02;

/// Where a latency comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LatencySource {
    /// Nothing is known yet: [`LATENCY_ASSUMED_FRAMES`].
    Assumed,
    /// Given in the configuration.
    Configured,
    /// Measured.
    Measured,
}

/// Frames between a change and its effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latency {
    /// With 0 the first frame that comes after the driver accepted a change shows it.
    pub frames: u32,
    /// How that is known.
    pub source: LatencySource,
    /// By how many nats the best candidate leads, 0 to 60; at 30 it is believed.
    pub lead: f64,
}

/// Measures the latency of one camera.
#[derive(Debug, Clone)]
pub struct LatencyEstimator {
    believed: Latency,
    losses: [f64; CANDIDATES],
    before: Option<(i64, f64)>,
    noise_ev: f64,
}

impl LatencyEstimator {
    /// Starts with what the configuration says, if it says anything; then nothing is measured.
    #[must_use]
    pub fn new(configured_frames: Option<u32>) -> Self {
        let source = if configured_frames.is_some() {
            LatencySource::Configured
        } else {
            LatencySource::Assumed
        };
        Self {
            believed: Latency {
                frames: configured_frames.unwrap_or(LATENCY_ASSUMED_FRAMES),
                source,
                lead: 0.0,
            },
            losses: [0.0; CANDIDATES],
            before: None,
            noise_ev: 0.05,
        }
    }

    /// What is believed now.
    #[must_use]
    pub fn latency(&self) -> Latency {
        self.believed
    }

    /// Takes the brightness of a frame as log2 of its signal; none if it is clipped or black, and says nothing.
    /// Returns true if another number of frames is believed from now on.
    pub fn observe(&mut self, history: &InForce, tick: i64, signal_log2: Option<f64>) -> bool {
        let Some(signal_log2) = signal_log2 else {
            self.before = None;
            return false;
        };
        let before = self.before.replace((tick, signal_log2));
        let Some((tick_before, log2_before)) = before.filter(|(before, _)| *before < tick) else {
            return false;
        };
        if self.believed.source == LatencySource::Configured {
            return false;
        }
        let seen_ev = signal_log2 - log2_before;
        let expected_ev: [f64; CANDIDATES] = std::array::from_fn(|frames| {
            history.factor_log2(tick, frames as u32) - history.factor_log2(tick_before, frames as u32)
        });
        let says_nothing = expected_ev
            .iter()
            .all(|ev| (ev - expected_ev[0]).abs() < 0.5 * NOISE_LEAST_EV);
        if says_nothing {
            let off_ev = (seen_ev - expected_ev[0]).abs().min(0.3);
            self.noise_ev += 0.05 * (1.25 * off_ev - self.noise_ev);
            return false;
        }
        let scale_ev = self.noise_ev.max(NOISE_LEAST_EV);
        for (loss, expected_ev) in self.losses.iter_mut().zip(expected_ev) {
            let off = (seen_ev - expected_ev) / scale_ev;
            // Student's t with two degrees of freedom, negative logarithm without its constant.
            *loss += (1.5 * (off * off / 2.0).ln_1p()).min(LOSS_MAX);
        }
        self.decide()
    }

    /// Forgets half of what it has seen: the camera was away and may have come back different.
    pub fn doubt(&mut self) {
        self.before = None;
        for loss in &mut self.losses {
            *loss *= 0.5;
        }
    }

    fn decide(&mut self) -> bool {
        let least = self.losses.iter().copied().fold(f64::INFINITY, f64::min);
        for loss in &mut self.losses {
            *loss = (*loss - least).min(LEAD_MAX);
        }
        let best = self.losses.iter().position(|loss| *loss == 0.0).unwrap_or(0);
        let others = self.losses.iter().enumerate().filter(|(frames, _)| *frames != best);
        let lead = others.map(|(_, loss)| *loss).fold(LEAD_MAX, f64::min);
        let frames = best as u32;
        let is_believed = lead >= LEAD_NEEDED;
        let is_news = is_believed && (frames != self.believed.frames);
        if is_believed {
            self.believed = Latency {
                frames,
                source: LatencySource::Measured,
                lead,
            };
        } else if frames == self.believed.frames {
            self.believed.lead = lead;
        } else {
            self.believed.lead = 0.0;
        }
        is_news
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controls::ControlValues;

    #[test]
    fn steps_tell_the_latency() {
        for truth in 0..=LATENCY_MAX_FRAMES {
            let mut history = InForce::new(ControlValues::default(), 0.0);
            let mut estimator = LatencyEstimator::new(None);
            assert_eq!(estimator.latency().source, LatencySource::Assumed);
            let mut is_up = false;
            for tick in 0..60 {
                if [11, 20, 33, 41].contains(&tick) {
                    is_up = !is_up;
                    history.accept(tick, ControlValues::default(), if is_up { 0.5 } else { 0.0 });
                }
                let room = if tick >= 21 { 1.0 } else { 0.0 };
                let signal = -3.0 + room + history.factor_log2(tick, truth);
                estimator.observe(&history, tick, Some(signal));
            }
            let latency = estimator.latency();
            assert_eq!((latency.frames, latency.source), (truth, LatencySource::Measured));
            assert!(latency.lead >= LEAD_NEEDED);
        }
    }

    #[test]
    fn without_changes_nothing_is_believed() {
        let history = InForce::new(ControlValues::default(), 0.0);
        let mut estimator = LatencyEstimator::new(None);
        for tick in 0..1000 {
            assert!(!estimator.observe(&history, tick, Some(f64::from(tick as i32 % 7) * 0.5)));
        }
        assert_eq!(estimator.latency().source, LatencySource::Assumed);
    }

    #[test]
    fn a_configured_latency_stays() {
        let mut history = InForce::new(ControlValues::default(), 0.0);
        let mut estimator = LatencyEstimator::new(Some(3));
        for tick in 0..100 {
            history.accept(tick, ControlValues::default(), f64::from((tick / 9 % 2) as i32));
            estimator.observe(&history, tick, Some(history.factor_log2(tick, 1)));
        }
        assert_eq!(
            (estimator.latency().frames, estimator.latency().source),
            (3, LatencySource::Configured)
        );
    }
}
