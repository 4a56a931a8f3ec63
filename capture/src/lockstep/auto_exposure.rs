//! The exposure that the leader's pictures ask for.
//!
//! The exposure in force of each picture is known, so the scene's radiance follows from it, and from that the exposure
//! wanted, whatever was in force: there is no loop through a delay that could swing. What is wanted rises with what is
//! in force where a picture is clipped, and stays the same where it is not; such a rule approaches its answer from one
//! side and cannot overshoot it.
//!
//! Wanted is a geometric mean luminance of 0.18 (the key of Reinhard et al. 2002, middle grey), centre-weighted, and
//! less, by one step at most, where that clips more than 2 % of the picture.

use crate::meter::{BLACK_LOG2, PERCENTILES, Statistics};

/// How exposure is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AutoExposureSettings {
    /// Geometric mean luminance wanted, as a fraction of full scale, 0.01 to 0.9.
    pub key: f64,
    /// By how many steps at most the exposure is lowered to keep highlights, 0 to 4.
    pub highlight_drop_max_ev: f64,
    /// Smallest difference that is acted on, in steps, 0.02 to 1; more where the picture is restless.
    pub dead_band_ev: f64,
    /// Time in seconds in which a small difference shrinks to a third, 0.01 to 10.
    pub settle_s: f64,
}

impl Default for AutoExposureSettings {
    fn default() -> Self {
        Self {
            key: 0.18,
            highlight_drop_max_ev: 1.0,
            dead_band_ev: 0.12,
            settle_s: 0.12,
        }
    }
}

/// Luminance that 98 % of the picture should stay below.
const HIGHLIGHT_MOST: f64 = 0.9;

/// log2 of the luminance above which a percentile may be clipped; above [`HIGHLIGHT_MOST`], which must be told from it.
const CLIPPED_LOG2: f64 = -0.1;

/// A difference as large is made up for at once.
const JUMP_EV: f64 = 0.7;

/// Difference at which an adjustment ends.
const SETTLED_EV: f64 = 0.02;

/// With a larger share of clipped samples the mean says too little.
const CLIPPED_MANY: f64 = 0.1;

/// With a larger share of black samples the mean says too much.
const BLACK_MANY: f64 = 0.3;

/// Furthest that one picture may ask for, darker and brighter than it is: what lies beyond cannot be told from it.
const REACH_EV: (f64, f64) = (-6.0, 4.0);

/// A picture of the leader, and how far its exposure can go.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observation<'a> {
    pub(super) statistics: &'a Statistics,
    /// log2 of the exposure in force, as of a target.
    pub(super) in_force_log2: f64,
    /// log2 of the least and greatest exposure that the leader can have.
    pub(super) range_log2: (f64, f64),
    /// Time in seconds since the observation before.
    pub(super) elapsed_s: f64,
}

/// Chooses the exposure of all cameras.
#[derive(Debug, Clone)]
pub(super) struct AutoExposure {
    settings: AutoExposureSettings,
    /// log2 of the exposure asked for last.
    asked_log2: f64,
    is_moving: bool,
    /// What the last pictures wanted, newest first.
    wanted: [Option<f64>; 3],
    noise_ev: f64,
    /// Percentiles relative to the mean in log2, as last seen unclipped.
    shape: [f64; PERCENTILES.len()],
}

impl AutoExposure {
    pub(super) fn new(settings: AutoExposureSettings, asked_log2: f64) -> Self {
        Self {
            settings,
            asked_log2,
            is_moving: false,
            wanted: [None; 3],
            noise_ev: 0.0,
            // A log-normal scene of 1.3 steps: the normal distribution's quantiles of `PERCENTILES` times 1.3.
            shape: [-2.14, -1.67, -0.88, 0.0, 0.88, 1.67, 2.67],
        }
    }

    /// Goes on from an exposure that somebody else asked for, forgetting the pictures so far.
    pub(super) fn restart(&mut self, asked_log2: f64) {
        self.asked_log2 = asked_log2;
        self.is_moving = false;
        self.wanted = [None; 3];
    }

    /// log2 of the exposure asked for last.
    pub(super) fn asked_log2(&self) -> f64 {
        self.asked_log2
    }

