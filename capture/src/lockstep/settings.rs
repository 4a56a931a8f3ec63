//! What a [`super::Lockstep`] is told to do, and how it can be told wrong.

use super::auto_exposure::AutoExposureSettings;
use super::latency::LATENCY_MAX_FRAMES;
use super::tables::Tables;
use crate::controls::{ControlKind, ControlRanges, ControlValues};
use crate::source::CAMERAS_MAX;

/// Most exposures of a bracket.
pub const BRACKET_STEPS_MAX: u32 = 5;

/// Greatest offset of one camera's exposure, in steps.
pub const OFFSET_MAX_EV: f64 = 10.0;

/// What decides exposure and white balance.
#[derive(Debug, Clone, PartialEq)]
pub enum Mode {
    /// Nothing: they stay as they are.
    Locked,
    /// The leader's pictures; all cameras get the same.
    FollowLeader,
    /// The leader's pictures; each camera gets so many steps more.
    FixedRatio {
        /// Offset of each camera in steps, in their order, -10 to 10; negative is darker.
        offsets_ev: Vec<f64>,
    },
    /// The leader's pictures; one camera goes round several exposures about the common one, one each frame.
    Bracket {
        /// Index of that camera.
        camera: usize,
        /// Number of exposures, 2 to 5, from dark to bright.
        n_steps: u32,
        /// Distance of neighbours in steps, above 0 to 5.
        step_ev: f64,
    },
    /// Somebody: these values, in the leader's terms; the others match the leader.
    Manual {
        /// Exposure time in seconds, 1e-6 to 10; every camera keeps to it as far as it can.
        exposure_s: f64,
        /// Linear gain, 0.01 to 1000.
        gain: f64,
        /// White balance.
        white_balance: ManualWhiteBalance,
    },
}

/// A white balance that somebody chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ManualWhiteBalance {
    /// As the leader's table has it for this temperature in kelvin, 1000 to 40000; as it was if the leader has none.
    Kelvin(f64),
    /// Gains of red, green and blue, 0.01 to 100, in the colours that the cameras share; the cameras get as near as
    /// they can, the residual does the rest.
    Gains([f64; 3]),
}

/// Frequency of the mains that lamps hang on; they flicker at twice that.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mains {
    /// Lamps do not flicker.
    #[default]
    Steady,
    /// Exposure times are multiples of 1/100 s.
    Hz50,
    /// Exposure times are multiples of 1/120 s.
    Hz60,
}

impl Mains {
    /// Period of the flicker in seconds.
    #[must_use]
    pub fn flicker_period_s(self) -> Option<f64> {
        match self {
            Self::Steady => None,
            Self::Hz50 => Some(1.0 / 100.0),
            Self::Hz60 => Some(1.0 / 120.0),
        }
    }
}

/// Settings for all cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct LockstepSettings {
    /// Index of the camera whose pictures decide: the scene camera.
    pub leader: usize,
    /// What decides.
    pub mode: Mode,
    /// Longest exposure time in seconds, 1e-4 to 10; never longer than a camera's frame interval.
    pub max_exposure_s: f64,
    /// Lamps that flicker.
    pub mains: Mains,
    /// How exposure is chosen from the leader's pictures.
    pub auto_exposure: AutoExposureSettings,
    /// True to measure the latency of cameras that are not configured, with a few steps of half an exposure step.
    pub measure_latency: bool,
}

impl Default for LockstepSettings {
    fn default() -> Self {
        Self {
            leader: 0,
            mode: Mode::FollowLeader,
            max_exposure_s: 0.02,
            mains: Mains::Steady,
            auto_exposure: AutoExposureSettings::default(),
            measure_latency: true,
        }
    }
}

/// One camera, before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LockstepCamera {
    /// What its control values mean.
    pub tables: Tables,
    /// Controls that it has and may be driven.
    pub ranges: ControlRanges,
    /// Values read from the driver.
    pub values: ControlValues,
    /// Nominal frame interval in nanoseconds, above 0.
    pub interval_ns: u64,
    /// Frames of latency if known, 0 to 8; else they are measured.
    pub latency_frames: Option<u32>,
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LockstepError {
    /// No cameras, or too many.
    #[error("cannot keep `{found}` cameras in step (allowed: 1 to {CAMERAS_MAX})")]
    Cameras {
        /// Number of cameras.
        found: usize,
    },
    /// An index that no camera has.
    #[error("`{key}` is camera `{found}` (allowed: 0 to {greatest})")]
    NoSuchCamera {
        /// Which setting.
        key: &'static str,
        /// The index found.
        found: usize,
        /// Greatest index there is.
        greatest: usize,
    },
    /// A number is out of range.
    #[error("`{key}` is `{found}` (allowed: {allowed})")]
    Value {
        /// Which setting.
        key: &'static str,
        /// The value found.
        found: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// Not one offset per camera.
    #[error("`offsets_ev` has `{found}` values (allowed: {expected}, one per camera)")]
    Offsets {
        /// Number of offsets.
        found: usize,
        /// Number of cameras.
        expected: usize,
    },
    /// A control's range has no values or no step.
    #[error(
        "camera `{camera}` has {kind:?} from `{minimum}` to `{maximum}` in steps of `{step}` (allowed: rising, above 0)"
    )]
    Range {
        /// Index of the camera.
        camera: usize,
        /// The control.
        kind: ControlKind,
        /// Least value.
        minimum: i64,
        /// Greatest value.
        maximum: i64,
        /// Step.
        step: i64,
    },
}

