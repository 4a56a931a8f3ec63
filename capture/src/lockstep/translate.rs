//! A common target to the control values of one camera, and control values back to what they do.
//!
//! Exposure time comes before gain: the gain stays at its least until the time has reached its limit. Under lamps that
//! flicker the time is a whole number of periods, and the gain fills up. What the steps of the controls leave over is
//! not lost: it is the ratio of the target to the factors that the chosen values have.

use super::tables::{Tables, WhiteBalanceTable};
use super::target::Target;
use crate::controls::{ControlKind, ControlRange, ControlRanges, ControlValues};
use crate::frame::Exposure;

/// How exposure is shared out between time and gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExposurePolicy {
    /// Longest exposure time in seconds.
    pub(super) max_time_s: f64,
    /// Period of the lamps' flicker in seconds; none if they do not.
    pub(super) flicker_period_s: Option<f64>,
}

/// What there is to know about a camera's controls.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Translator {
    tables: Tables,
    ranges: ControlRanges,
    policy: ExposurePolicy,
    /// Exposure time of a camera without that control.
    fixed_time_s: f64,
}

/// Smallest difference between times that means something: well below any step of a control.
const TIME_TOLERANCE: f64 = 1e-6;

impl Translator {
    /// Controls outside their tables, or without one where one is needed, are left alone from here on.
    ///
    /// Every range has a step above 0 and a maximum not below its minimum.
    pub(super) fn new(tables: Tables, ranges: &ControlRanges, policy: ExposurePolicy, interval_s: f64) -> Self {
        let mut usable = ControlRanges::default();
        for (kind, range) in ranges.iter() {
            let span = match (kind, &tables.white_balance, &tables.gain) {
                (ControlKind::ExposureTime, _, _) => Some(tables.exposure.span()),
                (ControlKind::Gain, _, gain) => gain.as_ref().map(super::tables::Curve::span),
                (ControlKind::WhiteBalanceTemperature, WhiteBalanceTable::Temperature(table), _) => {
                    let (low_k, high_k) = table.span_k();
                    Some((low_k.ceil() as i64, high_k.floor() as i64))
                }
                (ControlKind::RedBalance, WhiteBalanceTable::RedBlue { red, .. }, _) => Some(red.span()),
                (ControlKind::BlueBalance, WhiteBalanceTable::RedBlue { blue, .. }, _) => Some(blue.span()),
                _ => None,
            };
            if let Some(range) = span.and_then(|span| within(range, span)) {
                usable.set(kind, range);
            }
        }
        Self {
            tables,
            ranges: usable,
            policy,
            fixed_time_s: interval_s,
        }
    }

    /// The values that come nearest to `target`, brighter by `offset_ev`; only of controls that can be used.
    pub(super) fn translate(&self, target: &Target, offset_ev: f64) -> ControlValues {
        let mut values = self.white_balance_values(target.white_balance);
        let green = self.gains(&values)[1] * self.tables.sensitivity[1];
        let exposure_s = target.exposure_s * offset_ev.exp2() / green;
        let (time, gain) = self.time_and_gain(exposure_s, target.time_s);
        if let Some(time) = time {
            values.set(ControlKind::ExposureTime, time);
        }
        if let Some(gain) = gain {
            values.set(ControlKind::Gain, gain);
        }
        values
    }

    /// Time, gain and white balance that values mean; what they lack, the camera cannot change.
    pub(super) fn exposure(&self, values: &ControlValues) -> Exposure {
        let time = values.get(ControlKind::ExposureTime);
        let gain = values.get(ControlKind::Gain).zip(self.tables.gain.as_ref());
        Exposure {
            time_s: time.map_or(self.fixed_time_s, |value| self.tables.exposure.time_s(value)),
            gain: gain.map_or(1.0, |(value, curve)| curve.at(value)),
            white_balance: self.gains(values),
        }
    }

    /// Signal of red, green and blue for unit radiance.
    pub(super) fn factors(&self, values: &ControlValues) -> [f64; 3] {
        let exposure = self.exposure(values);
        let scalar = exposure.time_s * exposure.gain;
        std::array::from_fn(|channel| scalar * exposure.white_balance[channel] * self.tables.sensitivity[channel])
    }

    /// The target that values come up to exactly.
    pub(super) fn target(&self, values: &ControlValues) -> Target {
        let factors = self.factors(values);
        Target {
            exposure_s: factors[1],
            white_balance: factors.map(|factor| factor / factors[1]),
            time_s: None,
        }
    }

