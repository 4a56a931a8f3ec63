//! MCAP recordings: what is recorded is played, byte for byte, whatever happens to the file.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;
use std::time::Duration;

use foxglove::Decode;
use foxglove::messages::{CompressedImage, RawImage};
use mirrorball_capture::recording::mcap::{
    ChunkCompression, Ending, EventKind, McapPlayer, McapReadError, RecordError, Recorded, Recorder, RecorderOptions,
    RecordingEvent,
};
use mirrorball_capture::{
    BufferFlags, CameraDescription, CameraRole, Exposure, Frame, FrameMeta, Next, Pace, PixelFormat, Repeat, Size,
    Source, SourceError, Ycbcr, YcbcrMatrix, YcbcrRange, open_recording,
};
use proptest::prelude::*;

const BT601: Ycbcr = Ycbcr {
    matrix: YcbcrMatrix::Bt601,
    range: YcbcrRange::Limited,
};

const BT709_FULL: Ycbcr = Ycbcr {
    matrix: YcbcrMatrix::Bt709,
    range: YcbcrRange::Full,
};

const FORMATS: [PixelFormat; 7] = [
    PixelFormat::Rgb8,
    PixelFormat::Grey8,
    PixelFormat::Yuyv(BT601),
    PixelFormat::Yuyv(BT709_FULL),
    PixelFormat::Nv12(BT601),
    PixelFormat::Nv12(BT709_FULL),
    PixelFormat::Mjpeg,
];

const SIZE: Size = Size { width: 8, height: 6 };

fn camera(name: &str, role: CameraRole, format: PixelFormat) -> CameraDescription {
    CameraDescription {
        name: name.into(),
        role,
        size: SIZE,
        format,
    }
}

fn two_cameras() -> Vec<CameraDescription> {
    vec![
        camera("scene", CameraRole::Scene, PixelFormat::Nv12(BT601)),
        camera("probe", CameraRole::Ball, PixelFormat::Mjpeg),
    ]
}

/// A frame of which every byte follows from its number.
fn frame(camera: &CameraDescription, number: u64) -> Frame {
    let exposure = Exposure {
        time_s: 0.001 * (number + 1) as f64 / 3.0,
        gain: 1.0 + number as f64 / 7.0,
        white_balance: [1.0, 1.25, 1.5],
    };
    let mut meta = FrameMeta::new(
        camera.name.clone(),
        number,
        1_000_000_000 + number * 10_000_000,
        exposure,
    );
    meta.residual = [1.0 / 3.0, 1.0, 1.1];
    meta.bracket_step = (number % 3) as u32;
    meta.flags = BufferFlags(0x2041);
    let n_bytes = match camera.format {
        PixelFormat::Mjpeg => 20 + number as usize % 50,
        other => other.max_bytes(camera.size),
    };
    let pixels: Vec<u8> = (0..n_bytes).map(|index| (index as u64 * 7 + number) as u8).collect();
    Frame {
        meta,
        size: camera.size,
        format: camera.format,
        pixels: pixels.into(),
    }
}

/// Options under which every frame makes a chunk of its own.
fn small_chunks() -> RecorderOptions {
    RecorderOptions {
        chunk_bytes: 1,
        ..RecorderOptions::default()
    }
}

fn record(path: &Path, cameras: &[CameraDescription], frames: &[Frame], options: RecorderOptions) {
    let mut recorder = Recorder::create(path, cameras, options).unwrap();
    for frame in frames {
        assert_eq!(recorder.record_or_wait(frame.clone()), Recorded::Queued);
    }
    let stats = recorder.finish().unwrap();
    assert_eq!(
        (stats.frames, stats.safe_frames),
        (frames.len() as u64, frames.len() as u64)
    );
    assert_eq!((stats.lost_frames, stats.queued_frames, stats.queued_bytes), (0, 0, 0));
    assert_eq!(stats.bytes, fs::metadata(path).unwrap().len());
}

/// Frames of both cameras in turn.
fn frames_of(cameras: &[CameraDescription], n_each: u64) -> Vec<Frame> {
    let in_turn = |number| cameras.iter().map(move |camera| frame(camera, number));
    (0..n_each).flat_map(in_turn).collect()
}

