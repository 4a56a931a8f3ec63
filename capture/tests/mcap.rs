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

/// A recording of 2 × `n_each` frames, a chunk for each, and its bytes.
fn recording(n_each: u64) -> (tempfile::TempDir, Vec<Frame>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frames = frames_of(&two_cameras(), n_each);
    record(&path, &two_cameras(), &frames, small_chunks());
    let bytes = fs::read(path).unwrap();
    (folder, frames, bytes)
}

/// Plays these bytes as a file.
fn play_bytes(bytes: &[u8]) -> Result<(Ending, Vec<Frame>, Vec<SourceError>), SourceError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), bytes).unwrap();
    let player = open(file.path())?;
    let ending = player.ending();
    let (frames, errors) = play(player);
    Ok((ending, frames, errors))
}

fn mcap_error(result: Result<(Ending, Vec<Frame>, Vec<SourceError>), SourceError>) -> McapReadError {
    match result.unwrap_err() {
        SourceError::Mcap(error) => error,
        other => panic!("{other}"),
    }
}

/// Where the file's records end, the bytes of magic not counted as a record.
fn record_ends(bytes: &[u8]) -> Vec<usize> {
    let mut ends = vec![8];
    while let Some(head) = bytes.get(*ends.last().unwrap()..).and_then(|rest| rest.get(..9)) {
        let length = u64::from_le_bytes(head[1..].try_into().unwrap());
        let end = (*ends.last().unwrap() as u64 + 9).checked_add(length).unwrap();
        if end > bytes.len() as u64 {
            break;
        }
        ends.push(end as usize);
    }
    ends
}

#[test]
fn mcap_and_foxglove_read_what_we_write() {
    let (_folder, frames, bytes) = recording(3);
    let options = mcap::sans_io::LinearReaderOptions::default().with_validate_chunk_crcs(true);
    let reader = mcap::io::MessageReader::new_with_options(std::io::Cursor::new(&bytes), options);
    let messages: Vec<_> = reader.map(Result::unwrap).collect();
    assert_eq!(messages.len(), 2 * frames.len());
    for (pair, frame) in messages.chunks_exact(2).zip(&frames) {
        let camera = &*frame.meta.camera;
        assert_eq!(pair[0].channel.topic, format!("/{camera}/frame"));
        assert_eq!(pair[1].channel.topic, format!("/{camera}/image"));
        assert!(pair.iter().all(|message| message.log_time == frame.meta.timestamp_ns));
        let json: serde_json::Value = serde_json::from_slice(&pair[0].data).unwrap();
        assert_eq!(json["sequence"], frame.meta.sequence);
        assert_eq!(json["exposure_s"], frame.meta.exposure.time_s);
        let schema = pair[1].channel.schema.as_ref().unwrap();
        if frame.format == PixelFormat::Mjpeg {
            assert_eq!(schema.name, "foxglove.CompressedImage");
            let image = CompressedImage::decode(&*pair[1].data).unwrap();
            assert_eq!((image.format.as_str(), image.frame_id.as_str()), ("jpeg", camera));
            assert!(*image.data == *frame.pixels);
        } else {
            assert_eq!(schema.name, "foxglove.RawImage");
            let image = RawImage::decode(&*pair[1].data).unwrap();
            assert_eq!((image.width, image.height, image.step), (8, 6, 8));
            assert_eq!(image.encoding, "nv12");
            assert_eq!(image.timestamp.unwrap().sec(), 1);
            assert!(*image.data == *frame.pixels);
        }
    }
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 2 * frames.len() as u64);
}

