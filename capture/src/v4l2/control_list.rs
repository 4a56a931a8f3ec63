//! Every control of a camera, for people to read. Kinds of control that nobody here knows are listed as well.

use std::io;

use v4l::v4l_sys as sys;

use super::ioctl::{Node, RawControl};

/// A control as the driver describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ControlDescription {
    /// The kernel's number.
    pub id: u32,
    /// The driver's name for it.
    pub name: String,
    /// What kind of value it holds, in words; unknown kinds have their number.
    pub kind: String,
    /// Least value.
    pub minimum: i64,
    /// Greatest value.
    pub maximum: i64,
    /// Distance between values.
    pub step: u64,
    /// Value after power-on.
    pub default: i64,
    /// Value now; none if it is no number or cannot be read.
    pub value: Option<i64>,
    /// Unit of the values, empty if the kernel defines none.
    pub unit: &'static str,
    /// Choices of a menu: value and name.
    pub menu: Vec<(i64, String)>,
    /// What restricts it: `read-only`, `inactive` (an automatic mode steers it), ...
    pub restrictions: Vec<&'static str>,
}

/// Asks the driver for all of its controls, one after the other.
pub(super) fn list(node: &Node) -> io::Result<Vec<ControlDescription>> {
    let mut all = Vec::new();
    let next = sys::V4L2_CTRL_FLAG_NEXT_CTRL | sys::V4L2_CTRL_FLAG_NEXT_COMPOUND;
    let mut id = 0;
    // A driver that does not go on would keep us here for ever.
    while let Some(control) = node.control(id | next)?.filter(|control| control.id > id) {
        id = control.id;
        if control.kind != sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_CTRL_CLASS {
            all.push(describe(node, &control));
        }
    }
    Ok(all)
}

/// Most choices of a menu that are listed. A driver could claim billions.
const MENU_MAX: i64 = 256;

fn describe(node: &Node, control: &RawControl) -> ControlDescription {
    let is_readable = has_number(control) && control.flags & sys::V4L2_CTRL_FLAG_WRITE_ONLY == 0;
    ControlDescription {
        id: control.id,
        name: control.name.clone(),
        kind: kind_name(control),
        minimum: control.minimum,
        maximum: control.maximum,
        step: control.step,
        default: control.default,
        value: is_readable.then(|| node.value(control).ok()).flatten(),
        unit: unit(control.id),
        menu: menu(node, control),
        restrictions: restrictions(control.flags),
    }
}

fn menu(node: &Node, control: &RawControl) -> Vec<(i64, String)> {
    let is_menu = matches!(
        control.kind,
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU | sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU
    );
    if !is_menu {
        return Vec::new();
    }
    let last = control.maximum.min(control.minimum.saturating_add(MENU_MAX));
    let item = |index: i64| Some((index, node.menu_item(control, u32::try_from(index).ok()?)?));
    (control.minimum..=last).filter_map(item).collect()
}

/// True if the control holds one number.
pub(super) fn has_number(control: &RawControl) -> bool {
    !control.is_compound
        && !matches!(
            control.kind,
            sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BUTTON
                | sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_STRING
                | sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_CTRL_CLASS
        )
}

fn kind_name(control: &RawControl) -> String {
    match control.kind {
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER => "integer".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BOOLEAN => "boolean".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU => "menu".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BUTTON => "button".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER64 => "wide integer".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_STRING => "text".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BITMASK => "bits".into(),
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU => "menu of integers".into(),
        other => format!("type {other:#x}"),
    }
}

/// Units that the kernel's documentation gives.
fn unit(id: u32) -> &'static str {
    match id {
        sys::V4L2_CID_EXPOSURE_ABSOLUTE => "100 µs",
        sys::V4L2_CID_WHITE_BALANCE_TEMPERATURE => "K",
        sys::V4L2_CID_PAN_ABSOLUTE | sys::V4L2_CID_TILT_ABSOLUTE => "arc seconds",
        sys::V4L2_CID_AUTO_EXPOSURE_BIAS => "0.001 EV",
        _ => "",
    }
}

fn restrictions(flags: u32) -> Vec<&'static str> {
    let names = [
        (sys::V4L2_CTRL_FLAG_DISABLED, "disabled"),
        (sys::V4L2_CTRL_FLAG_GRABBED, "grabbed"),
        (sys::V4L2_CTRL_FLAG_READ_ONLY, "read-only"),
        (sys::V4L2_CTRL_FLAG_INACTIVE, "inactive"),
        (sys::V4L2_CTRL_FLAG_WRITE_ONLY, "write-only"),
        (sys::V4L2_CTRL_FLAG_VOLATILE, "volatile"),
    ];
    names
        .into_iter()
        .filter(|(flag, _)| flags & flag != 0)
        .map(|(_, name)| name)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_kinds_of_control_have_a_name() {
        let control = RawControl {
            id: 1,
            kind: 0x107,
            name: "grid".into(),
            minimum: 0,
            maximum: 0,
            step: 0,
            default: 0,
            flags: 0,
            is_compound: true,
        };
        assert_eq!(kind_name(&control), "type 0x107");
        assert!(!has_number(&control));
    }
}
