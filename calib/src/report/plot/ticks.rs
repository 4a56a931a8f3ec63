//! Where the marks of an axis are, and what stands beside them.

use super::{MAX_MAGNITUDE, Scale, is_drawable};

/// Least extent of an axis, relative to the largest value on it; below that, numbers do not tell its ends apart.
const MIN_RELATIVE_SPAN: f64 = 1e-9;

/// Least extent of an axis around 0.
const MIN_SPAN: f64 = 1e-290;

/// Part of the extent that is left free at either end of a linear axis.
const MARGIN: f64 = 0.04;

/// Decades of a logarithmic axis up to which the lines between decades are drawn, and labelled (2 and 5).
const MINOR_DECADES: (f64, f64) = (4.5, 1.6);

/// The part of the number line that an axis shows, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    pub(super) scale: Scale,
    /// Ends; for a logarithmic axis their decimal logarithms.
    low: f64,
    high: f64,
}

/// A mark.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    /// Empty for a line between the labelled ones.
    pub(super) label: String,
}

/// The marks of an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub(super) ticks: Vec<Tick>,
    /// What the labels are multiples of, such as `×10⁻⁶`; empty when they are what they say.
    pub(super) factor: String,
}

impl Span {
    /// Covers all values that can be shown, with a margin. Without any, 0 to 1, or 1 to 10.
    pub(super) fn around(scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        Self::of(scale, values).widened(MARGIN)
    }

    /// Covers exactly the values that can be shown.
    pub(super) fn of(scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        let shown = values.filter_map(|value| on_axis(scale, value));
        let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        if low > high {
            return Self {
                scale,
                low: 0.0,
                high: 1.0,
            };
        }
        let least = match scale {
            Scale::Linear => (low.abs().max(high.abs()) * MIN_RELATIVE_SPAN).max(MIN_SPAN),
            Scale::Logarithmic => 0.1,
        };
        if high - low >= least {
            return Self { scale, low, high };
        }
        let half = match scale {
            // One value: around it, as far as a tenth of it.
            Scale::Linear if low == high => (0.1 * low.abs()).max(least),
            Scale::Linear | Scale::Logarithmic => least,
        };
        Self {
            scale,
            low: 0.5 * (low + high) - half,
            high: 0.5 * (low + high) + half,
        }
    }

    /// Makes sure that this value is shown.
    pub(super) fn with(self, value: f64) -> Self {
        let Some(value) = on_axis(self.scale, value) else {
            return self;
        };
        Self {
            low: self.low.min(value),
            high: self.high.max(value),
            ..self
        }
    }

    /// From high to low: a picture's rows are counted from the top.
    pub(super) fn flipped(self) -> Self {
        Self {
            low: self.high,
            high: self.low,
            ..self
        }
    }

    fn widened(self, part: f64) -> Self {
        let more = part * (self.high - self.low);
        Self {
            low: self.low - more,
            high: self.high + more,
            ..self
        }
    }

