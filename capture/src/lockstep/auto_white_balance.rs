//! The white balance that the leader's pictures ask for.
//!
//! The colour of the light is estimated from the bright, unclipped samples (shades of grey, Finlayson and Trezzi 2004,
//! see [`Statistics::white_rgb`]), freed of the white balance in force, and taken out by gains (von Kries 1902). Only
//! what the leader's own controls can do is asked for: a room full of red is not mistaken for red light. Slow, as light
//! seldom changes its colour, and with a dead band, as small changes of colour are seen more easily than a small error.

use crate::meter::Statistics;

/// Differences below this, in log2 of a gain, are left alone: 3.5 %.
const DEAD_BAND: f64 = 0.05;

/// Difference at which an adjustment ends.
const SETTLED: f64 = 0.01;

/// Time constant of the estimate in seconds; shorter after a change as large as of a lamp switched on.
const SMOOTHING_S: f64 = 0.8;
const SMOOTHING_FAST_S: f64 = 0.15;

/// A change as large in log2 of a gain, for as long in seconds, is another light.
const OTHER_LIGHT: f64 = 0.3;
const OTHER_LIGHT_S: f64 = 0.2;

/// Time in seconds in which a difference shrinks to a third.
const SETTLE_S: f64 = 0.25;

/// Smallest share of the samples that a colour is believed from.
const COLOURED_LEAST: f64 = 0.1;

/// Chooses the white balance of all cameras. Colours are log2 of the gains of red and blue; green is 1.
#[derive(Debug, Clone)]
pub(super) struct AutoWhiteBalance {
    asked: [f64; 2],
    estimate: Option<[f64; 2]>,
    is_moving: bool,
    other_light_s: f64,
}

impl AutoWhiteBalance {
    pub(super) fn new(asked: [f64; 3]) -> Self {
        Self {
            asked: log2_from_gains(asked),
            estimate: None,
            is_moving: false,
            other_light_s: 0.0,
        }
    }

    /// Goes on from a white balance that somebody else asked for.
    pub(super) fn restart(&mut self, asked: [f64; 3]) {
        *self = Self::new(asked);
    }

    /// Gains asked for last, green is 1.
    pub(super) fn asked(&self) -> [f64; 3] {
        [self.asked[0].exp2(), 1.0, self.asked[1].exp2()]
    }

    /// Takes a picture with the signals of unit radiance, `factors`, in force; `limit` gives the nearest white balance
    /// that the leader can have. Returns the white balance to ask for if it is another than before.
    pub(super) fn update(
        &mut self,
        statistics: &Statistics,
        factors: [f64; 3],
        elapsed_s: f64,
        limit: impl Fn([f64; 3]) -> [f64; 3],
    ) -> Option<[f64; 3]> {
        let is_telling = statistics.coloured_share >= COLOURED_LEAST && statistics.white_rgb.iter().all(|&y| y > 1e-4);
        if !is_telling {
            return None;
        }
        let light: [f64; 3] = std::array::from_fn(|channel| statistics.white_rgb[channel] / factors[channel]);
        let seen = log2_from_gains(limit([light[1] / light[0], 1.0, light[1] / light[2]]));
        let estimate = self.smooth(seen, elapsed_s);
        let off = distance(estimate, self.asked);
        if !self.is_moving && off <= DEAD_BAND {
            return None;
        }
        self.is_moving = off > SETTLED;
        if !self.is_moving {
            return None;
        }
        let share = 1.0 - (-elapsed_s / SETTLE_S).exp();
        self.asked = std::array::from_fn(|index| self.asked[index] + share * (estimate[index] - self.asked[index]));
        Some(self.asked())
    }

    fn smooth(&mut self, seen: [f64; 2], elapsed_s: f64) -> [f64; 2] {
        let estimate = self.estimate.unwrap_or(seen);
        if distance(seen, estimate) > OTHER_LIGHT {
            self.other_light_s += elapsed_s;
        } else if distance(seen, estimate) < 0.5 * DEAD_BAND {
            self.other_light_s = 0.0;
        }
        let time_s = if self.other_light_s >= OTHER_LIGHT_S {
            SMOOTHING_FAST_S
        } else {
            SMOOTHING_S
        };
        let share = 1.0 - (-elapsed_s / time_s).exp();
        let estimate = std::array::from_fn(|index| estimate[index] + share * (seen[index] - estimate[index]));
        self.estimate = Some(estimate);
        estimate
    }
}

fn log2_from_gains(gains: [f64; 3]) -> [f64; 2] {
    [(gains[0] / gains[1]).log2(), (gains[2] / gains[1]).log2()]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    f64::max((a[0] - b[0]).abs(), (a[1] - b[1]).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meter::PERCENTILES;

    fn grey_under(light: [f64; 3], factors: [f64; 3]) -> Statistics {
        let rgb = std::array::from_fn(|channel| 0.1 * light[channel] * factors[channel]);
        Statistics {
            mean_luminance: 0.1,
            mean_log2: -3.0,
            mid_log2: -3.0,
            percentiles_log2: [-3.0; PERCENTILES.len()],
            mean_rgb: rgb,
            white_rgb: rgb,
            clipped_share: 0.0,
            black_share: 0.0,
            coloured_share: 1.0,
        }
    }

    #[test]
    fn grey_becomes_grey_and_stays() {
        let mut auto = AutoWhiteBalance::new([1.0; 3]);
        let light = [1.6, 1.0, 0.4];
        let mut asked = vec![[1.0; 3]];
        for frame in 0..300_usize {
            let in_force = asked[frame.saturating_sub(4)];
            let news = auto.update(&grey_under(light, in_force), in_force, 1.0 / 30.0, |gains| gains);
            asked.push(news.unwrap_or(asked[asked.len() - 1]));
        }
        let end = asked[asked.len() - 1];
        assert!(
            (end[0] * 1.6).log2().abs() < 0.02 && (end[2] * 0.4).log2().abs() < 0.02,
            "{end:?}"
        );
        // From one side, without swinging.
        assert!(
            asked
                .windows(2)
                .all(|pair| pair[1][0] <= pair[0][0] && pair[1][2] >= pair[0][2])
        );
        assert_eq!(asked[250], end);
    }

    #[test]
    fn what_the_leader_cannot_do_is_not_asked_for() {
        let mut auto = AutoWhiteBalance::new([1.0; 3]);
        let limit = |gains: [f64; 3]| [gains[0].clamp(0.8, 1.25), 1.0, gains[2].clamp(0.8, 1.25)];
        for _ in 0..300 {
            let asked = auto.update(&grey_under([20.0, 1.0, 0.02], [1.0; 3]), [1.0; 3], 1.0 / 30.0, limit);
            assert!(asked.is_none_or(|gains| gains[0] >= 0.8 && gains[2] <= 1.25));
        }
    }

    #[test]
    fn a_picture_without_colour_moves_nothing() {
        let mut auto = AutoWhiteBalance::new([1.0; 3]);
        let mut statistics = grey_under([2.0, 1.0, 0.5], [1.0; 3]);
        statistics.coloured_share = 0.05;
        assert!((0..99).all(|_| auto.update(&statistics, [1.0; 3], 0.1, |gains| gains).is_none()));
    }
}
