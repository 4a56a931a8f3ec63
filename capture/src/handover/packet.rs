//! A frame set as bytes, for the way through shared memory. Version 3, native byte order, everything without padding:
//!
//! | bytes | what |
//! | --- | --- |
//! | 48 | the set: magic, version, number of frames, running number of the set, length of the packet, whose pixels |
//! | 192 per frame | who, when, how, size, format, number of the block with the pixels, and their length |
//!
//! The pixels are not in the packet: they lie in blocks of shared memory that are sent before it, each with a running
//! number (`handover/pixels.rs`).
//!
//! A reader believes nothing: whatever the bytes are, [`decode`] returns records that keep every promise of [`Frame`],
//! or an error.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::format_code::{code_of, format_of};
use crate::frame::{BufferFlags, Exposure, Frame, FrameMeta, FrameSet, PixelFormat, SharedPlace, Size};
use crate::source::{CAMERAS_MAX, NAME_MAX_BYTES, SIDE_MAX_PX};

/// First bytes of every packet.
const MAGIC: [u8; 8] = *b"MIRRBALL";

/// Version of the layout; raised with every change to it.
pub const PACKET_VERSION: u32 = 3;

/// What a packet begins with.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct SetHeader {
    magic: [u8; 8],
    version: u32,
    n_frames: u32,
    set_number: u64,
    packet_bytes: u64,
    pixel_publisher: [u64; 2],
}

/// What stands for each frame.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct FrameHeader {
    name: [u8; NAME_MAX_BYTES],
    name_bytes: u32,
    format: u32,
    width: u32,
    height: u32,
    pixel_bytes: u64,
    block_number: u64,
    sequence: u64,
    timestamp_ns: u64,
    exposure_time_s: f64,
    gain: f64,
    white_balance: [f64; 3],
    residual: [f64; 3],
    bracket_step: u32,
    lost_before: u32,
    flags: u32,
    /// Always 0.
    reserved: u32,
}

const SET_HEADER_BYTES: usize = size_of::<SetHeader>();
const FRAME_HEADER_BYTES: usize = size_of::<FrameHeader>();

/// Why bytes are no frame set, or a frame set does not fit into a packet.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PacketError {
    /// The bytes do not begin as a packet does.
    #[error("the data does not begin with `MIRRBALL`, so it is no frame set")]
    NoPacket,
    /// The sender speaks another version.
    #[error("the sender uses packet version {found}, this program understands version {supported}")]
    Version {
        /// Version of the packet.
        found: u32,
        /// Version of this program.
        supported: u32,
    },
    /// The packet is shorter or longer than its headers say.
    #[error("the packet has {found_bytes} bytes, its headers say {expected_bytes}")]
    Length {
        /// Length of the data.
        found_bytes: u64,
        /// Length that follows from the headers.
        expected_bytes: u64,
    },
    /// The set has no frame or too many.
    #[error("the set has {n_frames} frames, allowed are 1..=16")]
    FrameCount {
        /// Number of frames.
        n_frames: u64,
    },
    /// A camera's name is empty, too long, no UTF-8, or there twice.
    #[error("frame {frame_index} has the camera name `{found}`, allowed is {allowed}")]
    CameraName {
        /// Index of the frame in the set.
        frame_index: usize,
        /// The name, unreadable characters replaced.
        found: String,
        /// What would be right.
        allowed: &'static str,
    },
    /// A frame has a pixel format this program does not know.
    #[error(
        "frame {frame_index} has pixel format {found}, known are 1 (RGB), 2 (grey), 3 (JPEG), 16..=19 (YUYV) and 32..=35 (NV12)"
    )]
    Format {
        /// Index of the frame in the set.
        frame_index: usize,
        /// Code of the format.
        found: u32,
    },
    /// A frame's size is out of range, or the length of its pixels does not follow from it.
    #[error(
        "frame {frame_index} is {width}×{height} px with {pixel_bytes} bytes, \
         allowed are 1..=16384 px and the bytes of its format"
    )]
    FrameSize {
        /// Index of the frame in the set.
        frame_index: usize,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Length of the pixels.
        pixel_bytes: u64,
    },
    /// The block with a frame's pixels is shorter or longer than its record says.
    #[error("the pixels of a frame have {found_bytes} bytes, its record says {expected_bytes}")]
    Pixels {
        /// Length of the pixels.
        found_bytes: usize,
        /// Length that the record gives.
        expected_bytes: usize,
    },
    /// A frame's exposure time, gain, white balance or residual is not a finite number above 0.
    #[error("frame {frame_index} has {quantity} = {found}, allowed is a finite number above 0")]
    Exposure {
        /// Index of the frame in the set.
        frame_index: usize,
        /// Which number.
        quantity: &'static str,
        /// Its value.
        found: f64,
    },
}