#[test]
fn a_file_cut_anywhere_plays_its_whole_chunks() {
    let (_folder, frames, bytes) = recording(2);
    // Where the chunk of each frame ends; the first chunk holds the channels.
    let ends = record_ends(&bytes);
    let chunk_ends: Vec<usize> = ends
        .windows(2)
        .filter(|pair| bytes[pair[0]] == 0x06)
        .map(|pair| pair[1])
        .collect();
    assert_eq!(chunk_ends.len(), 1 + frames.len());
    let first_leader_end = chunk_ends[1];
    for length in 0..bytes.len() {
        let n_whole = chunk_ends
            .iter()
            .filter(|&&end| end <= length)
            .count()
            .saturating_sub(1);
        let result = play_bytes(&bytes[..length]);
        if length < first_leader_end {
            let error = mcap_error(result);
            assert!(!error.is_skippable() && !error.hint().is_empty(), "{error}");
            continue;
        }
        let (ending, played, errors) = result.unwrap();
        assert!(errors.is_empty(), "{length}: {errors:?}");
        assert_same(&played, &frames[..n_whole]);
        let last_end = *ends.iter().rfind(|&&end| end <= length).unwrap();
        let is_data_over = bytes[..last_end].len() > *chunk_ends.last().unwrap() && n_whole == frames.len();
        match ending {
            Ending::Complete => panic!("it is cut"),
            Ending::NoSummary => assert!(last_end == length || is_data_over),
            Ending::CutOff { lost_bytes, .. } => assert_eq!(lost_bytes, (length - last_end) as u64),
        }
    }
    assert_eq!(play_bytes(&bytes).unwrap().0, Ending::Complete);
}

#[test]
fn frames_in_a_chunk_that_is_cut_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let cameras = two_cameras();
    let frames = frames_of(&cameras, 5);
    record(&path, &cameras, &frames, RecorderOptions::default());
    let bytes = fs::read(path).unwrap();
    let ends = record_ends(&bytes);
    let chunk = ends.windows(2).filter(|pair| bytes[pair[0]] == 0x06).nth(1).unwrap();
    // All frames are in one chunk, which loses its last byte.
    let error = mcap_error(play_bytes(&bytes[..chunk[1] - 1]));
    assert!(matches!(error, McapReadError::NoLeaderFrame { .. }), "{error}");
    let path = folder.path().join("b.mcap");
    let options = RecorderOptions {
        chunk_bytes: 400,
        ..RecorderOptions::default()
    };
    record(&path, &cameras, &frames, options);
    let bytes = fs::read(path).unwrap();
    let chunks: Vec<_> = record_ends(&bytes)
        .windows(2)
        .filter(|pair| bytes[pair[0]] == 0x06)
        .map(|pair| pair[1])
        .collect();
    let (ending, played, _) = play_bytes(&bytes[..chunks[3] - 1]).unwrap();
    let (_, more, _) = play_bytes(&bytes[..chunks[3]]).unwrap();
    let Ending::CutOff { lost_frames, .. } = ending else {
        panic!("{ending:?}")
    };
    assert_eq!(lost_frames, (more.len() - played.len()) as u64);
    assert!(lost_frames > 0);
}

#[test]
fn a_bad_chunk_is_skipped_and_named() {
    let (_folder, frames, mut bytes) = recording(4);
    let ends = record_ends(&bytes);
    let chunks: Vec<_> = ends
        .windows(2)
        .filter(|pair| bytes[pair[0]] == 0x06)
        .map(|pair| pair[1])
        .collect();
    bytes[chunks[3] - 1] ^= 1;
    let (ending, played, errors) = play_bytes(&bytes).unwrap();
    assert_eq!(ending, Ending::Complete);
    assert_same(&played[..2], &frames[..2]);
    assert_same(&played[2..], &frames[3..]);
    let [SourceError::Mcap(McapReadError::BadChunk { reason, .. })] = &errors[..] else {
        panic!("{errors:?}")
    };
    assert!(reason.contains("check sum"), "{reason}");
}

