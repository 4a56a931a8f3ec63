//! Sizes, encodings and rates that the simulated webcams offer, and how they are negotiated.

use super::descriptors::{CLOCK_HZ, MAX_PAYLOAD_BYTES};

/// How pictures are coded on the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// 4:2:2, two bytes a pixel, order Y U Y V; BT.601, limited range.
    Yuyv,
    /// A JPEG per frame.
    Mjpeg,
}

/// One size in one encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// How pictures are coded.
    pub encoding: Encoding,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Frames a second, descending.
    pub rates_hz: &'static [u32],
}

/// What is offered; the order within an encoding is that of UVC's frame indices, which begin at 1.
pub const MODES: [Mode; 6] = [
    Mode {
        encoding: Encoding::Yuyv,
        width: 640,
        height: 480,
        rates_hz: &[30, 15],
    },
    Mode {
        encoding: Encoding::Yuyv,
        width: 320,
        height: 240,
        rates_hz: &[60, 30, 15],
    },
    Mode {
        encoding: Encoding::Yuyv,
        width: 1280,
        height: 720,
        rates_hz: &[15, 10, 5],
    },
    Mode {
        encoding: Encoding::Mjpeg,
        width: 1280,
        height: 720,
        rates_hz: &[30, 15],
    },
    Mode {
        encoding: Encoding::Mjpeg,
        width: 640,
        height: 480,
        rates_hz: &[60, 30, 15],
    },
    Mode {
        encoding: Encoding::Mjpeg,
        width: 320,
        height: 240,
        rates_hz: &[60, 30, 15],
    },
];

impl Mode {
    /// Frame intervals in UVC's unit of 100 ns, ascending.
    pub fn intervals_100ns(&self) -> Vec<u32> {
        self.rates_hz.iter().map(|rate_hz| 10_000_000 / rate_hz).collect()
    }

    /// Most bytes that one frame can have; for JPEG what cheap webcams claim as well.
    pub fn max_frame_bytes(&self) -> usize {
        self.width * self.height * 2
    }
}

/// What driver and webcam have agreed on (UVC 1.1, 4.3.1.1, probe and commit).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Negotiated {
    /// Encoding and size.
    pub mode: Mode,
    /// Frame interval in units of 100 ns.
    pub interval_100ns: u32,
}

impl Default for Negotiated {
    fn default() -> Self {
        Self {
            mode: MODES[0],
            interval_100ns: MODES[0].intervals_100ns()[0],
        }
    }
}

/// Length of the probe and commit controls in UVC 1.1.
pub const PROBE_BYTES: usize = 34;

impl Negotiated {
    /// Reads a wish of the driver: the nearest that the webcam can do. A wish cut short counts as zeros.
    pub fn from_probe(bytes: &[u8]) -> Self {
        let mut probe = [0; PROBE_BYTES];
        let length = bytes.len().min(PROBE_BYTES);
        probe[..length].copy_from_slice(&bytes[..length]);
        let encoding = if probe[2] == 2 { Encoding::Mjpeg } else { Encoding::Yuyv };
        let modes: Vec<_> = MODES.iter().filter(|mode| mode.encoding == encoding).collect();
        let mode = *modes[usize::from(probe[3]).clamp(1, modes.len()) - 1];
        let wish = u32::from_le_bytes([probe[4], probe[5], probe[6], probe[7]]);
        let intervals = mode.intervals_100ns();
        let interval_100ns = intervals
            .into_iter()
            .min_by_key(|interval| interval.abs_diff(wish))
            .expect("every mode has a rate");
        Self { mode, interval_100ns }
    }

    /// The agreement in the form of a probe or commit control.
    pub fn to_probe(self) -> [u8; PROBE_BYTES] {
        let mut probe = [0; PROBE_BYTES];
        probe[2] = match self.mode.encoding {
            Encoding::Yuyv => 1,
            Encoding::Mjpeg => 2,
        };
        let in_encoding = MODES.iter().filter(|mode| mode.encoding == self.mode.encoding);
        let position = in_encoding.into_iter().position(|mode| *mode == self.mode);
        probe[3] = position.expect("the mode is one of ours") as u8 + 1;
        probe[4..8].copy_from_slice(&self.interval_100ns.to_le_bytes());
        probe[18..22].copy_from_slice(&(self.mode.max_frame_bytes() as u32).to_le_bytes());
        probe[22..26].copy_from_slice(&(MAX_PAYLOAD_BYTES as u32).to_le_bytes());
        probe[26..30].copy_from_slice(&CLOCK_HZ.to_le_bytes());
        // The payload header carries a frame id and an end-of-frame bit.
        probe[30] = 3;
        probe
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_survives_negotiation() {
        for mode in MODES {
            for interval_100ns in mode.intervals_100ns() {
                let agreed = Negotiated { mode, interval_100ns };
                assert_eq!(Negotiated::from_probe(&agreed.to_probe()), agreed);
            }
        }
    }

    #[test]
    fn a_wish_out_of_range_is_moved_to_the_nearest() {
        let mut probe = Negotiated::default().to_probe();
        probe[3] = 77;
        probe[4..8].copy_from_slice(&1_u32.to_le_bytes());
        let agreed = Negotiated::from_probe(&probe);
        assert_eq!((agreed.mode.width, agreed.interval_100ns), (1280, 10_000_000 / 15));
        assert_eq!(Negotiated::from_probe(&[]).mode, MODES[0]);
    }
}