    /// True while the exposure is on its way to another.
    pub(super) fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// Takes a picture; returns log2 of the exposure to ask for if it is another than before.
    pub(super) fn update(&mut self, observation: &Observation) -> Option<f64> {
        let (least, greatest) = observation.range_log2;
        let wanted = self.wanted_log2(observation).clamp(least, greatest.max(least));
        if let Some(before) = self.wanted[0] {
            // Mean absolute difference of neighbours to standard deviation: sqrt(pi) / 2, for normal noise.
            let off_ev = (wanted - before).abs().min(0.3);
            self.noise_ev += 0.05 * (0.886 * off_ev - self.noise_ev);
        }
        self.wanted = [Some(wanted), self.wanted[0], self.wanted[1]];
        let wanted = self.median_wanted()?;
        let off_ev = wanted - self.asked_log2;
        let dead_band_ev = (self.settings.dead_band_ev + 2.5 * self.noise_ev).min(0.6);
        if !self.is_moving && off_ev.abs() <= dead_band_ev {
            return None;
        }
        self.is_moving = off_ev.abs() > SETTLED_EV + 0.5 * self.noise_ev;
        if !self.is_moving {
            return None;
        }
        let share = if off_ev.abs() >= JUMP_EV {
            1.0
        } else {
            1.0 - (-observation.elapsed_s / self.settings.settle_s).exp()
        };
        self.asked_log2 += share * off_ev;
        Some(self.asked_log2)
    }

    /// The middle one of the last three: one odd picture moves nothing.
    fn median_wanted(&self) -> Option<f64> {
        let [Some(a), Some(b), c] = self.wanted else {
            return None;
        };
        let c = c.unwrap_or(b);
        Some(f64::max(a.min(b), f64::min(a.max(b), c)))
    }

    fn wanted_log2(&mut self, observation: &Observation) -> f64 {
        let statistics = observation.statistics;
        let key_log2 = self.key_log2(statistics);
        let for_key = self.settings.key.log2() - key_log2;
        let last = PERCENTILES.len() - 1;
        let seen_log2 = statistics.percentiles_log2[last];
        // Clipped highlights are at least as bright as they look; how bright they were before tells more.
        let highlight_log2 = if seen_log2 < CLIPPED_LOG2 {
            seen_log2
        } else {
            seen_log2.max(key_log2 + self.shape[last])
        };
        let for_highlights = HIGHLIGHT_MOST.log2() - highlight_log2;
        let change_ev = for_highlights.clamp(for_key - self.settings.highlight_drop_max_ev, for_key);
        observation.in_force_log2 + change_ev.clamp(REACH_EV.0, REACH_EV.1)
    }