#[test]
fn a_wrong_length_loses_one_chunk_and_no_more() {
    let (_folder, frames, mut bytes) = recording(4);
    let ends = record_ends(&bytes);
    let chunks: Vec<_> = ends
        .windows(2)
        .filter(|pair| bytes[pair[0]] == 0x06)
        .map(|pair| pair[0])
        .collect();
    // The upper byte of the length of the chunk of frame 2.
    bytes[chunks[3] + 8] = 0x40;
    let (ending, played, errors) = play_bytes(&bytes).unwrap();
    assert_eq!(ending, Ending::Complete);
    assert_same(&played[2..], &frames[3..]);
    let [SourceError::Mcap(McapReadError::Damage { from, to, .. })] = &errors[..] else {
        panic!("{errors:?}")
    };
    assert_eq!((*from, *to), (chunks[3] as u64, chunks[4] as u64));
}

#[test]
fn other_files_are_refused() {
    let (_folder, _, bytes) = recording(1);
    assert!(matches!(mcap_error(play_bytes(b"")), McapReadError::NotMcap { .. }));
    assert!(matches!(
        mcap_error(play_bytes(b"\x89PNG\r\n\x1a\n not")),
        McapReadError::NotMcap { .. }
    ));
    let mut foreign = Vec::new();
    let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut foreign)).unwrap();
    let channel = writer
        .add_channel(0, "/camera/image", "json", &Default::default())
        .unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    writer.finish().unwrap();
    drop(writer);
    let error = mcap_error(play_bytes(&foreign));
    assert!(matches!(error, McapReadError::Foreign { .. }), "{error}");
    let version = b"format_version\x01\x00\x00\x001";
    let place = bytes
        .windows(version.len())
        .position(|window| window == version)
        .unwrap();
    let mut newer = bytes;
    newer[place + version.len() - 1] = b'2';
    let error = mcap_error(play_bytes(&newer));
    assert!(
        matches!(&error, McapReadError::Version { found, .. } if found == "2"),
        "{error}"
    );
    let missing = open_recording(Path::new("/no/such/file"), Pace::Max, Repeat::ONCE)
        .map(|_| ())
        .unwrap_err();
    assert!(missing.to_string().contains("/no/such/file"), "{missing}");
}

#[test]
fn a_camera_without_frames_is_left_out_and_one_must_lead() {
    let folder = tempfile::tempdir().unwrap();
    let cameras = two_cameras();
    let path = folder.path().join("scene.mcap");
    record(
        &path,
        &cameras,
        &frames_of(&cameras[..1], 2),
        RecorderOptions::default(),
    );
    let player = open(&path).unwrap();
    assert_eq!(player.cameras(), &cameras[..1]);
    assert_eq!(play(player).0.len(), 2);
    let path = folder.path().join("probe.mcap");
    record(
        &path,
        &cameras,
        &frames_of(&cameras[1..], 2),
        RecorderOptions::default(),
    );
    let error = open(&path).map(|_| ()).unwrap_err();
    assert!(
        matches!(error, SourceError::Mcap(McapReadError::NoLeaderFrame { .. })),
        "{error}"
    );
    let path = folder.path().join("nobody.mcap");
    record(
        &path,
        &cameras[1..],
        &frames_of(&cameras[1..], 2),
        RecorderOptions::default(),
    );
    let error = open(&path).map(|_| ()).unwrap_err();
    assert!(
        matches!(error, SourceError::Mcap(McapReadError::Leader { n_leaders: 0, .. })),
        "{error}"
    );
}

#[test]
fn a_camera_may_come_late() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let cameras = two_cameras();
    let mut recorder = Recorder::create(&path, &cameras[..1], small_chunks()).unwrap();
    assert_eq!(recorder.record(frame(&cameras[0], 0)), Recorded::Queued);
    assert_eq!(recorder.record(frame(&cameras[1], 0)), Recorded::Lost);
    recorder.add_camera(&cameras[1]).unwrap();
    assert!(matches!(
        recorder.add_camera(&cameras[1]),
        Err(RecordError::Camera { .. })
    ));
    for number in 1..4 {
        assert_eq!(recorder.record(frame(&cameras[1], number)), Recorded::Queued);
    }
    assert_eq!(recorder.finish().unwrap().lost_frames, 1);
    let player = open(&path).unwrap();
    assert_eq!(player.cameras(), cameras);
    assert_eq!(play(player).0.len(), 4);
}