    /// The white balance nearest to `white_balance` (green is 1) that the camera can have if its steps were fine.
    pub(super) fn nearest_white_balance(&self, white_balance: [f64; 3], values: &ControlValues) -> [f64; 3] {
        let sensitivity = self.tables.sensitivity;
        let gains = match &self.tables.white_balance {
            WhiteBalanceTable::Temperature(table) => {
                let Some(range) = self.ranges.get(ControlKind::WhiteBalanceTemperature) else {
                    return self.target(values).white_balance;
                };
                let ratio = self.camera_ratio(white_balance);
                let kelvin = table.kelvin_for(ratio);
                table.gains(kelvin.clamp(range.minimum as f64, range.maximum as f64))
            }
            WhiteBalanceTable::RedBlue { red, blue } => {
                let limit = |kind: ControlKind, curve: &super::tables::Curve, channel: usize| {
                    let range = self.ranges.get(kind)?;
                    let wanted = white_balance[channel] * sensitivity[1] / sensitivity[channel];
                    Some(wanted.clamp(curve.at(range.minimum), curve.at(range.maximum)))
                };
                let now = self.gains(values);
                [
                    limit(ControlKind::RedBalance, red, 0).unwrap_or(now[0]),
                    1.0,
                    limit(ControlKind::BlueBalance, blue, 2).unwrap_or(now[2]),
                ]
            }
        };
        std::array::from_fn(|channel| gains[channel] * sensitivity[channel] / (gains[1] * sensitivity[1]))
    }

    /// The white balance, green 1, of this camera at a temperature; none if it has no temperatures.
    pub(super) fn white_balance_at(&self, kelvin: f64) -> Option<[f64; 3]> {
        let WhiteBalanceTable::Temperature(table) = &self.tables.white_balance else {
            return None;
        };
        let gains = table.gains(kelvin);
        let sensitivity = self.tables.sensitivity;
        Some(std::array::from_fn(|channel| {
            gains[channel] * sensitivity[channel] / (gains[1] * sensitivity[1])
        }))
    }

    /// Green signal of unit radiance, time and gain, with a white balance that the camera can have.
    pub(super) fn green_factor(&self, white_balance: [f64; 3]) -> f64 {
        self.gains(&self.white_balance_values(white_balance))[1] * self.tables.sensitivity[1]
    }

    /// log2 of the least and greatest exposure of a [`Target`] that the camera can come up to.
    pub(super) fn range_log2(&self, values: &ControlValues) -> (f64, f64) {
        let green = self.gains(values)[1] * self.tables.sensitivity[1];
        let reach = |time_s: f64, gain: f64| (time_s * gain * green).log2();
        let gain = |value: fn(&ControlRange) -> i64| self.gain_at(value);
        let (least_s, greatest_s) = self.time_span_s();
        (
            reach(least_s, gain(|range| range.minimum)),
            reach(greatest_s, gain(|range| range.maximum)),
        )
    }

    /// True if an exposure time lets the lamps' flicker through.
    pub(super) fn flickers(&self, time_s: f64) -> bool {
        self.policy.flicker_period_s.is_some_and(|period_s| {
            let periods = time_s / period_s;
            // A hundredth of a period: the share of the flicker's swing that is left is smaller still.
            periods < 0.99 || (periods - periods.round()).abs() > 0.01 * periods.max(1.0)
        })
    }

    /// True if a control is driven.
    pub(super) fn drives(&self, kind: ControlKind) -> bool {
        self.ranges.get(kind).is_some()
    }

    /// True if the value of a control is one that the camera takes.
    #[cfg(test)]
    pub(super) fn admits(&self, kind: ControlKind, value: i64) -> bool {
        self.ranges.get(kind).is_some_and(|range| {
            (range.minimum..=range.maximum).contains(&value) && (value - range.minimum) % range.step == 0
        })
    }

    fn gains(&self, values: &ControlValues) -> [f64; 3] {
        match &self.tables.white_balance {
            WhiteBalanceTable::Temperature(table) => values
                .get(ControlKind::WhiteBalanceTemperature)
                .map_or([1.0; 3], |kelvin| table.gains(kelvin.max(1) as f64)),
            WhiteBalanceTable::RedBlue { red, blue } => [
                values.get(ControlKind::RedBalance).map_or(1.0, |value| red.at(value)),
                1.0,
                values.get(ControlKind::BlueBalance).map_or(1.0, |value| blue.at(value)),
            ],
        }
    }

    /// Ratio of red to blue gain that the camera needs for a white balance in the rig's own colours.
    fn camera_ratio(&self, white_balance: [f64; 3]) -> f64 {
        white_balance[0] / white_balance[2] * self.tables.sensitivity[2] / self.tables.sensitivity[0]
    }