impl LockstepError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Cameras { .. } | Self::NoSuchCamera { .. } => "cameras are counted from 0 in the order of the source",
            Self::Value { .. } => "times are in seconds, offsets in exposure steps (EV), gains linear",
            Self::Offsets { .. } => "give 0 to the leader and to cameras that follow it",
            Self::Range { .. } => "the driver gives a range that cannot be; leave this control out",
        }
    }
}

fn check(key: &'static str, found: f64, least: f64, greatest: f64, allowed: &'static str) -> Result<(), LockstepError> {
    if found >= least && found <= greatest {
        Ok(())
    } else {
        Err(LockstepError::Value { key, found, allowed })
    }
}

pub(super) fn check_camera_index(key: &'static str, found: usize, n_cameras: usize) -> Result<(), LockstepError> {
    if found < n_cameras {
        Ok(())
    } else {
        let greatest = n_cameras.saturating_sub(1);
        Err(LockstepError::NoSuchCamera { key, found, greatest })
    }
}

pub(super) fn check_mode(mode: &Mode, n_cameras: usize) -> Result<(), LockstepError> {
    match mode {
        Mode::Locked | Mode::FollowLeader => Ok(()),
        Mode::FixedRatio { offsets_ev } => {
            if offsets_ev.len() != n_cameras {
                let found = offsets_ev.len();
                return Err(LockstepError::Offsets {
                    found,
                    expected: n_cameras,
                });
            }
            let check = |offset: &f64| check("offsets_ev", *offset, -OFFSET_MAX_EV, OFFSET_MAX_EV, "-10 to 10");
            offsets_ev.iter().try_for_each(check)
        }
        Mode::Bracket {
            camera,
            n_steps,
            step_ev,
        } => {
            check_camera_index("bracket camera", *camera, n_cameras)?;
            check(
                "n_steps",
                f64::from(*n_steps),
                2.0,
                f64::from(BRACKET_STEPS_MAX),
                "2 to 5",
            )?;
            check("step_ev", *step_ev, 0.01, 5.0, "0.01 to 5")
        }
        Mode::Manual {
            exposure_s,
            gain,
            white_balance,
        } => {
            check("exposure_s", *exposure_s, 1e-6, 10.0, "1e-6 to 10 s")?;
            check("gain", *gain, 0.01, 1000.0, "0.01 to 1000, linear")?;
            match white_balance {
                ManualWhiteBalance::Kelvin(kelvin) => check("kelvin", *kelvin, 1000.0, 40_000.0, "1000 to 40000 K"),
                ManualWhiteBalance::Gains(gains) => gains
                    .iter()
                    .try_for_each(|gain| check("white balance gain", *gain, 0.01, 100.0, "0.01 to 100, linear")),
            }
        }
    }
}

pub(super) fn check_settings(settings: &LockstepSettings, cameras: &[LockstepCamera]) -> Result<(), LockstepError> {
    if !(1..=CAMERAS_MAX).contains(&cameras.len()) {
        return Err(LockstepError::Cameras { found: cameras.len() });
    }
    check_camera_index("leader", settings.leader, cameras.len())?;
    check_mode(&settings.mode, cameras.len())?;
    check("max_exposure_s", settings.max_exposure_s, 1e-4, 10.0, "1e-4 to 10 s")?;
    let auto = &settings.auto_exposure;
    check("key", auto.key, 0.01, 0.9, "0.01 to 0.9")?;
    check("highlight_drop_max_ev", auto.highlight_drop_max_ev, 0.0, 4.0, "0 to 4")?;
    check("dead_band_ev", auto.dead_band_ev, 0.02, 1.0, "0.02 to 1")?;
    check("settle_s", auto.settle_s, 0.01, 10.0, "0.01 to 10 s")?;
    cameras
        .iter()
        .enumerate()
        .try_for_each(|(index, camera)| check_camera(index, camera))
}

fn check_camera(index: usize, camera: &LockstepCamera) -> Result<(), LockstepError> {
    check("interval_ns", camera.interval_ns as f64, 1e5, 1e11, "1e5 to 1e11 ns")?;
    let latency = f64::from(camera.latency_frames.unwrap_or(0));
    check("latency_frames", latency, 0.0, f64::from(LATENCY_MAX_FRAMES), "0 to 8")?;
    for (kind, range) in camera.ranges.iter() {
        // Values of this size are exact as floating-point numbers, and their differences do not overflow.
        let is_sane = |value: i64| value.unsigned_abs() < 1 << 52;
        let (minimum, maximum, step) = (range.minimum, range.maximum, range.step);
        if step < 1 || maximum < minimum || ![minimum, maximum, step].into_iter().all(is_sane) {
            return Err(LockstepError::Range {
                camera: index,
                kind,
                minimum,
                maximum,
                step,
            });
        }
    }
    Ok(())
}
