//! The controls of a camera: which there are, taking them over from the camera's own automatics, setting them.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use v4l::v4l_sys as sys;

use super::control_list::{ControlDescription, has_number, list};
use super::error::ControlError;
use super::ioctl::{Node, RawControl};
use crate::controls::{ControlKind, ControlRange, ControlRanges, ControlValues, PerControl};

/// The unit of `V4L2_CID_EXPOSURE_ABSOLUTE` in seconds.
const EXPOSURE_UNIT_S: f64 = 100e-6;

/// Something that the camera adjusts by itself, if it is let.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum AutoMode {
    /// Exposure time.
    Exposure,
    /// Fewer frames per second in dim light (`exposure_dynamic_framerate`).
    FrameRate,
    /// Gain.
    Gain,
    /// White balance.
    WhiteBalance,
    /// Focus, and with it the lens model.
    Focus,
}

impl AutoMode {
    /// All of them, in the order in which they are switched off.
    pub const ALL: [Self; 5] = [
        Self::FrameRate,
        Self::Exposure,
        Self::Gain,
        Self::WhiteBalance,
        Self::Focus,
    ];

    fn id(self) -> u32 {
        match self {
            Self::Exposure => sys::V4L2_CID_EXPOSURE_AUTO,
            Self::FrameRate => sys::V4L2_CID_EXPOSURE_AUTO_PRIORITY,
            Self::Gain => sys::V4L2_CID_AUTOGAIN,
            Self::WhiteBalance => sys::V4L2_CID_AUTO_WHITE_BALANCE,
            Self::Focus => sys::V4L2_CID_FOCUS_AUTO,
        }
    }

    /// Values that leave our controls alone, the most wanted first.
    ///
    /// Exposure is a menu: some cameras have no manual mode but one with priority of the shutter, which is as good as
    /// their aperture is fixed.
    fn off_values(self) -> &'static [i64] {
        const MANUAL: i64 = sys::v4l2_exposure_auto_type_V4L2_EXPOSURE_MANUAL as i64;
        const SHUTTER: i64 = sys::v4l2_exposure_auto_type_V4L2_EXPOSURE_SHUTTER_PRIORITY as i64;
        match self {
            Self::Exposure => &[MANUAL, SHUTTER],
            Self::FrameRate | Self::Gain | Self::WhiteBalance | Self::Focus => &[0],
        }
    }

    /// True if this value of its control leaves our controls alone.
    #[must_use]
    pub fn is_off(self, value: i64) -> bool {
        self.off_values().contains(&value)
    }
}

impl fmt::Display for AutoMode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Exposure => "automatic exposure",
            Self::FrameRate => "frame rate lowered for exposure",
            Self::Gain => "automatic gain",
            Self::WhiteBalance => "automatic white balance",
            Self::Focus => "automatic focus",
        })
    }
}

/// What the camera does against the flicker of lamps. Exposure times are ours, so it matters to cameras only that
/// go on adjusting something by themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PowerLine {
    /// Nothing.
    Off,
    /// Mains of 50 Hz.
    Hz50,
    /// Mains of 60 Hz.
    Hz60,
}

impl PowerLine {
    fn value(self) -> i64 {
        (match self {
            Self::Off => sys::v4l2_power_line_frequency_V4L2_CID_POWER_LINE_FREQUENCY_DISABLED,
            Self::Hz50 => sys::v4l2_power_line_frequency_V4L2_CID_POWER_LINE_FREQUENCY_50HZ,
            Self::Hz60 => sys::v4l2_power_line_frequency_V4L2_CID_POWER_LINE_FREQUENCY_60HZ,
        })
        .into()
    }
}

/// A control that events tell about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watched {
    /// One of those that the daemon drives.
    Control(ControlKind),
    /// An automatic mode; [`AutoMode::is_off`] explains the value.
    Auto(AutoMode),
}

/// A control that somebody else changed: another program, or the camera itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlChange {
    /// Which.
    pub what: Watched,
    /// Its value now.
    pub value: i64,
}

impl ControlChange {
    /// The automatic mode that was switched on behind our back, if that is what happened.
    #[must_use]
    pub fn switched_on(&self) -> Option<AutoMode> {
        match self.what {
            Watched::Auto(mode) if !mode.is_off(self.value) => Some(mode),
            Watched::Auto(_) | Watched::Control(_) => None,
        }
    }
}

/// The controls of an open camera. May be used on another thread than its stream; what it sets makes no events there.
#[derive(Debug, Clone)]
pub struct V4l2Controls {
    node: Arc<Node>,
    driven: Vec<(ControlKind, RawControl)>,
    autos: Vec<(AutoMode, RawControl)>,
    power_line: Option<RawControl>,
    ranges: ControlRanges,
}

