//! What a simulated webcam says about itself.
//!
//! One function of a USB 2.0 high-speed device: a video control interface (camera terminal → processing unit →
//! output terminal) and a video streaming interface with two formats. USB Device Class Definition for Video Devices
//! 1.1 ("UVC 1.1"), sections 3.7 (control) and 3.9 (streaming), and its payload documents for uncompressed and
//! Motion-JPEG video, section 3.1 each. All numbers are little-endian.

use super::format::{Encoding, MODES};

/// Address of the isochronous endpoint that pictures come from.
pub(super) const VIDEO_ENDPOINT: u8 = 1;
/// Number of the video control interface.
pub(super) const CONTROL_INTERFACE: u8 = 0;
/// Number of the video streaming interface.
pub(super) const STREAMING_INTERFACE: u8 = 1;
/// Entity id of the camera terminal.
pub(super) const CAMERA_TERMINAL: u8 = 1;
/// Entity id of the processing unit.
pub(super) const PROCESSING_UNIT: u8 = 2;
const OUTPUT_TERMINAL: u8 = 3;
/// Most bytes of video in a packet, header included: three transactions of 1024 bytes in each microframe of 125 µs,
/// which is the most that high-speed USB can do.
pub(super) const MAX_PAYLOAD_BYTES: usize = 3072;
/// The same as USB writes it (USB 2.0, table 9-13): 1024, with two further transactions in bits 12 and 11.
const MAX_PACKET_SIZE: u16 = 0x1400;
/// The device's clock: what the payload header's time stamps count.
pub(super) const CLOCK_HZ: u32 = 48_000_000;

const VIDEO_CLASS: u8 = 0x0E;
const CS_INTERFACE: u8 = 0x24;

/// A descriptor that a `GET_DESCRIPTOR` request asks for: the `value` is the type in the high byte and the index in
/// the low. `None` for what the webcam has not.
pub(super) fn descriptor(value: u16, product: &str, serial: &str) -> Option<Vec<u8>> {
    match (value >> 8, value & 0xFF) {
        (1, 0) => Some(device()),
        (2, 0) => Some(configuration()),
        (3, 0) => Some(vec![4, 3, 0x09, 0x04]),
        (3, 1) => Some(string("mirrorball")),
        (3, 2) => Some(string(product)),
        (3, 3) => Some(string(serial)),
        _ => None,
    }
}

fn device() -> Vec<u8> {
    // Class EF/02/01: the interfaces are grouped by an association descriptor. 1209:0001 is pid.codes' id for tests.
    let mut bytes = vec![18, 1, 0x00, 0x02, 0xEF, 0x02, 0x01, 64];
    for word in [0x1209_u16, 0x0001, 0x0100] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend([1, 2, 3, 1]);
    bytes
}

fn string(text: &str) -> Vec<u8> {
    let mut bytes = vec![0, 3];
    bytes.extend(text.encode_utf16().take(126).flat_map(u16::to_le_bytes));
    bytes[0] = bytes.len() as u8;
    bytes
}

fn configuration() -> Vec<u8> {
    let mut body = vec![8, 11, CONTROL_INTERFACE, 2, VIDEO_CLASS, 3, 0, 0];
    body.extend([9, 4, CONTROL_INTERFACE, 0, 0, VIDEO_CLASS, 1, 0, 0]);
    body.extend(control_interface());
    body.extend([9, 4, STREAMING_INTERFACE, 0, 0, VIDEO_CLASS, 2, 0, 0]);
    body.extend(streaming_interface());
    // Alternate setting 1 has the endpoint: choosing it starts the stream, setting 0 stops it.
    body.extend([9, 4, STREAMING_INTERFACE, 1, 1, VIDEO_CLASS, 2, 0, 0]);
    let [low, high] = MAX_PACKET_SIZE.to_le_bytes();
    body.extend([7, 5, 0x80 | VIDEO_ENDPOINT, 0x05, low, high, 1]);

    let mut bytes = vec![9, 2];
    bytes.extend((9 + body.len() as u16).to_le_bytes());
    // Two interfaces, configuration 1, no name, powered from the bus with 500 mA.
    bytes.extend([2, 1, 0, 0x80, 250]);
    bytes.extend(body);
    bytes
}

fn control_interface() -> Vec<u8> {
    // Camera terminal (type 0x0201), no lens data; controls: exposure mode, its priority, exposure time.
    let mut units = vec![
        18,
        CS_INTERFACE,
        2,
        CAMERA_TERMINAL,
        0x01,
        0x02,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        3,
        0x0E,
        0,
        0,
    ];
    // Processing unit; controls: brightness, white balance temperature and its automatic, gain, power line frequency.
    units.extend([
        12,
        CS_INTERFACE,
        5,
        PROCESSING_UNIT,
        CAMERA_TERMINAL,
        0,
        0,
        2,
        0x41,
        0x16,
        0,
        0,
    ]);
    // Output terminal to USB streaming (type 0x0101).
    units.extend([9, CS_INTERFACE, 3, OUTPUT_TERMINAL, 0x01, 0x01, 0, PROCESSING_UNIT, 0]);

    let mut bytes = vec![13, CS_INTERFACE, 1, 0x10, 0x01];
    bytes.extend((13 + units.len() as u16).to_le_bytes());
    bytes.extend(CLOCK_HZ.to_le_bytes());
    bytes.extend([1, STREAMING_INTERFACE]);
    bytes.extend(units);
    bytes
}

