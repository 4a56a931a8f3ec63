//! The controls of a camera that decide how bright and in what colour it sees, in the camera's own units.

/// A control that the daemon drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum ControlKind {
    /// Exposure time; for UVC cameras in steps of 100 µs.
    ExposureTime,
    /// Gain, in steps that only the camera's table explains.
    Gain,
    /// White balance as a colour temperature in kelvin.
    WhiteBalanceTemperature,
    /// Gain of red, where the camera has separate ones.
    RedBalance,
    /// Gain of blue, where the camera has separate ones.
    BlueBalance,
}

impl ControlKind {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::ExposureTime,
        Self::Gain,
        Self::WhiteBalanceTemperature,
        Self::RedBalance,
        Self::BlueBalance,
    ];
}

/// What values a control takes: `minimum`, `minimum + step`, ... up to `maximum`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlRange {
    /// Least value.
    pub minimum: i64,
    /// Greatest value.
    pub maximum: i64,
    /// Distance between values, above 0.
    pub step: i64,
    /// Value after power-on.
    pub default: i64,
}

impl ControlRange {
    /// The allowed value nearest to `value`.
    #[must_use]
    pub fn nearest(&self, value: f64) -> i64 {
        let steps = ((value - self.minimum as f64) / self.step as f64).round().max(0.0) as i64;
        let greatest = (self.maximum - self.minimum) / self.step;
        self.minimum + self.step * steps.min(greatest)
    }
}

/// One thing or none for each control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PerControl<T>([Option<T>; 5]);

impl<T> Default for PerControl<T> {
    fn default() -> Self {
        Self([None, None, None, None, None])
    }
}

impl<T: Copy> PerControl<T> {
    /// What there is for this control.
    #[must_use]
    pub fn get(&self, kind: ControlKind) -> Option<T> {
        self.0[kind as usize]
    }

    /// Puts something there for this control.
    pub fn set(&mut self, kind: ControlKind, value: T) {
        self.0[kind as usize] = Some(value);
    }

    /// Takes over all there is in `newer`.
    pub fn merge(&mut self, newer: &Self) {
        for (kind, value) in newer.iter() {
            self.set(kind, value);
        }
    }

    /// All there is, in the order of [`ControlKind::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (ControlKind, T)> + '_ {
        ControlKind::ALL
            .into_iter()
            .filter_map(|kind| Some((kind, self.get(kind)?)))
    }
}

/// Values of controls.
pub type ControlValues = PerControl<i64>;

/// Ranges of the controls that a camera has.
pub type ControlRanges = PerControl<ControlRange>;