/// Numbers under which a control may be found, the most wanted first.
fn ids(kind: ControlKind) -> &'static [u32] {
    match kind {
        // `V4L2_CID_EXPOSURE` has no unit and is not taken: nothing could be translated between cameras.
        ControlKind::ExposureTime => &[sys::V4L2_CID_EXPOSURE_ABSOLUTE],
        ControlKind::Gain => &[sys::V4L2_CID_GAIN, sys::V4L2_CID_ANALOGUE_GAIN],
        ControlKind::WhiteBalanceTemperature => &[sys::V4L2_CID_WHITE_BALANCE_TEMPERATURE],
        ControlKind::RedBalance => &[sys::V4L2_CID_RED_BALANCE],
        ControlKind::BlueBalance => &[sys::V4L2_CID_BLUE_BALANCE],
    }
}

impl V4l2Controls {
    /// Asks the driver which of our controls it has.
    pub(super) fn find(node: Arc<Node>) -> Result<Self, ControlError> {
        let usable = |id: u32| {
            let found = node
                .control(id)
                .map_err(|error| ControlError::from_access(node.path(), &"controls", error))?;
            Ok(found.filter(is_settable))
        };
        let mut driven = Vec::new();
        let mut ranges = ControlRanges::default();
        for kind in ControlKind::ALL {
            for id in ids(kind) {
                let Some(control) = usable(*id)? else { continue };
                ranges.set(kind, range(&control));
                driven.push((kind, control));
                break;
            }
        }
        let mut autos = Vec::new();
        for mode in AutoMode::ALL {
            autos.extend(usable(mode.id())?.map(|control| (mode, control)));
        }
        let power_line = usable(sys::V4L2_CID_POWER_LINE_FREQUENCY)?;
        Ok(Self {
            node,
            driven,
            autos,
            power_line,
            ranges,
        })
    }

    /// Ranges of the controls that there are, in the camera's own units.
    #[must_use]
    pub fn ranges(&self) -> &ControlRanges {
        &self.ranges
    }

    /// Seconds per step of the exposure time; none for a camera without that control.
    #[must_use]
    pub fn exposure_unit_s(&self) -> Option<f64> {
        self.ranges.get(ControlKind::ExposureTime).map(|_| EXPOSURE_UNIT_S)
    }

    /// Takes exposure, gain, white balance and focus from the camera's own automatics and keeps its frame rate steady.
    /// Returns the modes that the camera has.
    ///
    /// # Errors
    ///
    /// A mode that stays on.
    pub fn take_manual(&self, power_line: PowerLine) -> Result<Vec<AutoMode>, ControlError> {
        for (mode, control) in &self.autos {
            self.switch_off(*mode, control)?;
        }
        if let Some(control) = &self.power_line
            && let Err(source) = self.node.set_value(control, power_line.value())
        {
            // A camera without this frequency: nothing of ours depends on it.
            tracing::warn!(
                "camera `{}` does not take the mains frequency: {source}",
                self.path().display()
            );
        }
        Ok(self.autos.iter().map(|(mode, _)| *mode).collect())
    }

    fn switch_off(&self, mode: AutoMode, control: &RawControl) -> Result<(), ControlError> {
        let mut refusal = None;
        for value in mode.off_values() {
            match self.node.set_value(control, *value) {
                Ok(()) => return Ok(()),
                Err(error) => refusal = Some(error),
            }
        }
        let source = refusal.expect("each mode has a value for off");
        Err(match source.raw_os_error() {
            Some(libc::EINVAL | libc::ERANGE) => ControlError::AutoStays {
                path: self.path().into(),
                mode,
                source,
            },
            _ => ControlError::from_access(self.path(), &mode, source),
        })
    }

    /// The automatic modes that are on.
    ///
    /// # Errors
    ///
    /// The camera is gone or does not answer.
    pub fn modes_on(&self) -> Result<Vec<AutoMode>, ControlError> {
        let mut on = Vec::new();
        for (mode, control) in &self.autos {
            let value = self.node.value(control);
            let value = value.map_err(|error| ControlError::from_access(self.path(), mode, error))?;
            if !mode.is_off(value) {
                on.push(*mode);
            }
        }
        Ok(on)
    }

    /// Sets controls one after the other and returns the values that the camera then has.
    ///
    /// # Errors
    ///
    /// The first control that was refused, with its range where that is the reason; those before it are set, those
    /// after it are not. Values are checked against all ranges before anything is set.
    pub fn set(&self, wanted: &ControlValues) -> Result<ControlValues, ControlError> {
        for (kind, value) in wanted.iter() {
            self.check(kind, value)?;
        }
        let mut now = ControlValues::default();
        for (kind, value) in wanted.iter() {
            let control = self.driven(kind)?;
            self.node
                .set_value(control, value)
                .map_err(|error| self.refusal(kind, value, error))?;
        }
        for (kind, _) in wanted.iter() {
            now.set(kind, self.value(kind)?);
        }
        Ok(now)
    }