/// Length of the longest packet there is.
pub(super) const PACKET_MAX_BYTES: usize = packet_bytes(CAMERAS_MAX);

/// Length of the packet of a set of `n_frames`.
#[must_use]
pub const fn packet_bytes(n_frames: usize) -> usize {
    SET_HEADER_BYTES + n_frames * FRAME_HEADER_BYTES
}

/// What a packet says about one frame: everything but the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// Who, when, how.
    pub meta: FrameMeta,
    /// Width and height.
    pub size: Size,
    /// Layout of the pixels.
    pub format: PixelFormat,
    /// Running number of the block with the pixels, among those of their publisher.
    pub block_number: u64,
    /// Length of the pixels; the format and size admit it.
    pub pixel_bytes: usize,
}

/// What a packet says.
#[derive(Debug, Clone, PartialEq)]
pub struct SetRecord {
    /// Running number of the set.
    pub number: u64,
    /// Who has sent the blocks with the pixels.
    pub pixel_publisher: u128,
    /// Its frames, the leading camera's first.
    pub frames: Vec<FrameRecord>,
}

impl SetRecord {
    /// Where the pixels of a frame lie.
    pub(super) fn place_of(&self, frame: &FrameRecord) -> SharedPlace {
        SharedPlace {
            publisher: self.pixel_publisher,
            number: frame.block_number,
        }
    }
}

/// Writes the set, with its running number, into `packet`, which is [`packet_bytes`] long; the pixels of its frames
/// are in blocks of `pixel_publisher` with the numbers `blocks`, one per frame.
///
/// # Errors
///
/// [`PacketError`] if the set breaks a promise a reader checks; `packet` is then in an undefined state.
pub fn encode(
    set: &FrameSet,
    set_number: u64,
    pixel_publisher: u128,
    blocks: &[u64],
    packet: &mut [u8],
) -> Result<(), PacketError> {
    let n_frames = frame_count(set.frames.len() as u64)?;
    let (found_bytes, expected_bytes) = (packet.len() as u64, packet_bytes(n_frames) as u64);
    if found_bytes != expected_bytes {
        return Err(PacketError::Length {
            found_bytes,
            expected_bytes,
        });
    }
    let header = SetHeader {
        magic: MAGIC,
        version: PACKET_VERSION,
        n_frames: u32::try_from(n_frames).expect("the count was checked against a small maximum"),
        set_number,
        packet_bytes: expected_bytes,
        pixel_publisher: [pixel_publisher as u64, (pixel_publisher >> 64) as u64],
    };
    let (start, headers) = packet.split_at_mut(SET_HEADER_BYTES);
    start.copy_from_slice(bytemuck::bytes_of(&header));
    let places = headers.chunks_exact_mut(FRAME_HEADER_BYTES);
    for (index, ((frame, block_number), place)) in set.frames.iter().zip(blocks).zip(places).enumerate() {
        check_name_is_new(
            index,
            &frame.meta.camera,
            set.frames[..index].iter().map(|frame| &frame.meta),
        )?;
        place.copy_from_slice(bytemuck::bytes_of(&header_of(index, frame, *block_number)?));
    }
    Ok(())
}