fn streaming_interface() -> Vec<u8> {
    let encodings = [Encoding::Yuyv, Encoding::Mjpeg];
    let mut formats = Vec::new();
    for (index, encoding) in encodings.iter().enumerate() {
        formats.extend(format(*encoding, index as u8 + 1));
    }
    let header_bytes = 13 + encodings.len();
    let mut bytes = vec![header_bytes as u8, CS_INTERFACE, 1, encodings.len() as u8];
    bytes.extend((header_bytes as u16 + formats.len() as u16).to_le_bytes());
    bytes.extend([0x80 | VIDEO_ENDPOINT, 0, OUTPUT_TERMINAL, 0, 0, 0, 1, 0, 0]);
    bytes.extend(formats);
    bytes
}

fn format(encoding: Encoding, index: u8) -> Vec<u8> {
    let frames: Vec<_> = MODES.iter().filter(|mode| mode.encoding == encoding).collect();
    let n_frames = frames.len() as u8;
    let (mut bytes, subtype) = match encoding {
        Encoding::Yuyv => {
            let mut bytes = vec![27, CS_INTERFACE, 4, index, n_frames];
            // GUID of YUY2: its four letters, then the fixed tail of all such GUIDs.
            bytes.extend(b"YUY2\x00\x00\x10\x00\x80\x00\x00\xaa\x00\x38\x9b\x71");
            bytes.extend([16, 1, 0, 0, 0, 0]);
            (bytes, 5)
        }
        Encoding::Mjpeg => (vec![11, CS_INTERFACE, 6, index, n_frames, 1, 1, 0, 0, 0, 0], 7),
    };
    for (frame_index, mode) in (1..).zip(frames) {
        let intervals = mode.intervals_100ns();
        bytes.extend([26 + 4 * intervals.len() as u8, CS_INTERFACE, subtype, frame_index, 0]);
        bytes.extend((mode.width as u16).to_le_bytes());
        bytes.extend((mode.height as u16).to_le_bytes());
        let frame_bits = mode.max_frame_bytes() as u64 * 8;
        for interval in [intervals[intervals.len() - 1], intervals[0]] {
            let bits_per_s = frame_bits * 10_000_000 / u64::from(interval);
            bytes.extend(u32::try_from(bits_per_s).unwrap_or(u32::MAX).to_le_bytes());
        }
        bytes.extend((mode.max_frame_bytes() as u32).to_le_bytes());
        bytes.extend(intervals[0].to_le_bytes());
        bytes.push(intervals.len() as u8);
        bytes.extend(intervals.iter().flat_map(|interval| interval.to_le_bytes()));
    }
    // Colour matching: primaries of BT.709, its transfer curve, the luma weights of BT.601.
    bytes.extend([6, CS_INTERFACE, 13, 1, 1, 4]);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walks a list of descriptors by their length bytes.
    fn lengths(bytes: &[u8]) -> Vec<(u8, u8)> {
        let mut found = Vec::new();
        let mut rest = bytes;
        while let [length, kind, ..] = *rest {
            found.push((kind, length));
            rest = &rest[usize::from(length)..];
        }
        assert!(rest.is_empty());
        found
    }

    #[test]
    fn the_configuration_is_a_chain_of_descriptors_with_true_total_length() {
        let bytes = configuration();
        assert_eq!(usize::from(u16::from_le_bytes([bytes[2], bytes[3]])), bytes.len());
        let found = lengths(&bytes);
        assert_eq!(found[..3], [(2, 9), (11, 8), (4, 9)]);
        assert_eq!(found.last(), Some(&(5, 7)));
        assert_eq!(found.iter().filter(|(kind, _)| *kind == 4).count(), 3);
    }

    #[test]
    fn class_specific_headers_count_what_follows_them() {
        for bytes in [control_interface(), streaming_interface()] {
            let total_at = if bytes[0] == 13 { 5 } else { 4 };
            let total = u16::from_le_bytes([bytes[total_at], bytes[total_at + 1]]);
            assert_eq!(usize::from(total), bytes.len());
            assert!(lengths(&bytes).iter().all(|(kind, _)| *kind == CS_INTERFACE));
        }
    }

    #[test]
    fn strings_are_utf16_and_unknown_descriptors_absent() {
        assert_eq!(descriptor(0x0302, "Ab", "1").unwrap(), [6, 3, b'A', 0, b'b', 0]);
        assert_eq!(descriptor(0x0600, "Ab", "1"), None);
        assert_eq!(descriptor(0x0100, "Ab", "1").unwrap().len(), 18);
    }
}
