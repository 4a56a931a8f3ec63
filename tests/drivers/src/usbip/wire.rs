//! The messages of USB/IP, as bytes.
//!
//! Every number is big-endian but the 8 bytes of a control request's set-up packet, which are as on the USB cable.

use thiserror::Error;

/// `-EPIPE`: the device stalled, that is, refused the request.
pub const STALL: i32 = -32;
/// `-EPROTO`: the transfer failed on the wire.
pub const PROTOCOL_ERROR: i32 = -71;
/// `-ECONNRESET`: a request was taken back before it was answered.
const UNLINKED: i32 = -104;

const HEADER_BYTES: usize = 48;
const ISO_PACKET_BYTES: usize = 16;
/// The kernel sends at most 1024 packets in a request (`USBIP_MAX_ISO_PACKETS`).
const MAX_ISO_PACKETS: u32 = 1024;
/// No request to a webcam carries more data out than this.
const MAX_OUT_BYTES: u32 = 1 << 16;

/// Bytes that are no USB/IP message of the kernel's side.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum WireError {
    /// Not a request.
    #[error("USB/IP command `{command:#x}` is unknown; allowed are 1 (submit) and 2 (unlink)")]
    Command {
        /// What was in place of the command.
        command: u32,
    },
    /// A length that no request to a webcam has.
    #[error("USB/IP request with `{length}` bytes out and `{packets}` packets; allowed are at most 65536 and 1024")]
    TooLong {
        /// Bytes sent to the device.
        length: u32,
        /// Isochronous packets.
        packets: u32,
    },
}

/// Which way the data of a request goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To the device.
    Out,
    /// To the host.
    In,
}

/// One packet's place in the buffer of an isochronous request, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IsoPacket {
    /// Where in the host's buffer the packet belongs.
    pub offset: u32,
    /// Room for the packet.
    pub length: u32,
}

/// A USB request block, to be answered with [`reply`] or [`reply_iso`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Submit {
    /// The request's number; the reply repeats it.
    pub seqnum: u32,
    /// Which way the data goes.
    pub direction: Direction,
    /// Endpoint, without the direction bit.
    pub endpoint: u32,
    /// Length of the host's buffer, in bytes.
    pub length: u32,
    /// Set-up packet of a control request (USB 2.0, 9.3).
    pub setup: [u8; 8],
    /// What the host sends; empty for requests in.
    pub data: Vec<u8>,
    /// Packets of an isochronous request; empty otherwise.
    pub packets: Vec<IsoPacket>,
}

/// A message from the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Do a transfer.
    Submit(Submit),
    /// Take back an earlier request.
    Unlink {
        /// This message's own number; the reply repeats it.
        seqnum: u32,
        /// Number of the request that is taken back.
        target: u32,
    },
}

/// What became of one isochronous packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IsoResult {
    /// The packet as it was asked for.
    pub packet: IsoPacket,
    /// Bytes that the device sent, at most `packet.length`.
    pub actual_length: u32,
}

/// Reads the first message in `bytes` and says how long it is; `None` when it is not complete yet.
///
/// # Errors
/// [`WireError`] when this is no message; the stream cannot be followed from there on.
pub fn parse(bytes: &[u8]) -> Result<Option<(Request, usize)>, WireError> {
    if bytes.len() < HEADER_BYTES {
        return Ok(None);
    }
    let word = |index: usize| {
        u32::from_be_bytes(
            bytes[4 * index..4 * index + 4]
                .try_into()
                .expect("a slice of four bytes"),
        )
    };
    match word(0) {
        1 => {}
        2 => {
            return Ok(Some((
                Request::Unlink {
                    seqnum: word(1),
                    target: word(5),
                },
                HEADER_BYTES,
            )));
        }
        command => return Err(WireError::Command { command }),
    }
    let direction = if word(3) == 0 { Direction::Out } else { Direction::In };
    let length = word(6);
    // Newer kernels write -1 where there are no packets.
    let packets = if word(8) == u32::MAX { 0 } else { word(8) };
    let out_bytes = if direction == Direction::Out { length } else { 0 };
    if out_bytes > MAX_OUT_BYTES || packets > MAX_ISO_PACKETS {
        return Err(WireError::TooLong {
            length: out_bytes,
            packets,
        });
    }
    let data_end = HEADER_BYTES + out_bytes as usize;
    let end = data_end + packets as usize * ISO_PACKET_BYTES;
    if bytes.len() < end {
        return Ok(None);
    }
    let packets = bytes[data_end..end]
        .chunks_exact(ISO_PACKET_BYTES)
        .map(|entry| IsoPacket {
            offset: be32(entry, 0),
            length: be32(entry, 4),
        })
        .collect();
    let submit = Submit {
        seqnum: word(1),
        direction,
        endpoint: word(4),
        length,
        setup: bytes[40..48].try_into().expect("a slice of eight bytes"),
        data: bytes[HEADER_BYTES..data_end].to_vec(),
        packets,
    };
    Ok(Some((Request::Submit(submit), end)))
}

