//! Plugging a socket into a port of the kernel's virtual USB host controller, `vhci_hcd`.
//!
//! Linux, `drivers/usb/usbip/vhci_sysfs.c`: one line "port socket-fd device-id speed" written to `attach`.
//! Unplugging is closing the socket's other end.

use std::fs;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use thiserror::Error;

const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
/// `USB_SPEED_HIGH` of the kernel's `enum usb_device_speed`: 480 Mbit/s.
const HIGH_SPEED: u32 = 3;
/// Ports that take high-speed devices: `VHCI_HC_PORTS`, which Debian sets to 15.
const HIGH_SPEED_PORTS: u8 = 15;
/// A port is busy for some milliseconds after an unplug, until the kernel's threads are gone.
const BUSY_PATIENCE: Duration = Duration::from_secs(3);

/// A device that cannot be plugged in.
#[derive(Debug, Error)]
pub enum VhciError {
    /// The controller has no such high-speed port.
    #[error("port `{port}` is out of range; allowed are 0 to 14")]
    Port {
        /// The port asked for.
        port: u8,
    },
    /// The kernel refused the socket.
    #[error("cannot attach a device to port `{port}` of `{CONTROLLER}`")]
    Attach {
        /// The port asked for.
        port: u8,
        /// Why not.
        #[source]
        source: io::Error,
    },
}

impl VhciError {
    /// What to do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            VhciError::Port { .. } => "choose another port",
            VhciError::Attach { .. } => "this needs root and the module vhci-hcd: run it with scripts/driver-vm.sh",
        }
    }
}

/// Makes the kernel see a high-speed USB device at `port` whose requests come out of the returned socket.
///
/// # Errors
/// [`VhciError`]; a port that is still busy after three seconds is refused by the kernel.
pub fn attach(port: u8) -> Result<UnixStream, VhciError> {
    if port >= HIGH_SPEED_PORTS {
        return Err(VhciError::Port { port });
    }
    let deadline = Instant::now() + BUSY_PATIENCE;
    loop {
        match try_attach(port) {
            Ok(ours) => return Ok(ours),
            Err(source) if Instant::now() > deadline || source.kind() == io::ErrorKind::NotFound => {
                return Err(VhciError::Attach { port, source });
            }
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

fn try_attach(port: u8) -> io::Result<UnixStream> {
    let (ours, kernels) = UnixStream::pair()?;
    // The device id is free to choose; it is 16 bits of bus number and 16 of device number on the exporting side.
    let device_id = (1 << 16) | (u32::from(port) + 1);
    let line = format!("{port} {} {device_id} {HIGH_SPEED}", kernels.as_raw_fd());
    // The kernel takes a reference of its own to the socket, so that ours may be closed afterwards.
    fs::write(format!("{CONTROLLER}/attach"), line)?;
    Ok(ours)
}
