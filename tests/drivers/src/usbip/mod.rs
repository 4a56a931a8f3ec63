//! USB/IP: USB requests as messages on a socket.
//!
//! The kernel's virtual host controller `vhci_hcd` takes any connected stream socket and treats the process at its
//! other end as a USB device. Real USB/IP crosses a network; here both ends are in one machine, so that a simulated
//! device meets the real USB core and the real driver of its class.
//!
//! Protocol: Linux, `Documentation/usb/usbip_protocol.rst`. The handshake of that document (`OP_REQ_IMPORT`) is the
//! business of the `usbip` program and does not take place here: [`vhci::attach`] hands over a socket as imported.

pub mod vhci;
pub mod wire;
