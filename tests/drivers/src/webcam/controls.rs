//! The webcam's controls, as UVC requests get and set them.
//!
//! UVC 1.1, section 4.2.2: camera terminal controls (4.2.2.1) and processing unit controls (4.2.2.3); request error
//! codes in 4.2.1.2; capabilities of `GET_INFO` in table 4-3.

use super::descriptors::{CAMERA_TERMINAL, PROCESSING_UNIT};

/// A control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Bitmap with one bit set: [`MANUAL`] or [`APERTURE_PRIORITY`] (exposure time automatic).
    ExposureMode,
    /// 1 when automatic exposure may lower the frame rate; accepted, without effect here.
    ExposurePriority,
    /// Exposure time, in units of 100 µs.
    ExposureTime,
    /// Offset added to pixel codes.
    Brightness,
    /// Gain, in units of the webcam's own.
    Gain,
    /// 0 off, 1 for 50 Hz, 2 for 60 Hz; accepted, without effect here.
    PowerLineFrequency,
    /// Colour temperature that is taken for white, in kelvin.
    WhiteBalance,
    /// 1 when the webcam finds the white balance by itself.
    WhiteBalanceAuto,
}

/// Exposure mode in which the time is set by the user.
pub const MANUAL: i32 = 1;
/// Exposure mode in which the webcam sets the time.
pub const APERTURE_PRIORITY: i32 = 8;

/// All controls, in the order of their declaration.
pub const CONTROLS: [Control; 8] = [
    Control::ExposureMode,
    Control::ExposurePriority,
    Control::ExposureTime,
    Control::Brightness,
    Control::Gain,
    Control::PowerLineFrequency,
    Control::WhiteBalance,
    Control::WhiteBalanceAuto,
];

/// Why a request was refused (UVC 1.1, 4.2.1.2); the number goes over the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Refusal {
    /// The webcam is busy.
    NotReady = 1,
    /// Not in this state: the automatic is on.
    WrongState = 2,
    /// Value out of range.
    OutOfRange = 4,
    /// No such control.
    InvalidControl = 6,
    /// No such request for the control.
    InvalidRequest = 7,
}

/// Allowed values of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range {
    /// Least value.
    pub minimum: i32,
    /// Greatest value.
    pub maximum: i32,
    /// Distance between allowed values.
    pub step: i32,
    /// Value after plugging in.
    pub default: i32,
}

/// Ranges in which webcams differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControlRanges {
    /// Exposure time in units of 100 µs.
    pub exposure_100us: Range,
    /// Gain, in units of the webcam's own.
    pub gain: Range,
    /// White balance in kelvin.
    pub white_balance_k: Range,
}

impl Default for ControlRanges {
    /// As of a common webcam: 0.1 to 500 ms in steps of 0.1 ms, gain 0 to 100, white balance 2800 to 7500 K in steps
    /// of 10 K.
    fn default() -> Self {
        Self {
            exposure_100us: Range {
                minimum: 1,
                maximum: 5000,
                step: 1,
                default: 156,
            },
            gain: Range {
                minimum: 0,
                maximum: 100,
                step: 1,
                default: 0,
            },
            white_balance_k: Range {
                minimum: 2800,
                maximum: 7500,
                step: 10,
                default: 4600,
            },
        }
    }
}

/// A webcam's controls and their present values.
#[derive(Clone, Debug)]
pub struct Controls {
    ranges: ControlRanges,
    values: [i32; CONTROLS.len()],
    stalled: [Option<u8>; CONTROLS.len()],
    last_error: u8,
}

impl Controls {
    /// Controls at their defaults: both automatics on, as webcams wake up.
    pub fn new(ranges: ControlRanges) -> Self {
        let mut controls = Self {
            ranges,
            values: [0; CONTROLS.len()],
            stalled: [None; CONTROLS.len()],
            last_error: 0,
        };
        controls.reset();
        controls
    }

    /// Sets all values to their defaults, as pulling the plug does. Stalls stay: they are the test's.
    pub fn reset(&mut self) {
        for control in CONTROLS {
            self.values[control as usize] = self.range(control).default;
        }
        self.last_error = 0;
    }

    /// The present value.
    pub fn get(&self, control: Control) -> i32 {
        self.values[control as usize]
    }

    /// Sets a value from inside the webcam: its automatics, or a fault. Clamped to the range.
    pub fn set(&mut self, control: Control, value: i32) {
        let range = self.range(control);
        self.values[control as usize] = value.clamp(range.minimum, range.maximum);
    }

    /// Makes every `SET_CUR` of a control stall with this error code from now on; `None` ends it.
    pub fn stall(&mut self, control: Control, error_code: Option<u8>) {
        self.stalled[control as usize] = error_code;
    }

    /// Whether the webcam sets the exposure by itself.
    pub fn exposure_is_automatic(&self) -> bool {
        self.get(Control::ExposureMode) != MANUAL
    }

    /// Whether the webcam sets the white balance by itself.
    pub fn white_balance_is_automatic(&self) -> bool {
        self.get(Control::WhiteBalanceAuto) != 0
    }