/// Reads what `packet` says.
///
/// # Errors
///
/// [`PacketError`] if the bytes are not exactly one valid packet.
pub fn decode(packet: &[u8]) -> Result<SetRecord, PacketError> {
    let header = read_set_header(packet)?;
    let n_frames = frame_count(header.n_frames.into())?;
    let found_bytes = packet.len() as u64;
    for expected_bytes in [packet_bytes(n_frames) as u64, header.packet_bytes] {
        if expected_bytes != found_bytes {
            return Err(PacketError::Length {
                found_bytes,
                expected_bytes,
            });
        }
    }
    let mut frames: Vec<FrameRecord> = Vec::with_capacity(n_frames);
    for (index, bytes) in packet[SET_HEADER_BYTES..].chunks_exact(FRAME_HEADER_BYTES).enumerate() {
        let frame = read_frame(index, &bytemuck::pod_read_unaligned(bytes))?;
        check_name_is_new(index, &frame.meta.camera, frames.iter().map(|frame| &frame.meta))?;
        frames.push(frame);
    }
    let [low, high] = header.pixel_publisher;
    Ok(SetRecord {
        number: header.set_number,
        pixel_publisher: u128::from(high) << 64 | u128::from(low),
        frames,
    })
}

fn read_set_header(packet: &[u8]) -> Result<SetHeader, PacketError> {
    if !packet.starts_with(&MAGIC) {
        return Err(PacketError::NoPacket);
    }
    let Some(start) = packet.get(..SET_HEADER_BYTES) else {
        let (found_bytes, expected_bytes) = (packet.len() as u64, SET_HEADER_BYTES as u64);
        return Err(PacketError::Length {
            found_bytes,
            expected_bytes,
        });
    };
    let header: SetHeader = bytemuck::pod_read_unaligned(start);
    if header.version != PACKET_VERSION {
        return Err(PacketError::Version {
            found: header.version,
            supported: PACKET_VERSION,
        });
    }
    Ok(header)
}

fn frame_count(n_frames: u64) -> Result<usize, PacketError> {
    let count = usize::try_from(n_frames)
        .ok()
        .filter(|count| (1..=CAMERAS_MAX).contains(count));
    count.ok_or(PacketError::FrameCount { n_frames })
}

fn header_of(frame_index: usize, frame: &Frame, block_number: u64) -> Result<FrameHeader, PacketError> {
    let camera = &frame.meta.camera;
    let mut name = [0; NAME_MAX_BYTES];
    if camera.is_empty() || camera.len() > NAME_MAX_BYTES {
        return Err(PacketError::CameraName {
            frame_index,
            found: camera.to_string(),
            allowed: "1 to 64 bytes",
        });
    }
    name[..camera.len()].copy_from_slice(camera.as_bytes());
    check_exposure(frame_index, &frame.meta.exposure, frame.meta.residual)?;
    let header = FrameHeader {
        name,
        name_bytes: u32::try_from(camera.len()).expect("the length was checked against a small maximum"),
        format: code_of(frame.format),
        width: frame.size.width,
        height: frame.size.height,
        pixel_bytes: frame.pixels.len() as u64,
        block_number,
        sequence: frame.meta.sequence,
        timestamp_ns: frame.meta.timestamp_ns,
        exposure_time_s: frame.meta.exposure.time_s,
        gain: frame.meta.exposure.gain,
        white_balance: frame.meta.exposure.white_balance,
        residual: frame.meta.residual,
        bracket_step: frame.meta.bracket_step,
        lost_before: frame.meta.lost_before,
        flags: frame.meta.flags.0,
        reserved: 0,
    };
    check_format_and_size(frame_index, &header)?;
    Ok(header)
}

fn read_frame(frame_index: usize, header: &FrameHeader) -> Result<FrameRecord, PacketError> {
    let format = check_format_and_size(frame_index, header)?;
    let exposure = Exposure {
        time_s: header.exposure_time_s,
        gain: header.gain,
        white_balance: header.white_balance,
    };
    check_exposure(frame_index, &exposure, header.residual)?;
    let meta = FrameMeta {
        camera: read_name(frame_index, header)?,
        sequence: header.sequence,
        timestamp_ns: header.timestamp_ns,
        exposure,
        residual: header.residual,
        bracket_step: header.bracket_step,
        lost_before: header.lost_before,
        flags: BufferFlags(header.flags),
    };
    let size = Size {
        width: header.width,
        height: header.height,
    };
    Ok(FrameRecord {
        meta,
        size,
        format,
        block_number: header.block_number,
        pixel_bytes: header.pixel_bytes as usize,
    })
}

