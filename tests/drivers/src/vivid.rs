//! The kernel's virtual camera `vivid`, and how to make it fail.
//!
//! Linux, `Documentation/admin-guide/media/vivid.rst`, section "Error Injection". Its pictures answer to no control, so it is
//! for faults only; it has no MJPEG, and 640 × 480 has at most 25 frames a second.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::raw_camera::RawCamera;

/// A fault or a peculiarity of vivid's; the name that its control has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VividFault {
    /// How many of a hundred frames get lost; the driver's sequence shows the gaps.
    DroppedPercent,
    /// One frame is flagged as damaged.
    FlagError,
    /// The next `REQBUFS` or `CREATE_BUFS` fails.
    RequestBuffers,
    /// The next `QBUF` fails.
    Queue,
    /// The next `STREAMON` fails.
    StreamOn,
    /// The stream fails with `EIO` until it is stopped.
    Fatal,
    /// The device is gone, though its node stays, until the driver's module is loaded anew.
    Disconnect,
    /// Sequence numbers begin 128 before they wrap.
    WrapSequence,
    /// Time stamps begin shortly before they wrap, at 16 s or 64 bits.
    WrapTimestamp,
    /// 0: stamps at the end of a frame, which lie in the future; 1: at the start of the exposure.
    TimestampSource,
}

impl VividFault {
    fn control_name(self) -> &'static str {
        match self {
            VividFault::DroppedPercent => "Percentage of Dropped Buffers",
            VividFault::FlagError => "Inject V4L2_BUF_FLAG_ERROR",
            VividFault::RequestBuffers => "Inject VIDIOC_REQBUFS Error",
            VividFault::Queue => "Inject VIDIOC_QBUF Error",
            VividFault::StreamOn => "Inject VIDIOC_STREAMON Error",
            VividFault::Fatal => "Inject Fatal Streaming Error",
            VividFault::Disconnect => "Disconnect",
            VividFault::WrapSequence => "Wrap Sequence Number",
            VividFault::WrapTimestamp => "Wrap Timestamp",
            VividFault::TimestampSource => "Timestamp Source",
        }
    }
}

/// Sets a fault at an open vivid camera; 1 presses a button or switches on.
///
/// # Errors
/// The driver's; `NotFound` where the camera has no such control.
pub fn set(camera: &RawCamera, fault: VividFault, value: i32) -> io::Result<()> {
    let control = camera
        .controls()
        .into_iter()
        .find(|control| control.name == fault.control_name());
    let control = control.ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::NotFound,
            format!("no control `{}`; is this vivid?", fault.control_name()),
        )
    })?;
    camera.set_control(control.id, value)
}

/// The device nodes of vivid's cameras, in order.
pub fn nodes() -> Vec<PathBuf> {
    let mut nodes: Vec<PathBuf> = fs::read_dir("/sys/class/video4linux")
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| {
            let name = fs::read_to_string(entry.path().join("name")).unwrap_or_default();
            name.starts_with("vivid") && name.trim().ends_with("vid-cap")
        })
        .map(|entry| Path::new("/dev").join(entry.file_name()))
        .collect();
    nodes.sort();
    nodes
}

/// Loads vivid anew with two webcams, which undoes all faults. No camera of it may be open. Works in the virtual machine
/// of `scripts/driver-vm.sh` only, which keeps the module at hand.
///
/// # Errors
/// What the module loader says.
pub fn reload() -> io::Result<()> {
    reload_with(2)
}

/// The same with this many webcams, 1 to 64.
///
/// # Errors
/// What the module loader says.
pub fn reload_with(n_cameras: usize) -> io::Result<()> {
    const FOLDER: &str = "/run/driver-vm";
    let run = |arguments: &[&str]| {
        let output = Command::new(format!("{FOLDER}/busybox")).args(arguments).output()?;
        if output.status.success() {
            return Ok(());
        }
        Err(io::Error::other(String::from_utf8_lossy(&output.stderr).into_owned()))
    };
    run(&["rmmod", "vivid"])?;
    let module = format!("{FOLDER}/modules/vivid.ko");
    let for_each = |name: &str, value: &str| format!("{name}={}", vec![value; n_cameras].join(","));
    let count = format!("n_devs={n_cameras}");
    // Type 0x1 is a camera, input 0 a webcam.
    let parameters = [
        for_each("node_types", "0x1"),
        for_each("num_inputs", "1"),
        for_each("input_types", "0"),
    ];
    run(&[
        "insmod",
        &module,
        &count,
        &parameters[0],
        &parameters[1],
        &parameters[2],
    ])
}