    /// Values of all controls that there are.
    ///
    /// # Errors
    ///
    /// The camera is gone or does not answer.
    pub fn read(&self) -> Result<ControlValues, ControlError> {
        let mut now = PerControl::default();
        for (kind, _) in &self.driven {
            now.set(*kind, self.value(*kind)?);
        }
        Ok(now)
    }

    fn value(&self, kind: ControlKind) -> Result<i64, ControlError> {
        let value = self.node.value(self.driven(kind)?);
        value.map_err(|error| ControlError::from_access(self.path(), &kind, error))
    }

    fn driven(&self, kind: ControlKind) -> Result<&RawControl, ControlError> {
        let found = self.driven.iter().find(|(driven, _)| *driven == kind);
        found.map(|(_, control)| control).ok_or_else(|| ControlError::Missing {
            path: self.path().into(),
            kind,
        })
    }

    fn check(&self, kind: ControlKind, value: i64) -> Result<(), ControlError> {
        let path = self.path();
        let range = self.ranges.get(kind).ok_or_else(|| ControlError::Missing {
            path: path.into(),
            kind,
        })?;
        if admits(&range, value) {
            return Ok(());
        }
        Err(ControlError::OutOfRange {
            path: path.into(),
            kind,
            value,
            range,
        })
    }

    fn refusal(&self, kind: ControlKind, value: i64, error: std::io::Error) -> ControlError {
        let path = self.path().to_path_buf();
        match (error.raw_os_error(), self.ranges.get(kind)) {
            (Some(libc::EACCES), _) => ControlError::AutoStillOn { path, kind },
            (Some(libc::ERANGE), Some(range)) => ControlError::OutOfRange {
                path,
                kind,
                value,
                range,
            },
            _ => ControlError::from_access(&path, &format_args!("{kind} (`{value}`)"), error),
        }
    }

    /// Every control of the camera, for people to read.
    ///
    /// # Errors
    ///
    /// The camera is gone.
    pub fn list(&self) -> Result<Vec<ControlDescription>, ControlError> {
        list(&self.node).map_err(|error| ControlError::from_access(self.path(), &"controls", error))
    }

    /// Asks for an event when somebody else changes one of our controls; says which there are.
    pub(super) fn watch(&self) -> Vec<(u32, Watched)> {
        let driven = self
            .driven
            .iter()
            .map(|(kind, control)| (control.id, Watched::Control(*kind)));
        let autos = self
            .autos
            .iter()
            .map(|(mode, control)| (control.id, Watched::Auto(*mode)));
        // A driver without events has nothing to tell.
        driven
            .chain(autos)
            .filter(|(id, _)| self.node.subscribe(*id).is_ok())
            .collect()
    }

    /// The device node that it belongs to.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.node.path()
    }
}

fn is_settable(control: &RawControl) -> bool {
    let hindrances = sys::V4L2_CTRL_FLAG_DISABLED | sys::V4L2_CTRL_FLAG_READ_ONLY;
    control.flags & hindrances == 0 && has_number(control)
}

fn range(control: &RawControl) -> ControlRange {
    ControlRange {
        minimum: control.minimum,
        maximum: control.maximum,
        step: i64::try_from(control.step).unwrap_or(i64::MAX).max(1),
        default: control.default,
    }
}

fn admits(range: &ControlRange, value: i64) -> bool {
    (range.minimum..=range.maximum).contains(&value)
        && value.abs_diff(range.minimum).is_multiple_of(range.step.unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_values_on_the_grid_are_admitted() {
        let range = ControlRange {
            minimum: 3,
            maximum: 2047,
            step: 4,
            default: 7,
        };
        for (value, is_admitted) in [
            (3, true),
            (7, true),
            (2047, true),
            (4, false),
            (2, false),
            (2051, false),
        ] {
            assert_eq!(admits(&range, value), is_admitted, "{value}");
        }
        let widest = ControlRange {
            minimum: i64::MIN,
            maximum: i64::MAX,
            step: 1,
            default: 0,
        };
        assert!(admits(&widest, i64::MAX));
    }

    #[test]
    fn modes_switched_on_are_told_from_other_changes() {
        let change = |what, value| ControlChange { what, value }.switched_on();
        assert_eq!(
            change(Watched::Auto(AutoMode::WhiteBalance), 1),
            Some(AutoMode::WhiteBalance)
        );
        assert_eq!(change(Watched::Auto(AutoMode::WhiteBalance), 0), None);
        // Aperture priority is what UVC cameras call automatic; 1 and 2 leave the exposure time to us.
        assert_eq!(change(Watched::Auto(AutoMode::Exposure), 3), Some(AutoMode::Exposure));
        assert_eq!(change(Watched::Auto(AutoMode::Exposure), 1), None);
        assert_eq!(change(Watched::Control(ControlKind::Gain), 1), None);
    }
}