fn read_name(frame_index: usize, header: &FrameHeader) -> Result<Arc<str>, PacketError> {
    let bytes = header.name.get(..header.name_bytes as usize).unwrap_or_default();
    match std::str::from_utf8(bytes) {
        Ok(name) if !name.is_empty() => Ok(name.into()),
        Ok(_) | Err(_) => Err(PacketError::CameraName {
            frame_index,
            found: String::from_utf8_lossy(&header.name).trim_end_matches('\0').to_owned(),
            allowed: "1 to 64 bytes of UTF-8",
        }),
    }
}

fn check_name_is_new<'a>(
    frame_index: usize,
    camera: &str,
    mut before: impl Iterator<Item = &'a FrameMeta>,
) -> Result<(), PacketError> {
    if before.any(|meta| &*meta.camera == camera) {
        let found = camera.to_owned();
        return Err(PacketError::CameraName {
            frame_index,
            found,
            allowed: "one frame per camera",
        });
    }
    Ok(())
}

fn check_format_and_size(frame_index: usize, header: &FrameHeader) -> Result<PixelFormat, PacketError> {
    let format = format_of(header.format).ok_or(PacketError::Format {
        frame_index,
        found: header.format,
    })?;
    let FrameHeader {
        width,
        height,
        pixel_bytes,
        ..
    } = *header;
    let in_range = [width, height].iter().all(|side| (1..=SIDE_MAX_PX).contains(side));
    let admits = |n_bytes| format.admits(Size { width, height }, n_bytes);
    if !in_range || !usize::try_from(pixel_bytes).is_ok_and(admits) {
        return Err(PacketError::FrameSize {
            frame_index,
            width,
            height,
            pixel_bytes,
        });
    }
    Ok(format)
}

