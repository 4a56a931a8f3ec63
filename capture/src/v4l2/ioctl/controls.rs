//! Controls and events.

use std::ffi::c_char;
use std::io;

use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

use super::{Node, Plain, request_code, text};

/// `VIDIOC_DQEVENT`: `_IOR('V', 89, struct v4l2_event)`; the crate has no constant.
const DEQUEUE_EVENT: u64 = request_code(2, 89, size_of::<sys::v4l2_event>());
/// `VIDIOC_SUBSCRIBE_EVENT`: `_IOW('V', 90, struct v4l2_event_subscription)`.
const SUBSCRIBE_EVENT: u64 = request_code(1, 90, size_of::<sys::v4l2_event_subscription>());
/// `VIDIOC_UNSUBSCRIBE_EVENT`: `_IOW('V', 91, struct v4l2_event_subscription)`.
const UNSUBSCRIBE_EVENT: u64 = request_code(1, 91, size_of::<sys::v4l2_event_subscription>());
/// `V4L2_EVENT_ALL`.
const EVENT_ALL: u32 = 0;

/// What a driver says about one of its controls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::v4l2) struct RawControl {
    pub(in crate::v4l2) id: u32,
    pub(in crate::v4l2) kind: u32,
    pub(in crate::v4l2) name: String,
    pub(in crate::v4l2) minimum: i64,
    pub(in crate::v4l2) maximum: i64,
    pub(in crate::v4l2) step: u64,
    pub(in crate::v4l2) default: i64,
    pub(in crate::v4l2) flags: u32,
    /// True for arrays and structures.
    pub(in crate::v4l2) is_compound: bool,
}

impl Node {
    /// The control with this number, or with `V4L2_CTRL_FLAG_NEXT_CTRL` the next one; none if there is none.
    pub(in crate::v4l2) fn control(&self, id: u32) -> io::Result<Option<RawControl>> {
        let mut control = sys::v4l2_query_ext_ctrl { id, ..Plain::zeroed() };
        // SAFETY: the request's own structure, without pointers.
        match unsafe { self.call(vidioc::VIDIOC_QUERY_EXT_CTRL, &mut control) } {
            Ok(()) => {}
            // EINVAL: no such control; ENOTTY: a driver without any.
            Err(error) if matches!(error.raw_os_error(), Some(libc::EINVAL | libc::ENOTTY)) => return Ok(None),
            Err(error) => return Err(error),
        }
        Ok(Some(RawControl {
            id: control.id,
            kind: control.type_,
            name: c_text(&control.name),
            minimum: control.minimum,
            maximum: control.maximum,
            step: control.step,
            default: control.default_value,
            flags: control.flags,
            is_compound: control.nr_of_dims > 0 || control.type_ >= sys::v4l2_ctrl_type_V4L2_CTRL_COMPOUND_TYPES,
        }))
    }

    /// The choice with this index of a menu: its name, or its number for a menu of integers. Menus have holes.
    pub(in crate::v4l2) fn menu_item(&self, control: &RawControl, index: u32) -> Option<String> {
        let mut item = sys::v4l2_querymenu {
            id: control.id,
            index,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(vidioc::VIDIOC_QUERYMENU, &mut item).ok()? };
        let is_integer = control.kind == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU;
        // SAFETY: both members are integers, any bytes are valid.
        let (name, value) = unsafe { (item.__bindgen_anon_1.name, item.__bindgen_anon_1.value) };
        Some(if is_integer { value.to_string() } else { text(&name) })
    }

    /// The value of a control that holds one number.
    pub(in crate::v4l2) fn value(&self, control: &RawControl) -> io::Result<i64> {
        let mut value = sys::v4l2_ext_control {
            id: control.id,
            ..Plain::zeroed()
        };
        self.exchange(vidioc::VIDIOC_G_EXT_CTRLS, &mut value)?;
        // SAFETY: both members are integers, any bytes are valid.
        Ok(unsafe {
            if is_wide(control) {
                value.__bindgen_anon_1.value64
            } else {
                value.__bindgen_anon_1.value.into()
            }
        })
    }

    /// Sets a control that holds one number. Values that do not fit are refused as out of range.
    pub(in crate::v4l2) fn set_value(&self, control: &RawControl, value: i64) -> io::Result<()> {
        let mut argument = sys::v4l2_ext_control {
            id: control.id,
            ..Plain::zeroed()
        };
        if is_wide(control) {
            argument.__bindgen_anon_1.value64 = value;
        } else {
            let narrow = i32::try_from(value).map_err(|_| io::Error::from_raw_os_error(libc::ERANGE))?;
            argument.__bindgen_anon_1.value = narrow;
        }
        self.exchange(vidioc::VIDIOC_S_EXT_CTRLS, &mut argument)
    }

    /// Reads or writes one control. The size in `value` is 0, so the kernel takes nothing in it for a pointer.
    fn exchange(&self, request: u64, value: &mut sys::v4l2_ext_control) -> io::Result<()> {
        let mut values = sys::v4l2_ext_controls {
            count: 1,
            controls: value,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure; `controls` points to `count` = 1 controls, borrowed during the call.
        unsafe { self.call(request, &mut values) }
    }

    /// Asks for events when a control changes, unless this node itself changed it.
    pub(in crate::v4l2) fn subscribe(&self, control_id: u32) -> io::Result<()> {
        let mut subscription = sys::v4l2_event_subscription {
            type_: sys::V4L2_EVENT_CTRL,
            id: control_id,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(SUBSCRIBE_EVENT, &mut subscription) }
    }

    /// Asks for no more events.
    pub(in crate::v4l2) fn unsubscribe_all(&self) -> io::Result<()> {
        let mut subscription = sys::v4l2_event_subscription {
            type_: EVENT_ALL,
            ..Plain::zeroed()
        };
        // SAFETY: the request's own structure, without pointers.
        unsafe { self.call(UNSUBSCRIBE_EVENT, &mut subscription) }
    }

    /// The number of a control whose value changed, and the value; none if no such event is waiting.
    pub(in crate::v4l2) fn changed_control(&self) -> io::Result<Option<(u32, i64)>> {
        let mut event = sys::v4l2_event::zeroed();
        // SAFETY: the request's own structure, without pointers.
        match unsafe { self.call(DEQUEUE_EVENT, &mut event) } {
            Ok(()) => {}
            Err(error) if matches!(error.raw_os_error(), Some(libc::ENOENT | libc::EAGAIN)) => return Ok(None),
            Err(error) => return Err(error),
        }
        if event.type_ != sys::V4L2_EVENT_CTRL {
            return Ok(None);
        }
        // SAFETY: the member of this type of event; all integers.
        let change = unsafe { event.u.ctrl };
        if change.changes & sys::V4L2_EVENT_CTRL_CH_VALUE == 0 {
            return Ok(None);
        }
        let is_wide = change.type_ == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER64;
        // SAFETY: both members are integers, any bytes are valid.
        let value = unsafe {
            if is_wide {
                change.__bindgen_anon_1.value64
            } else {
                change.__bindgen_anon_1.value.into()
            }
        };
        Ok(Some((event.id, value)))
    }
}

fn is_wide(control: &RawControl) -> bool {
    control.kind == sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER64
}

fn c_text(characters: &[c_char]) -> String {
    let bytes: Vec<u8> = characters.iter().map(|character| character.cast_unsigned()).collect();
    text(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_codes_are_as_strace_shows_them_on_x86_64() {
        assert_eq!((DEQUEUE_EVENT, SUBSCRIBE_EVENT), (0x8088_5659, 0x4020_565a));
    }
}