    /// log2 of the geometric mean luminance that the picture would have were it not clipped.
    ///
    /// Percentiles that are neither clipped nor black keep their distance to the mean when the light changes alike
    /// everywhere, so each gives the mean; if none is left, the outermost one gives a bound.
    fn key_log2(&mut self, statistics: &Statistics) -> f64 {
        let percentiles = &statistics.percentiles_log2;
        let is_clipped = statistics.clipped_share > CLIPPED_MANY;
        let is_black = statistics.black_share > BLACK_MANY;
        if !is_clipped && !is_black {
            for (shape, percentile) in self.shape.iter_mut().zip(percentiles) {
                let seen = percentile - statistics.mean_log2;
                if *percentile < CLIPPED_LOG2 {
                    *shape += 0.3 * (seen - *shape);
                } else {
                    *shape = shape.max(seen);
                }
            }
            return statistics.mean_log2;
        }
        let readable = |log2: f64| log2 < -0.5 && log2 > BLACK_LOG2 + 3.0;
        let (mut sum, mut n) = (0.0, 0);
        for (percentile, shape) in percentiles.iter().zip(self.shape) {
            if readable(*percentile) {
                sum += percentile - shape;
                n += 1;
            }
        }
        let last = PERCENTILES.len() - 1;
        match (n, is_clipped) {
            (0, true) => statistics.mean_log2.max(percentiles[0] - self.shape[0]),
            (0, false) => statistics.mean_log2.min(percentiles[last] - self.shape[last]),
            (n, true) => statistics.mean_log2.max(sum / f64::from(n)),
            (n, false) => statistics.mean_log2.min(sum / f64::from(n)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a meter would say of a log-normal scene of 1.3 steps around `radiance_log2`.
    fn statistics(radiance_log2: f64, exposure_log2: f64) -> Statistics {
        let quantile = |share: f64| {
            // Logistic approximation of the normal quantile (Tukey's lambda, 0.14).
            (share.powf(0.135) - (1.0 - share).powf(0.135)) / 0.1975
        };
        let n = 400;
        let log2 = |share: f64| (radiance_log2 + exposure_log2 + 1.3 * quantile(share)).clamp(BLACK_LOG2, 0.0);
        let samples: Vec<f64> = (0..n)
            .map(|index| log2((f64::from(index) + 0.5) / f64::from(n)))
            .collect();
        let share = |is: &dyn Fn(f64) -> bool| samples.iter().filter(|log2| is(**log2)).count() as f64 / f64::from(n);
        Statistics {
            mean_luminance: samples.iter().map(|log2| log2.exp2()).sum::<f64>() / f64::from(n),
            mean_log2: samples.iter().sum::<f64>() / f64::from(n),
            mid_log2: log2(0.5),
            percentiles_log2: PERCENTILES.map(log2),
            mean_rgb: [0.2; 3],
            white_rgb: [0.2; 3],
            clipped_share: share(&|log2| log2 >= -0.02),
            black_share: share(&|log2| log2 <= BLACK_LOG2),
            coloured_share: 1.0,
        }
    }

    /// Exposures asked for, with a latency of 4 frames.
    fn run(auto: &mut AutoExposure, radiance_log2: impl Fn(usize) -> f64, n_frames: usize) -> Vec<f64> {
        let mut asked = vec![auto.asked_log2; 5];
        for frame in 0..n_frames {
            let in_force_log2 = asked[frame];
            let observation = Observation {
                statistics: &statistics(radiance_log2(frame), in_force_log2),
                in_force_log2,
                range_log2: (-14.0, 0.0),
                elapsed_s: 1.0 / 30.0,
            };
            auto.update(&observation);
            asked.push(auto.asked_log2);
        }
        asked
    }

    #[test]
    fn steps_of_light_are_followed_at_once_and_without_overshoot() {
        for step_ev in [4.0, -4.0, 7.0, -7.0, 1.0, -1.0, 0.3] {
            let mut auto = AutoExposure::new(AutoExposureSettings::default(), -7.0);
            let settled = *run(&mut auto, |_| 4.0, 200).last().unwrap();
            let asked = run(&mut auto, |_| 4.0 + step_ev, 200);
            let end = *asked.last().unwrap();
            assert!((settled - end - step_ev).abs() < 0.2, "{step_ev}: {settled} {end}");
            let overshoot = asked
                .iter()
                .map(|log2| (end - log2) * step_ev.signum())
                .fold(0.0, f64::max);
            assert!(overshoot < 0.1, "{step_ev}: {overshoot} {asked:?}");
            let n_frames = asked.iter().position(|log2| (log2 - end).abs() < 0.1).unwrap();
            assert!(n_frames <= 5 + 25, "{step_ev}: {n_frames}");
        }
    }

    #[test]
    fn one_odd_picture_moves_nothing() {
        let mut auto = AutoExposure::new(AutoExposureSettings::default(), -7.0);
        let before = *run(&mut auto, |_| 4.0, 200).last().unwrap();
        let asked = run(&mut auto, |frame| if frame == 50 { 9.0 } else { 4.0 }, 100);
        assert!(asked.iter().all(|log2| *log2 == before));
    }

    #[test]
    fn the_limit_of_the_camera_is_kept() {
        let mut auto = AutoExposure::new(AutoExposureSettings::default(), -7.0);
        let asked = run(&mut auto, |_| -9.0, 100);
        assert_eq!(asked.last(), Some(&0.0));
        let asked = run(&mut auto, |_| 20.0, 100);
        assert!((asked.last().unwrap() + 14.0).abs() <= 0.02, "{asked:?}");
    }
}