#[test]
fn frames_that_break_a_promise_are_lost_and_not_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let cameras = two_cameras();
    let mut recorder = Recorder::create(&path, &cameras, small_chunks()).unwrap();
    let good = |number| frame(&cameras[0], number);
    assert_eq!(recorder.record(good(5)), Recorded::Queued);
    assert_eq!(recorder.record(good(5)), Recorded::Lost);
    let mut bad = good(6);
    bad.meta.exposure.gain = f64::NAN;
    assert_eq!(recorder.record(bad), Recorded::Lost);
    let mut bad = good(7);
    bad.format = PixelFormat::Grey8;
    assert_eq!(recorder.record(bad), Recorded::Lost);
    let mut bad = good(8);
    bad.pixels = vec![0; 3].into();
    assert_eq!(recorder.record(bad), Recorded::Lost);
    assert_eq!(recorder.record(good(9)), Recorded::Queued);
    assert_eq!(recorder.finish().unwrap().lost_frames, 4);
    let (frames, errors) = play(open(&path).unwrap());
    assert!(errors.is_empty());
    assert_eq!(
        frames.iter().map(|frame| frame.meta.sequence).collect::<Vec<_>>(),
        [5, 9]
    );
    assert_eq!(frames[1].meta.lost_before, 4);
    let report = mirrorball_capture::recording::report_on(&path).unwrap();
    let causes = &report.cameras[0].lost_by_cause;
    assert_eq!(report.cameras[0].lost_frames, 4);
    assert_eq!(
        (causes["other_format"], causes["bad_exposure"], causes["unexplained"]),
        (2, 1, 1)
    );
}

#[test]
fn recordings_are_never_overwritten() {
    let (folder, ..) = recording(1);
    let path = folder.path().join("a.mcap");
    let error = Recorder::create(&path, &two_cameras(), RecorderOptions::default())
        .map(drop)
        .unwrap_err();
    assert!(
        matches!(error, RecordError::Exists { .. }) && error.is_bad_input(),
        "{error}"
    );
    let path = folder.path().join("no/such/folder/a.mcap");
    let error = Recorder::create(&path, &two_cameras(), RecorderOptions::default())
        .map(drop)
        .unwrap_err();
    assert!(matches!(error, RecordError::Create { .. }), "{error}");
    let twice = [two_cameras(), two_cameras()].concat();
    let error = Recorder::create(&path, &twice, RecorderOptions::default())
        .map(drop)
        .unwrap_err();
    assert!(matches!(error, RecordError::Camera { .. }), "{error}");
}

#[test]
fn repeated_recordings_go_on_rising() {
    let (folder, frames, _) = recording(3);
    let path = folder.path().join("a.mcap");
    let repeat = Repeat::Times(NonZeroU32::new(3).unwrap());
    let (played, _) = play(McapPlayer::open(&path, Pace::Max, repeat).unwrap());
    assert_eq!(played.len(), 3 * frames.len());
    for camera in two_cameras() {
        let metas: Vec<_> = played
            .iter()
            .map(|frame| &frame.meta)
            .filter(|meta| meta.camera == camera.name)
            .collect();
        let stamps: Vec<_> = metas.iter().map(|meta| meta.timestamp_ns).collect();
        // 100 frames/s, without a break between rounds.
        assert!(
            stamps.windows(2).all(|pair| pair[1] - pair[0] == 10_000_000),
            "{stamps:?}"
        );
        let sequences: Vec<_> = metas.iter().map(|meta| meta.sequence).collect();
        assert_eq!(sequences, (0..9).collect::<Vec<_>>());
    }
}

