//! Finding the video node of a webcam by the USB port it is plugged into.

use std::fs;
use std::path::{Path, PathBuf};

/// `/dev/videoN` of the webcam at a port of the virtual host controller. A UVC webcam has two nodes; the one with
/// index 0 gives pictures, the other metadata.
pub(super) fn find(port: u8) -> Option<PathBuf> {
    let entries = fs::read_dir("/sys/class/video4linux").ok()?;
    entries.flatten().find_map(|entry| {
        // .../vhci_hcd.0/usb1/1-1/1-1:1.0/video4linux/video2: ports count from 1 in there.
        let device = fs::canonicalize(entry.path()).ok()?;
        let at_port = is_at_port(&device, port);
        let index = fs::read_to_string(device.join("index")).ok()?;
        let node = Path::new("/dev").join(entry.file_name());
        (at_port && index.trim() == "0" && node.exists()).then_some(node)
    })
}

fn is_at_port(device: &Path, port: u8) -> bool {
    let mut parts = device
        .components()
        .map(|part| part.as_os_str().to_string_lossy().into_owned());
    let port_folder_end = format!("-{}", u32::from(port) + 1);
    parts.any(|part| part.starts_with("vhci_hcd")) && parts.any(|part| part.ends_with(&port_folder_end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_port_is_read_from_the_path() {
        let device = Path::new("/sys/devices/platform/vhci_hcd.0/usb1/1-2/1-2:1.0/video4linux/video2");
        assert!(is_at_port(device, 1));
        assert!(!is_at_port(device, 0) && !is_at_port(device, 11));
        assert!(!is_at_port(
            Path::new("/sys/devices/platform/vivid.0/video4linux/video1-2"),
            1
        ));
    }
}
