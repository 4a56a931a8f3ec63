//! A common target to the control values of one camera, and control values back to what they do.
//!
//! Exposure time comes before gain: the gain stays at its least until the time has reached its limit. Under lamps that
//! flicker the time is a whole number of periods, and the gain fills up. What the steps of the controls leave over is
//! not lost: it is the ratio of the target to the factors that the chosen values have.

use super::tables::{Curve, Tables, TemperatureTable, WhiteBalanceTable};
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
    /// The colours of light, for the temperature of a white balance.
    black_body: TemperatureTable,
}

/// Smallest difference between times that means something: well below any step of a control.
const TIME_TOLERANCE: f64 = 1e-6;

/// With this share of a period wanted, a whole one is given: a quarter of a step too bright is seen less than flicker.
const NEARLY_A_PERIOD: f64 = 0.84;

impl Translator {
    /// Controls outside their tables, or without one where one is needed, are left alone from here on.
    ///
    /// Every range has a step above 0 and a maximum not below its minimum.
    pub(super) fn new(tables: Tables, ranges: &ControlRanges, policy: ExposurePolicy, interval_s: f64) -> Self {
        let mut usable = ControlRanges::default();
        for (kind, range) in ranges.iter() {
            let span = match (kind, &tables.white_balance, &tables.gain) {
                (ControlKind::ExposureTime, _, _) => Some(tables.exposure.span()),
                (ControlKind::Gain, _, gain) => gain.as_ref().map(Curve::span),
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
            black_body: TemperatureTable::black_body(),
        }
    }

    /// The values that come nearest to `target`, brighter by `offset_ev`; only of controls that can be used.
    pub(super) fn translate(&self, target: &Target, offset_ev: f64) -> ControlValues {
        let sensitivity = self.tables.sensitivity.gains(target.light_k);
        let mut values = self.white_balance_values(target.white_balance, sensitivity);
        let green = self.gains(&values)[1] * sensitivity[1];
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

    /// Signal of red, green and blue for unit radiance in light of a temperature.
    pub(super) fn factors(&self, values: &ControlValues, light_k: f64) -> [f64; 3] {
        let exposure = self.exposure(values);
        let scalar = exposure.time_s * exposure.gain;
        let sensitivity = self.tables.sensitivity.gains(light_k);
        std::array::from_fn(|channel| scalar * exposure.white_balance[channel] * sensitivity[channel])
    }

    /// log2 of the green signal, but for the light: good for comparing values with each other.
    pub(super) fn signal_log2(&self, values: &ControlValues) -> f64 {
        let exposure = self.exposure(values);
        (exposure.time_s * exposure.gain * exposure.white_balance[1]).log2()
    }

    /// The target that values come up to exactly in light of a temperature.
    pub(super) fn target(&self, values: &ControlValues, light_k: f64) -> Target {
        let factors = self.factors(values, light_k);
        Target {
            exposure_s: factors[1],
            white_balance: factors.map(|factor| factor / factors[1]),
            light_k,
            time_s: None,
        }
    }

    /// Temperature in kelvin of the light that a white balance makes white, by the ratio of red to blue.
    pub(super) fn light_k(&self, white_balance: [f64; 3]) -> f64 {
        self.black_body.kelvin_for(white_balance[0] / white_balance[2])
    }

    /// The white balance nearest to `white_balance` (green is 1) that the camera can have if its steps were fine.
    pub(super) fn nearest_white_balance(&self, white_balance: [f64; 3], values: &ControlValues) -> [f64; 3] {
        let sensitivity = self.tables.sensitivity.gains(self.light_k(white_balance));
        let now = self.gains(values);
        let gains = match &self.tables.white_balance {
            WhiteBalanceTable::Temperature(table) => {
                self.ranges
                    .get(ControlKind::WhiteBalanceTemperature)
                    .map_or(now, |range| {
                        let kelvin = table.kelvin_for(ratio_needed(white_balance, sensitivity));
                        table.gains(kelvin.clamp(range.minimum as f64, range.maximum as f64))
                    })
            }
            WhiteBalanceTable::RedBlue { red, blue } => {
                let limit = |kind: ControlKind, curve: &Curve, channel: usize| {
                    let wanted = white_balance[channel] * sensitivity[1] / sensitivity[channel];
                    let within = |range: ControlRange| wanted.clamp(curve.at(range.minimum), curve.at(range.maximum));
                    self.ranges.get(kind).map_or(now[channel], within)
                };
                [
                    limit(ControlKind::RedBalance, red, 0),
                    1.0,
                    limit(ControlKind::BlueBalance, blue, 2),
                ]
            }
        };
        relative_to_green(gains, sensitivity)
    }

    /// The white balance, green 1, of this camera at a temperature of its control; none if it has no such control.
    pub(super) fn white_balance_at(&self, kelvin: f64) -> Option<[f64; 3]> {
        let WhiteBalanceTable::Temperature(table) = &self.tables.white_balance else {
            return None;
        };
        let gains = table.gains(kelvin);
        // What the camera takes the light for and what it is are close; one correction is enough.
        let nearly = relative_to_green(gains, self.tables.sensitivity.gains(kelvin));
        Some(relative_to_green(
            gains,
            self.tables.sensitivity.gains(self.light_k(nearly)),
        ))
    }

    /// Green signal of unit radiance, time and gain, with a white balance that the camera can have.
    pub(super) fn green_factor(&self, white_balance: [f64; 3]) -> f64 {
        let sensitivity = self.tables.sensitivity.gains(self.light_k(white_balance));
        self.gains(&self.white_balance_values(white_balance, sensitivity))[1] * sensitivity[1]
    }

    /// log2 of the least and greatest exposure of a [`Target`] that the camera can come up to in light of a temperature.
    pub(super) fn range_log2(&self, values: &ControlValues, light_k: f64) -> (f64, f64) {
        let green = self.gains(values)[1] * self.tables.sensitivity.gains(light_k)[1];
        let (shortest_s, longest_s) = self.time_span_s();
        let least = shortest_s * self.gain_at(|range| range.minimum);
        let greatest = longest_s * self.gain_at(|range| range.maximum);
        ((least * green).log2(), (greatest * green).log2())
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

    fn white_balance_values(&self, white_balance: [f64; 3], sensitivity: [f64; 3]) -> ControlValues {
        let mut values = ControlValues::default();
        let mut set = |kind: ControlKind, value: f64| {
            if let Some(range) = self.ranges.get(kind) {
                values.set(kind, range.nearest(value));
            }
        };
        let wanted = |channel: usize| white_balance[channel] * sensitivity[1] / sensitivity[channel];
        match &self.tables.white_balance {
            WhiteBalanceTable::Temperature(table) => {
                let kelvin = table.kelvin_for(ratio_needed(white_balance, sensitivity));
                set(ControlKind::WhiteBalanceTemperature, kelvin);
            }
            WhiteBalanceTable::RedBlue { red, blue } => {
                set(ControlKind::RedBalance, red.value_for(wanted(0)));
                set(ControlKind::BlueBalance, blue.value_for(wanted(2)));
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
                let periods = free_s / period_s;
                let periods = if (NEARLY_A_PERIOD..1.0).contains(&periods) {
                    1.0
                } else {
                    (periods + TIME_TOLERANCE).floor()
                };
                if periods >= 1.0 && periods * period_s <= longest_s {
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

/// Ratio of red to blue gain that a camera needs for a white balance in the rig's own colours.
fn ratio_needed(white_balance: [f64; 3], sensitivity: [f64; 3]) -> f64 {
    white_balance[0] / white_balance[2] * sensitivity[2] / sensitivity[0]
}

/// What a camera's gains are in the rig's own colours, green 1.
fn relative_to_green(gains: [f64; 3], sensitivity: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|channel| gains[channel] * sensitivity[channel] / (gains[1] * sensitivity[1]))
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
