//! Frames cut into isochronous packets.
//!
//! UVC 1.1, section 2.4.3.2: each packet begins with a header whose frame id toggles from frame to frame, and whose
//! end-of-frame bit marks the last packet. The header carries the device's time stamp but not the bus clock (SCR): the
//! virtual host controller has no frame numbers, and logs noise when the driver asks for them.

use super::descriptors::CLOCK_HZ;
use crate::usbip::wire::{IsoPacket, IsoResult};

const HEADER_BYTES: usize = 6;
const FRAME_ID: u8 = 0x01;
const END_OF_FRAME: u8 = 0x02;
const TIME_STAMP: u8 = 0x04;
const ERROR: u8 = 0x40;
const END_OF_HEADER: u8 = 0x80;

/// A frame on its way to the host.
#[derive(Clone, Debug, Default)]
pub(super) struct OutgoingFrame {
    /// The coded picture.
    pub(super) picture: Vec<u8>,
    /// How much of it goes out; less than all for a short frame.
    pub(super) length: usize,
    /// Whether packets have the error bit.
    pub(super) error: bool,
    sent: usize,
    header_flags: u8,
    time_stamp: u32,
}

impl OutgoingFrame {
    /// Readies the frame in `picture` for sending: all of it, without error.
    pub(super) fn begin(&mut self, odd: bool, now_ns: u64) {
        self.length = self.picture.len();
        self.error = false;
        self.sent = 0;
        self.header_flags = END_OF_HEADER | TIME_STAMP | if odd { FRAME_ID } else { 0 };
        self.time_stamp = (u128::from(now_ns) * u128::from(CLOCK_HZ) / 1_000_000_000) as u32;
    }

    /// Fills the packets of one request. Returns whether the frame is complete; packets after its end stay empty.
    pub(super) fn fill(&mut self, packets: &[IsoPacket], results: &mut Vec<IsoResult>, data: &mut Vec<u8>) -> bool {
        let mut done = false;
        for &packet in packets {
            let room = packet.length as usize;
            if done || room <= HEADER_BYTES {
                results.push(IsoResult {
                    packet,
                    actual_length: 0,
                });
                continue;
            }
            let taken = (self.length - self.sent).min(room - HEADER_BYTES);
            done = self.sent + taken == self.length;
            data.push(HEADER_BYTES as u8);
            let error = if self.error { ERROR } else { 0 };
            data.push(self.header_flags | error | if done { END_OF_FRAME } else { 0 });
            data.extend(self.time_stamp.to_le_bytes());
            data.extend_from_slice(&self.picture[self.sent..self.sent + taken]);
            self.sent += taken;
            results.push(IsoResult {
                packet,
                actual_length: (HEADER_BYTES + taken) as u32,
            });
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packets_put_together_are_the_frame(
            picture in proptest::collection::vec(any::<u8>(), 0..9000),
            n_packets in 1..5_usize,
            room in 7..3072_u32,
        ) {
            let mut frame = OutgoingFrame { picture: picture.clone(), ..OutgoingFrame::default() };
            frame.begin(true, 123);
            let packets: Vec<_> = (0..n_packets as u32).map(|i| IsoPacket { offset: i * room, length: room }).collect();
            let mut received = Vec::new();
            loop {
                let (mut results, mut data) = (Vec::new(), Vec::new());
                let done = frame.fill(&packets, &mut results, &mut data);
                prop_assert_eq!(results.len(), packets.len());
                let mut rest = &data[..];
                let mut ends = 0;
                for result in &results {
                    let (packet, after) = rest.split_at(result.actual_length as usize);
                    rest = after;
                    if packet.is_empty() { continue; }
                    prop_assert_eq!(packet[0], 6);
                    prop_assert_eq!(packet[1] & 0x85, 0x85);
                    ends += usize::from(packet[1] & END_OF_FRAME != 0);
                    received.extend_from_slice(&packet[6..]);
                }
                prop_assert!(rest.is_empty());
                prop_assert_eq!(ends, usize::from(done));
                if done { break; }
            }
            prop_assert_eq!(received, picture);
        }
    }
}