    /// Where a value lies from the low end (0) to the high one (1); `None` when it cannot be shown on this axis.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let value = on_axis(self.scale, value)?;
        Some((value - self.low) / (self.high - self.low))
    }

    /// Marks, about `wanted` of them with labels.
    pub(super) fn ticks(&self, wanted: usize) -> Ticks {
        match self.scale {
            Scale::Logarithmic if self.high - self.low > 0.7 => self.decades(wanted),
            Scale::Logarithmic => {
                let values = Self {
                    scale: Scale::Linear,
                    low: 10f64.powf(self.low),
                    high: 10f64.powf(self.high),
                };
                values.steps(wanted)
            }
            Scale::Linear => self.steps(wanted),
        }
    }

    /// Multiples of 1, 2 or 5 times a power of ten.
    fn steps(&self, wanted: usize) -> Ticks {
        let (low, high) = (self.low.min(self.high), self.low.max(self.high));
        // At least two, or nobody knows the scale.
        let parts = wanted.max(2) as f64;
        let step = nice_step((high - low) / parts);
        let first = (low / step).ceil();
        let step = if (first + 1.0) * step > high {
            nice_step(0.4 * step)
        } else {
            step
        };
        let first = (low / step).ceil();
        let count = ((high / step).floor() - first).clamp(0.0, 50.0) as usize;
        let values: Vec<f64> = (0..=count).map(|i| (first + i as f64) * step).collect();
        let (labels, factor) = labels(&values, step);
        let ticks = values.into_iter().zip(labels);
        Ticks {
            ticks: ticks.map(|(value, label)| Tick { value, label }).collect(),
            factor,
        }
    }

    /// Powers of ten, and what is between them where there is room.
    fn decades(&self, wanted: usize) -> Ticks {
        let (low, high) = (self.low.floor() as i32, self.high.ceil() as i32);
        let extent = self.high - self.low;
        let every = (extent / wanted.max(1) as f64).ceil().max(1.0) as i32;
        let mut ticks = Vec::new();
        let mut push = |value: f64, label: String| {
            if value > 0.0 && self.place(value).is_some_and(|at| (0.0..=1.0).contains(&at)) {
                ticks.push(Tick { value, label });
            }
        };
        for decade in (low..=high).filter(|decade| decade.rem_euclid(every) == 0) {
            let value = 10f64.powi(decade);
            push(value, power_label(decade, 1));
            if every > 1 || extent > MINOR_DECADES.0 {
                continue;
            }
            for digit in 2..=9 {
                let has_label = extent <= MINOR_DECADES.1 && (digit == 2 || digit == 5);
                let label = if has_label {
                    power_label(decade, digit)
                } else {
                    String::new()
                };
                push(f64::from(digit) * value, label);
            }
        }
        Ticks {
            ticks,
            factor: String::new(),
        }
    }
}

/// A value as it is placed along an axis.
fn on_axis(scale: Scale, value: f64) -> Option<f64> {
    match scale {
        Scale::Linear => is_drawable(value).then_some(value),
        Scale::Logarithmic => (value >= 1.0 / MAX_MAGNITUDE && is_drawable(value)).then(|| value.log10()),
    }
}

/// The least of 1, 2 and 5 times a power of ten that is not below (Heckbert 1990, "Nice numbers for graph labels").
pub(super) fn nice_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * power);
    // Rounding of the logarithm must not cost a step.
    steps
        .into_iter()
        .find(|step| *step >= least * (1.0 - 1e-9))
        .unwrap_or(10.0 * power)
}

/// A number with a few digits, as short as it goes.
pub(super) fn short(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 {
        return "0".to_owned();
    }
    if !(1e-4..1e6).contains(&magnitude) {
        let power = magnitude.log10().floor() as i32;
        // In two steps: ten to a great negative power is no number.
        let mantissa = value / 10f64.powi(power / 2) / 10f64.powi(power - power / 2);
        return format!("{}×10{}", trimmed(mantissa, 2), superscript(power));
    }
    let digits = (2 - magnitude.log10().floor() as i32).clamp(0, 6);
    trimmed(value, digits as usize)
}

/// Decimals without zeros at the end.
fn trimmed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    minus(if text == "-0" { "0" } else { text })
}

/// With a proper minus sign.
fn minus(text: &str) -> String {
    text.replace('-', "\u{2212}")
}