/// Appends the answer to a control request: `data` for requests in, `actual_length` bytes taken for requests out.
/// A `status` other than 0 is a negative error number.
pub fn reply(out: &mut Vec<u8>, seqnum: u32, status: i32, (actual_length, data): (u32, &[u8])) {
    header(out, 3, seqnum, status);
    for word in [actual_length, 0, 0, 0, 0, 0] {
        out.extend(word.to_be_bytes());
    }
    out.extend_from_slice(data);
}

/// Appends the answer to an isochronous request in: `data` are the packets' bytes without gaps.
///
/// # Panics
/// When `data` is not as long as the packets' actual lengths together.
pub fn reply_iso(out: &mut Vec<u8>, seqnum: u32, status: i32, (results, data): (&[IsoResult], &[u8])) {
    let total: u32 = results.iter().map(|result| result.actual_length).sum();
    assert_eq!(total as usize, data.len(), "packets and data must agree");
    header(out, 3, seqnum, status);
    for word in [total, 0, results.len() as u32, 0, 0, 0] {
        out.extend(word.to_be_bytes());
    }
    out.extend_from_slice(data);
    for result in results {
        for word in [result.packet.offset, result.packet.length, result.actual_length, 0] {
            out.extend(word.to_be_bytes());
        }
    }
}

/// Appends the answer to an unlink: whether the request was `taken_back`, or had been answered before.
pub fn reply_unlink(out: &mut Vec<u8>, seqnum: u32, taken_back: bool) {
    header(out, 4, seqnum, if taken_back { UNLINKED } else { 0 });
    out.extend([0; 24]);
}

fn header(out: &mut Vec<u8>, command: u32, seqnum: u32, status: i32) {
    for word in [command, seqnum, 0, 0, 0, status.cast_unsigned()] {
        out.extend(word.to_be_bytes());
    }
}

fn be32(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().expect("a slice of four bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_be_bytes()).collect()
    }

    fn submit_bytes(direction: u32, length: u32, packets: u32) -> Vec<u8> {
        let mut bytes = words(&[1, 7, 0x10002, direction, 1, 0, length, 0, packets, 1]);
        bytes.extend([0x80, 6, 0, 1, 0, 0, 18, 0]);
        bytes
    }

    #[test]
    fn a_control_request_is_read() {
        let bytes = submit_bytes(1, 18, u32::MAX);
        let (request, used) = parse(&bytes).unwrap().unwrap();
        assert_eq!(used, 48);
        let Request::Submit(submit) = request else {
            panic!("not a submit: {request:?}")
        };
        assert_eq!((submit.seqnum, submit.endpoint, submit.length), (7, 1, 18));
        assert_eq!(submit.setup, [0x80, 6, 0, 1, 0, 0, 18, 0]);
        assert!(submit.data.is_empty() && submit.packets.is_empty());
    }

    #[test]
    fn data_out_and_packets_are_waited_for() {
        let mut bytes = submit_bytes(0, 3, 1);
        bytes.extend([1, 2, 3]);
        bytes.extend(words(&[0, 3072, 0, 0]));
        for cut in 0..bytes.len() {
            assert_eq!(parse(&bytes[..cut]).unwrap(), None);
        }
        bytes.push(99);
        let (request, used) = parse(&bytes).unwrap().unwrap();
        assert_eq!(used, bytes.len() - 1);
        let Request::Submit(submit) = request else {
            panic!("not a submit: {request:?}")
        };
        assert_eq!(submit.data, [1, 2, 3]);
        assert_eq!(
            submit.packets,
            [IsoPacket {
                offset: 0,
                length: 3072
            }]
        );
    }

    #[test]
    fn nonsense_is_refused() {
        assert_eq!(parse(&words(&[9; 12])), Err(WireError::Command { command: 9 }));
        let too_long = submit_bytes(0, 1 << 20, 0);
        assert_eq!(
            parse(&too_long),
            Err(WireError::TooLong {
                length: 1 << 20,
                packets: 0
            })
        );
        assert!(parse(&submit_bytes(1, 0, 5000)).is_err());
    }

    #[test]
    fn an_iso_reply_has_header_data_and_packets() {
        let mut out = Vec::new();
        let results = [
            IsoResult {
                packet: IsoPacket { offset: 0, length: 10 },
                actual_length: 2,
            },
            IsoResult {
                packet: IsoPacket { offset: 10, length: 10 },
                actual_length: 0,
            },
        ];
        reply_iso(&mut out, 5, 0, (&results, &[8, 9]));
        assert_eq!(out.len(), 48 + 2 + 32);
        assert_eq!(out[..8], words(&[3, 5])[..]);
        assert_eq!(be32(&out, 24), 2);
        assert_eq!(be32(&out, 32), 2);
        assert_eq!(out[48..50], [8, 9]);
        assert_eq!(out[66..], words(&[10, 10, 0, 0])[..]);
    }

    #[test]
    fn an_unlink_reply_says_what_happened() {
        let mut out = Vec::new();
        reply_unlink(&mut out, 5, true);
        assert_eq!(out.len(), 48);
        assert_eq!(be32(&out, 20).cast_signed(), -104);
    }
}