fn check_exposure(frame_index: usize, exposure: &Exposure, residual: [f64; 3]) -> Result<(), PacketError> {
    let [red, green, blue] = exposure.white_balance;
    let quantities = [
        ("exposure time", exposure.time_s),
        ("gain", exposure.gain),
        ("red white balance", red),
        ("green white balance", green),
        ("blue white balance", blue),
        ("red residual", residual[0]),
        ("green residual", residual[1]),
        ("blue residual", residual[2]),
    ];
    match quantities
        .into_iter()
        .find(|(_, value)| !value.is_finite() || *value <= 0.0)
    {
        Some((quantity, found)) => Err(PacketError::Exposure {
            frame_index,
            quantity,
            found,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PUBLISHER: u128 = 0x0123_4567_89AB_CDEF_0011_2233_4455_6677;

    fn frame(camera: &str, size: Size, seed: u8) -> Frame {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 2.0,
            white_balance: [1.5, 1.0, 1.25],
        };
        let meta = FrameMeta {
            residual: [1.0, 1.01, 0.99],
            bracket_step: 2,
            lost_before: 3,
            flags: BufferFlags(0x2001),
            ..FrameMeta::new(camera.into(), 7, 1 << 40, exposure)
        };
        let pixels: Vec<u8> = (0..size.pixels() * 3)
            .map(|index| (index as u8).wrapping_mul(seed))
            .collect();
        Frame {
            meta,
            size,
            format: PixelFormat::Rgb8,
            pixels: pixels.into(),
        }
    }

    fn set() -> FrameSet {
        let sizes = [Size { width: 5, height: 3 }, Size { width: 2, height: 7 }];
        FrameSet {
            frames: vec![frame("scene", sizes[0], 3), frame("probe ✓", sizes[1], 5)],
        }
    }

    fn encoded(set: &FrameSet, number: u64) -> Result<Vec<u8>, PacketError> {
        let mut packet = vec![0xAA; packet_bytes(set.frames.len())];
        let blocks: Vec<u64> = (1..).take(set.frames.len()).collect();
        encode(set, number, PUBLISHER, &blocks, &mut packet).map(|()| packet)
    }

    #[test]
    fn headers_have_the_sizes_they_are_documented_with() {
        assert_eq!((SET_HEADER_BYTES, FRAME_HEADER_BYTES), (48, 192));
    }

    #[test]
    fn a_set_comes_back_as_it_was() {
        let set = set();
        let back = decode(&encoded(&set, 99).unwrap()).unwrap();
        assert_eq!((back.number, back.pixel_publisher), (99, PUBLISHER));
        assert_eq!(back.frames.len(), 2);
        for ((frame, back), number) in set.frames.iter().zip(&back.frames).zip(1..) {
            assert_eq!(frame.meta, back.meta);
            assert_eq!((frame.size, frame.format), (back.size, back.format));
            assert_eq!((frame.pixels.len(), number), (back.pixel_bytes, back.block_number));
        }
    }

    #[test]
    fn another_version_is_named() {
        let mut packet = encoded(&set(), 0).unwrap();
        packet[8] = 1;
        assert_eq!(
            decode(&packet).unwrap_err(),
            PacketError::Version { found: 1, supported: 3 }
        );
    }

    #[test]
    fn every_wrong_length_is_refused() {
        let packet = encoded(&set(), 0).unwrap();
        for bytes in 0..packet.len() {
            assert!(decode(&packet[..bytes]).is_err(), "{bytes}");
        }
        let longer = [&packet[..], &[0]].concat();
        assert!(matches!(decode(&longer).unwrap_err(), PacketError::Length { .. }));
    }

    #[test]
    fn a_set_that_breaks_a_promise_is_not_sent() {
        let size = Size { width: 2, height: 2 };
        let good = frame("a", size, 1);
        let broken = |change: fn(&mut Frame)| {
            let mut frame = good.clone();
            change(&mut frame);
            encoded(&FrameSet { frames: vec![frame] }, 0).unwrap_err()
        };
        assert!(matches!(
            broken(|f| f.meta.camera = "".into()),
            PacketError::CameraName { .. }
        ));
        assert!(matches!(
            broken(|f| f.meta.camera = "x".repeat(65).into()),
            PacketError::CameraName { .. }
        ));
        assert!(matches!(broken(|f| f.size.width = 3), PacketError::FrameSize { .. }));
        assert!(matches!(
            broken(|f| f.pixels = vec![0; 5].into()),
            PacketError::FrameSize { .. }
        ));
        assert!(matches!(
            broken(|f| f.meta.exposure.gain = f64::NAN),
            PacketError::Exposure { quantity: "gain", .. }
        ));
        assert!(matches!(
            broken(|f| f.meta.exposure.time_s = 0.0),
            PacketError::Exposure { .. }
        ));
        let twice = encoded(
            &FrameSet {
                frames: vec![good.clone(), good.clone()],
            },
            0,
        )
        .unwrap_err();
        assert!(matches!(twice, PacketError::CameraName { frame_index: 1, .. }));
        let none = encoded(&FrameSet { frames: vec![] }, 0).unwrap_err();
        assert_eq!(none, PacketError::FrameCount { n_frames: 0 });
        let many = FrameSet {
            frames: (0..17).map(|i| frame(&i.to_string(), size, 1)).collect(),
        };
        assert_eq!(encoded(&many, 0).unwrap_err(), PacketError::FrameCount { n_frames: 17 });
    }

    /// What decoding promises of a set, whatever the bytes were.
    fn keeps_promises(set: &SetRecord) -> bool {
        let is_good = |frame: &FrameRecord| {
            let exposure = &frame.meta.exposure;
            let numbers = [
                &[exposure.time_s, exposure.gain],
                &exposure.white_balance[..],
                &frame.meta.residual,
            ]
            .concat();
            frame.format.admits(frame.size, frame.pixel_bytes)
                && (1..=NAME_MAX_BYTES).contains(&frame.meta.camera.len())
                && numbers.iter().all(|number| number.is_finite() && *number > 0.0)
        };
        !set.frames.is_empty() && set.frames.iter().all(is_good)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            prop_assert!(decode(&bytes).map_or(true, |set| keeps_promises(&set)));
            let with_start = [&MAGIC[..], &PACKET_VERSION.to_ne_bytes(), &bytes].concat();
            prop_assert!(decode(&with_start).map_or(true, |set| keeps_promises(&set)));
        }

        #[test]
        fn no_corruption_panics(
            changes in proptest::collection::vec((0usize..432, any::<u8>()), 1..6), cut in 0usize..500,
        ) {
            let mut packet = encoded(&set(), 1).unwrap();
            for (place, value) in changes {
                packet[place] = value;
            }
            prop_assert!(decode(&packet).map_or(true, |set| keeps_promises(&set)));
            packet.truncate(cut);
            prop_assert!(decode(&packet).map_or(true, |set| keeps_promises(&set)));
        }
    }
}