#[test]
fn the_recorded_pace_waits_and_says_so() {
    let (folder, ..) = recording(3);
    let mut player = McapPlayer::open(&folder.path().join("a.mcap"), Pace::Recorded, Repeat::ONCE).unwrap();
    let started = std::time::Instant::now();
    let (mut n_frames, mut n_timeouts) = (0, 0);
    loop {
        match player.next_frame(Duration::from_millis(1)).unwrap() {
            Next::Frame(_) => n_frames += 1,
            Next::TimedOut => n_timeouts += 1,
            Next::End => break,
        }
    }
    assert!(n_frames == 6 && n_timeouts > 0);
    assert!(started.elapsed() >= Duration::from_millis(20));
}

#[test]
fn events_and_the_rig_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let cameras = two_cameras();
    let options = RecorderOptions {
        rig: Some("version = 1\n".to_owned()),
        config: Some("x = 1\n".to_owned()),
        ..RecorderOptions::default()
    };
    let mut recorder = Recorder::create(&path, &cameras, options).unwrap();
    let kind = EventKind::Control {
        control: "gain".to_owned(),
        value: -3,
    };
    let event = RecordingEvent {
        timestamp_ns: 7,
        camera: Some("scene".to_owned()),
        kind,
    };
    recorder.event(event.clone());
    for number in [0, 4] {
        recorder.record(frame(&cameras[0], number));
    }
    let lost = EventKind::Lost {
        frames: 2,
        cause: "driver".to_owned(),
    };
    let timestamp_ns = frame(&cameras[0], 2).meta.timestamp_ns;
    recorder.event(RecordingEvent {
        timestamp_ns,
        camera: Some("scene".to_owned()),
        kind: lost,
    });
    recorder.finish().unwrap();
    assert_eq!(open(&path).unwrap().rig(), Some("version = 1\n"));
    let report = mirrorball_capture::recording::report_on(&path).unwrap();
    assert_eq!(report.events, [event]);
    assert!(report.has_rig && report.ending == Ending::Complete);
    let scene = &report.cameras[0];
    assert_eq!((scene.frames, scene.lost_frames, scene.n_gaps), (2, 3, 1));
    assert_eq!(
        (scene.lost_by_cause["driver"], scene.lost_by_cause["unexplained"]),
        (2, 1)
    );
    assert_eq!(report.cameras[1].frames, 0);
}

/// Both kinds of chunks, small enough to be spoilt everywhere.
fn spoilt() -> impl Strategy<
    Value = (
        ChunkCompression,
        u64,
        Vec<(prop::sample::Index, u8)>,
        prop::sample::Index,
    ),
> {
    let compression = prop_oneof![Just(ChunkCompression::None), Just(ChunkCompression::Lz4)];
    let flips = proptest::collection::vec((any::<prop::sample::Index>(), 1u8..=255), 1..6);
    (compression, 1u64..2000, flips, any::<prop::sample::Index>())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn spoilt_files_never_panic_and_show_no_false_frame((compression, chunk_bytes, flips, cut) in spoilt()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let frames = frames_of(&two_cameras(), 4);
        let options = RecorderOptions { compression, chunk_bytes, ..RecorderOptions::default() };
        record(&path, &two_cameras(), &frames, options);
        let mut bytes = fs::read(&path).unwrap();
        if cut.index(4) == 0 {
            bytes.truncate(cut.index(bytes.len()));
        }
        for (place, mask) in flips {
            if !bytes.is_empty() {
                let place = place.index(bytes.len());
                bytes[place] ^= mask;
            }
        }
        fs::write(&path, &bytes).unwrap();
        let _ = mirrorball_capture::recording::report_on(&path);
        if let Ok(player) = open(&path) {
            let (played, _) = play(player);
            // The check sums guard everything in a chunk: what is played is what was recorded.
            for frame in played {
                let same = frames.iter().find(|other| {
                    other.meta.camera == frame.meta.camera && other.meta.sequence == frame.meta.sequence
                });
                assert_same(&[frame], &[same.unwrap().clone()]);
            }
        }
    }

    #[test]
    fn any_bytes_after_the_magic_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let file = [b"\x89MCAP0\r\n", &bytes[..]].concat();
        prop_assert!(play_bytes(&file).is_err());
    }
}
