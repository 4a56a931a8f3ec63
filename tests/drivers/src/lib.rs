//! Cameras without cameras: what tests on real kernel drivers are made of.
//!
//! - [`webcam`]: simulated USB webcams that the kernel's `uvcvideo` takes for real ones, over [`usbip`];
//! - [`vivid`]: the kernel's own virtual camera and its faults;
//! - [`raw_camera`]: a small V4L2 reader to hold them against, independent of the capture crate.
//!
//! All of it needs Linux, root and kernel modules, and is meant for the virtual machine that
//! `scripts/driver-vm.sh` boots; the program `driver-tests` runs in there. Unit tests run anywhere.

pub mod raw_camera;
pub mod usbip;
pub mod vivid;
pub mod webcam;
