//! Which control values were in force when a frame was taken.
//!
//! A camera shows a change of its controls some frames after the driver has accepted it. This is the idea of libcamera's
//! `DelayedControls`: a queue of what was asked for, read so many frames later. Here only what the driver accepted is
//! in the queue, as read back from it, and the number of frames is measured ([`super::latency`]); when it is measured
//! anew, everything is read again with the new number.

use std::collections::VecDeque;

use crate::controls::ControlValues;

/// Accepted changes remembered; older ones are in force everywhere.
const CHANGES_MAX: usize = 64;

/// Values that the driver accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Change {
    /// First frame, on the camera's own count, that came after they were accepted.
    tick: i64,
    values: ControlValues,
    factor_log2: f64,
}

/// What the driver of one camera accepted, and when.
///
/// Frames are counted in ticks: like sequence numbers, but frames that the sensor lost without a gap in the sequence
/// count as well.
#[derive(Debug, Clone, PartialEq)]
pub struct InForce {
    changes: VecDeque<Change>,
}

impl InForce {
    /// Starts with values that have been in force for ever; `factor_log2` as in [`Self::accept`].
    #[must_use]
    pub fn new(values: ControlValues, factor_log2: f64) -> Self {
        let mut changes = VecDeque::with_capacity(CHANGES_MAX + 1);
        changes.push_back(Change {
            tick: i64::MIN / 2,
            values,
            factor_log2,
        });
        Self { changes }
    }

    /// Takes note of values that the driver accepted before the frame `tick` came; `factor_log2` is the log2 of the
    /// signal that they make of unit radiance. Changes that are reported out of order count as accepted together.
    pub fn accept(&mut self, tick: i64, values: ControlValues, factor_log2: f64) {
        let last = self.last().tick;
        self.changes.push_back(Change {
            tick: tick.max(last),
            values,
            factor_log2,
        });
        if self.changes.len() > CHANGES_MAX {
            self.changes.pop_front();
        }
    }

    /// The values in force in a frame of a camera that shows changes `latency_frames` late: with 0 the first frame that
    /// comes after the driver accepted them has them.
    #[must_use]
    pub fn values(&self, tick: i64, latency_frames: u32) -> &ControlValues {
        &self.change(tick, latency_frames).values
    }

    /// log2 of the factor in force in a frame, likewise.
    #[must_use]
    pub fn factor_log2(&self, tick: i64, latency_frames: u32) -> f64 {
        self.change(tick, latency_frames).factor_log2
    }

    /// The values accepted last, whether in force or not yet.
    #[must_use]
    pub fn accepted(&self) -> &ControlValues {
        &self.last().values
    }

    /// True if a change was accepted that came into force in the frame `tick` or the `n_ticks` before, or will.
    #[must_use]
    pub fn changed_within(&self, tick: i64, n_ticks: u32) -> bool {
        self.last().tick + i64::from(n_ticks) >= tick
    }

    fn last(&self) -> &Change {
        self.changes.back().expect("there is always one")
    }

    fn change(&self, tick: i64, latency_frames: u32) -> &Change {
        let accepted_before = tick - i64::from(latency_frames);
        let mut newest_first = self.changes.iter().rev();
        let found = newest_first.find(|change| change.tick <= accepted_before);
        found.unwrap_or(&self.changes[0])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::controls::ControlKind;

    fn exposure(value: i64) -> ControlValues {
        let mut values = ControlValues::default();
        values.set(ControlKind::ExposureTime, value);
        values
    }

    fn in_force(history: &InForce, tick: i64, latency_frames: u32) -> i64 {
        history
            .values(tick, latency_frames)
            .get(ControlKind::ExposureTime)
            .unwrap()
    }

    #[test]
    fn changes_show_so_many_frames_late() {
        let mut history = InForce::new(exposure(1), 0.0);
        history.accept(10, exposure(2), 1.0);
        history.accept(11, exposure(3), 2.0);
        let seen = |latency| {
            (9..16)
                .map(|tick| in_force(&history, tick, latency))
                .collect::<Vec<_>>()
        };
        assert_eq!(seen(0), [1, 2, 3, 3, 3, 3, 3]);
        assert_eq!(seen(3), [1, 1, 1, 1, 2, 3, 3]);
        assert_eq!(history.factor_log2(13, 3), 1.0);
        assert!(history.changed_within(14, 3) && !history.changed_within(15, 3));
    }

    proptest! {
        #[test]
        fn nothing_is_in_force_that_was_never_accepted(
            accepted in prop::collection::vec((0_i64..40, 100_i64..200), 0..200),
            ask in prop::collection::vec((-10_i64..60, 0_u32..9), 1..50),
        ) {
            let mut history = InForce::new(exposure(7), 0.0);
            for &(tick, value) in &accepted {
                history.accept(tick, exposure(value), 0.0);
            }
            for (tick, latency) in ask {
                let value = in_force(&history, tick, latency);
                let by_then = |&(at, accepted): &(i64, i64)| accepted == value && at <= tick - i64::from(latency);
                // Only when more changes than are remembered lie between may the oldest of them stand in.
                let stands_in = accepted.len() >= CHANGES_MAX && accepted.iter().any(|change| change.1 == value);
                prop_assert!(value == 7 || accepted.iter().any(by_then) || stands_in);
            }
        }
    }
}