    /// Allowed values of a control.
    pub fn range(&self, control: Control) -> Range {
        match control {
            // For this bitmap the step is the set of modes that there are.
            Control::ExposureMode => {
                let step = MANUAL | APERTURE_PRIORITY;
                Range {
                    minimum: MANUAL,
                    maximum: APERTURE_PRIORITY,
                    step,
                    default: APERTURE_PRIORITY,
                }
            }
            Control::ExposurePriority => Range {
                minimum: 0,
                maximum: 1,
                step: 1,
                default: 0,
            },
            Control::ExposureTime => self.ranges.exposure_100us,
            Control::Brightness => Range {
                minimum: -64,
                maximum: 64,
                step: 1,
                default: 0,
            },
            Control::Gain => self.ranges.gain,
            Control::PowerLineFrequency => Range {
                minimum: 0,
                maximum: 2,
                step: 1,
                default: 1,
            },
            Control::WhiteBalance => self.ranges.white_balance_k,
            Control::WhiteBalanceAuto => Range {
                minimum: 0,
                maximum: 1,
                step: 1,
                default: 1,
            },
        }
    }

    /// Answers a class request to `entity`: what to send back (empty after `SET_CUR`), `None` for a stall. Why it
    /// stalled is what [`Controls::last_error`] says next.
    pub fn answer(&mut self, request: u8, (entity, selector): (u8, u8), data: &[u8]) -> Option<Vec<u8>> {
        let answer = match control_at(entity, selector) {
            None => Err(Refusal::InvalidControl as u8),
            Some(control) if request == SET_CUR => self.set_cur(control, data).map(|()| Vec::new()),
            Some(control) => self.get_request(request, control),
        };
        match answer {
            Ok(bytes) => {
                self.last_error = 0;
                Some(bytes)
            }
            Err(code) => {
                self.last_error = code;
                None
            }
        }
    }

    /// The request error code of the last request: 0 when it was done.
    pub fn last_error(&self) -> u8 {
        self.last_error
    }

    fn get_request(&self, request: u8, control: Control) -> Result<Vec<u8>, u8> {
        let range = self.range(control);
        let value = match request {
            GET_CUR => self.get(control),
            GET_MIN => range.minimum,
            GET_MAX => range.maximum,
            GET_RES => range.step,
            GET_DEF => range.default,
            GET_LEN => return Ok(vec![control.size() as u8, 0]),
            GET_INFO => return Ok(vec![control.capabilities()]),
            _ => return Err(Refusal::InvalidRequest as u8),
        };
        Ok(value.to_le_bytes()[..control.size()].to_vec())
    }

    fn set_cur(&mut self, control: Control, data: &[u8]) -> Result<(), u8> {
        if let Some(code) = self.stalled[control as usize] {
            return Err(code);
        }
        let locked = match control {
            Control::ExposureTime => self.exposure_is_automatic(),
            Control::WhiteBalance => self.white_balance_is_automatic(),
            Control::ExposureMode
            | Control::ExposurePriority
            | Control::Brightness
            | Control::Gain
            | Control::PowerLineFrequency
            | Control::WhiteBalanceAuto => false,
        };
        if locked {
            return Err(Refusal::WrongState as u8);
        }
        let value = control.decode(data).ok_or(Refusal::OutOfRange as u8)?;
        let range = self.range(control);
        let in_range = match control {
            Control::ExposureMode => value == MANUAL || value == APERTURE_PRIORITY,
            _ => (range.minimum..=range.maximum).contains(&value),
        };
        if !in_range {
            return Err(Refusal::OutOfRange as u8);
        }
        let step = range.step.max(1);
        let stepped = range.minimum + (value - range.minimum) / step * step;
        self.values[control as usize] = if control == Control::ExposureMode {
            value
        } else {
            stepped
        };
        Ok(())
    }
}

/// Request that sets the current value.
pub const SET_CUR: u8 = 0x01;
/// Request for the current value.
pub const GET_CUR: u8 = 0x81;
/// Request for the least value.
pub const GET_MIN: u8 = 0x82;
/// Request for the greatest value.
pub const GET_MAX: u8 = 0x83;
/// Request for the step.
pub const GET_RES: u8 = 0x84;
/// Request for the length of a value in bytes.
pub const GET_LEN: u8 = 0x85;
/// Request for what can be done with the control.
pub const GET_INFO: u8 = 0x86;
/// Request for the default value.
pub const GET_DEF: u8 = 0x87;

impl Control {
    /// Length of its values on the cable, in bytes.
    fn size(self) -> usize {
        match self {
            Control::ExposureTime => 4,
            Control::Brightness | Control::Gain | Control::WhiteBalance => 2,
            Control::ExposureMode
            | Control::ExposurePriority
            | Control::PowerLineFrequency
            | Control::WhiteBalanceAuto => 1,
        }
    }

    /// Get and set; what an automatic may change is marked so, or the driver would answer from its cache for ever.
    fn capabilities(self) -> u8 {
        match self {
            Control::ExposureTime | Control::WhiteBalance => 0b1011,
            Control::ExposureMode
            | Control::ExposurePriority
            | Control::Brightness
            | Control::Gain
            | Control::PowerLineFrequency
            | Control::WhiteBalanceAuto => 0b0011,
        }
    }