fn open(path: &Path) -> Result<McapPlayer, SourceError> {
    McapPlayer::open(path, Pace::Max, Repeat::ONCE)
}

/// All good frames, and the errors between them.
fn play(mut player: impl Source) -> (Vec<Frame>, Vec<SourceError>) {
    let (mut frames, mut errors) = (Vec::new(), Vec::new());
    loop {
        match player.next_frame(Duration::from_secs(60)) {
            Ok(Next::Frame(frame)) => frames.push(frame),
            Ok(Next::TimedOut) => panic!("no recording here is that long"),
            Ok(Next::End) => break,
            Err(error) => {
                assert!(error.is_skippable(), "{error}");
                errors.push(error);
            }
        }
    }
    assert!(
        matches!(player.next_frame(Duration::ZERO), Ok(Next::End)),
        "the end stays the end"
    );
    (frames, errors)
}

fn assert_same(found: &[Frame], expected: &[Frame]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.meta, expected.meta);
        assert_eq!((found.size, found.format), (expected.size, expected.format));
        assert!(*found.pixels == *expected.pixels, "the pixels differ");
    }
}

fn options() -> impl Strategy<Value = RecorderOptions> {
    let compression = prop_oneof![Just(ChunkCompression::None), Just(ChunkCompression::Lz4)];
    (compression, 1u64..100_000).prop_map(|(compression, chunk_bytes)| RecorderOptions {
        compression,
        chunk_bytes,
        ..RecorderOptions::default()
    })
}

fn any_frame() -> impl Strategy<Value = (usize, u64, u64, [f64; 8], [u32; 3], Vec<u8>)> {
    let positive = || 1e-9f64..1e9;
    let bytes = proptest::collection::vec(any::<u8>(), 1..200);
    let factors = proptest::array::uniform8(positive());
    (
        0usize..FORMATS.len(),
        1u64..1 << 40,
        1u64..1 << 40,
        factors,
        any::<[u32; 3]>(),
        bytes,
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_recorded_is_played(
        options in options(), steps in proptest::collection::vec(any_frame(), 1..30),
        sides in (1u32..9, 1u32..9),
    ) {
        let size = Size { width: sides.0 * 2, height: sides.1 * 2 };
        let cameras: Vec<_> = FORMATS.iter().enumerate().map(|(index, &format)| {
            let role = if index == 0 { CameraRole::Scene } else { CameraRole::Fisheye };
            CameraDescription { size, ..camera(&format!("camera {index}"), role, format) }
        }).collect();
        let (mut stamps, mut frames) = ([(0, 0); FORMATS.len()], vec![]);
        // The leading camera has a frame.
        let mut steps = steps;
        steps[0].0 = 0;
        for (index, ns, sequences, factors, [bracket_step, lost_before, flags], bytes) in steps {
            let stamp = &mut stamps[index];
            *stamp = (stamp.0 + ns, stamp.1 + sequences);
            let [time_s, gain, r, g, b, rr, rg, rb] = factors;
            let exposure = Exposure { time_s, gain, white_balance: [r, g, b] };
            let mut meta = FrameMeta::new(cameras[index].name.clone(), stamp.1, stamp.0, exposure);
            meta.residual = [rr, rg, rb];
            (meta.bracket_step, meta.lost_before, meta.flags) = (bracket_step, lost_before, BufferFlags(flags));
            let n_bytes = match FORMATS[index] {
                PixelFormat::Mjpeg => bytes.len().min(size.pixels() * 3),
                format => format.max_bytes(size),
            };
            let pixels: Vec<u8> = bytes.iter().copied().cycle().take(n_bytes).collect();
            frames.push(Frame { meta, size, format: FORMATS[index], pixels: pixels.into() });
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path, &cameras, &frames, options);
        let player = open(&path).unwrap();
        prop_assert_eq!(player.ending(), Ending::Complete);
        let (played, errors) = play(player);
        prop_assert!(errors.is_empty());
        assert_same(&played, &frames);
    }
}