/// Labels of evenly spaced values, and the power of ten that all are multiples of.
fn labels(values: &[f64], step: f64) -> (Vec<String>, String) {
    let largest = values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let magnitude = if largest > 0.0 {
        largest.log10().floor() as i32
    } else {
        0
    };
    let power = if (-4..6).contains(&magnitude) { 0 } else { magnitude };
    let reduced = |value: f64| value / 10f64.powi(power / 2) / 10f64.powi(power - power / 2);
    let digits = (-(reduced(step).log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let labels = values.iter().map(|value| {
        let text = format!("{:.digits$}", reduced(*value));
        // Nothing but zeros has no sign.
        let is_zero = text.chars().all(|c| "-0.".contains(c));
        minus(if is_zero { text.trim_start_matches('-') } else { &text })
    });
    let factor = if power == 0 {
        String::new()
    } else {
        format!("×10{}", superscript(power))
    };
    (labels.collect(), factor)
}

/// Label of a digit times a power of ten.
fn power_label(power: i32, digit: i32) -> String {
    match power {
        -3..=-1 => trimmed(f64::from(digit) * 10f64.powi(power), 3),
        0..=4 => format!("{}", f64::from(digit) * 10f64.powi(power)),
        _ if digit == 1 => format!("10{}", superscript(power)),
        _ => format!("{digit}×10{}", superscript(power)),
    }
}

fn superscript(power: i32) -> String {
    let digit = |c: char| match c {
        '-' => '⁻',
        '0' => '⁰',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        _ => '⁹',
    };
    power.to_string().chars().map(digit).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn labelled(span: &Span, wanted: usize) -> Vec<String> {
        let ticks = span.ticks(wanted);
        let labels = ticks.ticks.into_iter().map(|tick| tick.label);
        let mut labels: Vec<String> = labels.filter(|label| !label.is_empty()).collect();
        labels.push(ticks.factor);
        labels
    }

    #[test]
    fn steps_are_one_two_and_five() {
        let span = |low: f64, high: f64| Span::of(Scale::Linear, [low, high].into_iter());
        assert_eq!(
            labelled(&span(0.0, 1.0), 5),
            ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0", ""]
        );
        assert_eq!(labelled(&span(-3.0, 7.0), 4), ["0", "5", ""]);
        assert_eq!(
            labelled(&span(-2e-7, 2e-7), 4),
            ["\u{2212}2", "\u{2212}1", "0", "1", "2", "×10⁻⁷"]
        );
        assert_eq!(labelled(&span(1e6, 1.04e6), 2), ["1.00", "1.02", "1.04", "×10⁶"]);
        assert_eq!(labelled(&span(0.0, 640.0), 6), ["0", "200", "400", "600", ""]);
    }

    #[test]
    fn logarithmic_axes_have_decades() {
        let span = |low: f64, high: f64| Span::of(Scale::Logarithmic, [low, high].into_iter());
        assert_eq!(
            labelled(&span(1e-3, 1e5), 10),
            ["0.001", "0.01", "0.1", "1", "10", "100", "1000", "10000", "10⁵", ""]
        );
        assert_eq!(labelled(&span(1.0, 20.0), 5), ["1", "2", "5", "10", "20", ""]);
        assert_eq!(labelled(&span(3.0, 4.0), 4), ["3.0", "3.5", "4.0", ""]);
        assert_eq!(span(1.0, 100.0).place(10.0), Some(0.5));
        assert_eq!(span(1.0, 100.0).place(0.0), None);
        assert_eq!(span(1.0, 100.0).place(-1.0), None);
    }

    #[test]
    fn an_axis_without_values_is_there_all_the_same() {
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let span = Span::around(scale, [f64::NAN, f64::INFINITY, -1e301].into_iter());
            assert!(!span.ticks(5).ticks.is_empty());
        }
    }

    #[test]
    fn short_numbers() {
        for (value, text) in [
            (0.0, "0"),
            (0.25, "0.25"),
            (-1234.56, "\u{2212}1235"),
            (0.000_012, "1.2×10⁻⁵"),
            (3e12, "3×10¹²"),
            (5e-324, "4.94×10⁻³²⁴"),
        ] {
            assert_eq!(short(value), text);
        }
    }

    proptest! {
        #[test]
        fn marks_are_on_the_axis_and_neither_many_nor_none(low: f64, high: f64, wanted in 1usize..12) {
            for scale in [Scale::Linear, Scale::Logarithmic] {
                let span = Span::around(scale, [low, high].into_iter());
                let ticks = span.ticks(wanted).ticks;
                let limit = match scale {
                    Scale::Linear => 2 * wanted + 4,
                    Scale::Logarithmic => 9 * (wanted + 5),
                };
                prop_assert!(ticks.len() <= limit, "{} {:?}", ticks.len(), span);
                for tick in ticks {
                    let place = span.place(tick.value).expect("a mark can be shown");
                    prop_assert!((-1e-6..=1.0 + 1e-6).contains(&place), "{} {:?}", place, span);
                }
                for value in [low, high] {
                    if let Some(place) = span.place(value) {
                        prop_assert!((0.0..=1.0).contains(&place), "{} {:?}", place, span);
                    }
                }
            }
        }

        #[test]
        fn a_step_is_at_most_twice_and_a_half_of_what_is_asked(power in -200f64..200.0) {
            let least = 10f64.powf(power);
            let step = nice_step(least);
            prop_assert!(step >= least * (1.0 - 1e-8) && step <= 2.5 * least * (1.0 + 1e-8));
        }
    }
}