    fn white_balance_values(&self, white_balance: [f64; 3]) -> ControlValues {
        let mut values = ControlValues::default();
        let sensitivity = self.tables.sensitivity;
        let wanted = |channel: usize| white_balance[channel] * sensitivity[1] / sensitivity[channel];
        match &self.tables.white_balance {
            WhiteBalanceTable::Temperature(table) => {
                if let Some(range) = self.ranges.get(ControlKind::WhiteBalanceTemperature) {
                    let kelvin = table.kelvin_for(self.camera_ratio(white_balance));
                    values.set(ControlKind::WhiteBalanceTemperature, range.nearest(kelvin));
                }
            }
            WhiteBalanceTable::RedBlue { red, blue } => {
                if let Some(range) = self.ranges.get(ControlKind::RedBalance) {
                    values.set(ControlKind::RedBalance, range.nearest(red.value_for(wanted(0))));
                }
                if let Some(range) = self.ranges.get(ControlKind::BlueBalance) {
                    values.set(ControlKind::BlueBalance, range.nearest(blue.value_for(wanted(2))));
                }
            }
        }
        values
    }

    /// Linear gain at one end of the gain control; 1 without it.
    fn gain_at(&self, value: fn(&ControlRange) -> i64) -> f64 {
        let range = self.ranges.get(ControlKind::Gain);
        let curve = range.as_ref().zip(self.tables.gain.as_ref());
        curve.map_or(1.0, |(range, curve)| curve.at(value(range)))
    }

    /// Shortest and longest exposure time in seconds.
    fn time_span_s(&self) -> (f64, f64) {
        let Some(range) = self.ranges.get(ControlKind::ExposureTime) else {
            return (self.fixed_time_s, self.fixed_time_s);
        };
        let least_s = self.tables.exposure.time_s(range.minimum);
        let longest_s = self.tables.exposure.time_s(range.maximum).min(self.policy.max_time_s);
        (least_s, longest_s.max(least_s))
    }

    /// Control values of time and gain for their product in seconds.
    fn time_and_gain(&self, exposure_s: f64, time_s: Option<f64>) -> (Option<i64>, Option<i64>) {
        let least_gain = self.gain_at(|range| range.minimum);
        let (shortest_s, longest_s) = self.time_span_s();
        let free_s = (exposure_s / least_gain).clamp(shortest_s, longest_s);
        let (wanted_s, is_exact) = match (time_s, self.policy.flicker_period_s) {
            (Some(time_s), _) => (time_s.clamp(shortest_s, longest_s), true),
            (None, Some(period_s)) => {
                let periods = (free_s / period_s + TIME_TOLERANCE).floor();
                if periods >= 1.0 {
                    (periods * period_s, true)
                } else {
                    (free_s, false)
                }
            }
            (None, None) => (free_s, false),
        };
        let Some(range) = self.ranges.get(ControlKind::ExposureTime) else {
            return (None, self.gain_for(exposure_s / self.fixed_time_s));
        };
        let nearest = self.nearest_time(range, wanted_s);
        // A little less time and more gain may come nearer, where time is not bound to the lamps.
        let shorter = nearest - range.step;
        if is_exact || shorter < range.minimum {
            return (
                Some(nearest),
                self.gain_for(exposure_s / self.tables.exposure.time_s(nearest)),
            );
        }
        let off = |time: i64| {
            let time_s = self.tables.exposure.time_s(time);
            let gain = self.gain_for(exposure_s / time_s);
            let gain = gain
                .zip(self.tables.gain.as_ref())
                .map_or(1.0, |(value, curve)| curve.at(value));
            (time_s * gain / exposure_s).log2().abs()
        };
        let time = if off(shorter) < 0.5 * off(nearest) {
            shorter
        } else {
            nearest
        };
        (
            Some(time),
            self.gain_for(exposure_s / self.tables.exposure.time_s(time)),
        )
    }

    /// The exposure control's value nearest to a time and not past the longest.
    fn nearest_time(&self, range: ControlRange, time_s: f64) -> i64 {
        let nearest = range.nearest(self.tables.exposure.value_for(time_s));
        let is_too_long = self.tables.exposure.time_s(nearest) > self.policy.max_time_s * (1.0 + TIME_TOLERANCE);
        if is_too_long && nearest > range.minimum {
            nearest - range.step
        } else {
            nearest
        }
    }

    fn gain_for(&self, gain: f64) -> Option<i64> {
        let range = self.ranges.get(ControlKind::Gain)?;
        let curve = self.tables.gain.as_ref()?;
        Some(range.nearest(curve.value_for(gain)))
    }
}

/// The part of a range within a span; none if there is none.
fn within(range: ControlRange, (first, last): (i64, i64)) -> Option<ControlRange> {
    let skipped = (first.saturating_sub(range.minimum).max(0) as u64).div_ceil(range.step as u64);
    let skipped = i64::try_from(skipped).ok()?;
    let minimum = range.minimum.checked_add(skipped.checked_mul(range.step)?)?;
    let maximum = range.maximum.min(last);
    let maximum = minimum + (maximum.checked_sub(minimum)?.max(-1)).div_euclid(range.step) * range.step;
    (maximum >= minimum).then_some(ControlRange {
        minimum,
        maximum,
        ..range
    })
}