    fn decode(self, data: &[u8]) -> Option<i32> {
        let data = data.get(..self.size())?;
        Some(match (self, data) {
            (Control::Brightness, &[a, b]) => i32::from(i16::from_le_bytes([a, b])),
            (_, &[a]) => i32::from(a),
            (_, &[a, b]) => i32::from(u16::from_le_bytes([a, b])),
            (_, &[a, b, c, d]) => i32::from_le_bytes([a, b, c, d]),
            _ => return None,
        })
    }
}

/// Selectors of UVC 1.1, tables A-12 (camera terminal) and A-13 (processing unit).
fn control_at(entity: u8, selector: u8) -> Option<Control> {
    Some(match (entity, selector) {
        (CAMERA_TERMINAL, 0x02) => Control::ExposureMode,
        (CAMERA_TERMINAL, 0x03) => Control::ExposurePriority,
        (CAMERA_TERMINAL, 0x04) => Control::ExposureTime,
        (PROCESSING_UNIT, 0x02) => Control::Brightness,
        (PROCESSING_UNIT, 0x04) => Control::Gain,
        (PROCESSING_UNIT, 0x05) => Control::PowerLineFrequency,
        (PROCESSING_UNIT, 0x0A) => Control::WhiteBalance,
        (PROCESSING_UNIT, 0x0B) => Control::WhiteBalanceAuto,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPOSURE_MODE: (u8, u8) = (CAMERA_TERMINAL, 2);
    const EXPOSURE_TIME: (u8, u8) = (CAMERA_TERMINAL, 4);
    const WHITE_BALANCE: (u8, u8) = (PROCESSING_UNIT, 0x0A);

    fn manual() -> Controls {
        let mut controls = Controls::new(ControlRanges::default());
        assert!(controls.answer(SET_CUR, EXPOSURE_MODE, &[1]).is_some());
        controls
    }

    #[test]
    fn a_value_that_was_set_is_read_back() {
        let mut controls = manual();
        assert_eq!(
            controls.answer(SET_CUR, EXPOSURE_TIME, &80_i32.to_le_bytes()),
            Some(vec![])
        );
        assert_eq!(
            controls.answer(GET_CUR, EXPOSURE_TIME, &[]),
            Some(80_i32.to_le_bytes().to_vec())
        );
        assert_eq!(controls.answer(GET_LEN, EXPOSURE_TIME, &[]), Some(vec![4, 0]));
        assert_eq!(controls.answer(GET_RES, EXPOSURE_MODE, &[]), Some(vec![9]));
        let brightness = (PROCESSING_UNIT, 2);
        assert!(controls.answer(SET_CUR, brightness, &(-5_i16).to_le_bytes()).is_some());
        assert_eq!(controls.get(Control::Brightness), -5);
    }

    #[test]
    fn refusals_have_the_codes_of_the_specification() {
        let mut controls = Controls::new(ControlRanges::default());
        assert_eq!(controls.answer(SET_CUR, EXPOSURE_TIME, &80_i32.to_le_bytes()), None);
        assert_eq!(controls.last_error(), Refusal::WrongState as u8);
        assert_eq!(controls.answer(GET_CUR, (9, 9), &[]), None);
        assert_eq!(controls.last_error(), Refusal::InvalidControl as u8);
        assert_eq!(controls.answer(0x77, WHITE_BALANCE, &[]), None);
        assert_eq!(controls.last_error(), Refusal::InvalidRequest as u8);
        let mut controls = manual();
        for bytes in [&0_i32.to_le_bytes()[..], &5001_i32.to_le_bytes(), &[1, 0]] {
            assert_eq!(controls.answer(SET_CUR, EXPOSURE_TIME, bytes), None);
            assert_eq!(controls.last_error(), Refusal::OutOfRange as u8);
        }
        assert!(controls.answer(GET_CUR, EXPOSURE_TIME, &[]).is_some());
        assert_eq!(controls.last_error(), 0);
    }

    #[test]
    fn a_stall_lasts_until_it_is_lifted() {
        let mut controls = manual();
        controls.stall(Control::ExposureTime, Some(5));
        assert_eq!(controls.answer(SET_CUR, EXPOSURE_TIME, &80_i32.to_le_bytes()), None);
        assert_eq!(controls.last_error(), 5);
        controls.stall(Control::ExposureTime, None);
        assert!(controls.answer(SET_CUR, EXPOSURE_TIME, &80_i32.to_le_bytes()).is_some());
    }

    #[test]
    fn values_fall_on_steps() {
        let exposure_100us = Range {
            minimum: 1,
            maximum: 1000,
            step: 5,
            default: 101,
        };
        let ranges = ControlRanges {
            exposure_100us,
            ..ControlRanges::default()
        };
        let mut controls = Controls::new(ranges);
        controls.answer(SET_CUR, EXPOSURE_MODE, &[1]).unwrap();
        controls.answer(SET_CUR, EXPOSURE_TIME, &83_i32.to_le_bytes()).unwrap();
        assert_eq!(controls.get(Control::ExposureTime), 81);
    }
}
