//! Recordings as a source: good ones, repeated ones, and every way in which one can be bad.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;
use std::time::Duration;

use mirrorball_capture::source::PictureError;
use mirrorball_capture::{
    BadFramePolicy, DEFAULT_MAX_SKEW, Frame, Grouper, HandoverError, Next, Pace, Player, Received, Repeat, Source,
    SourceError, handover, play_in_thread,
};
use support::{N_FRAMES, SIDES_PX, write_recording};
use tempfile::TempDir;

mod support;

fn recording() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_recording(folder.path());
    folder
}

/// A recording in which a text of one file was replaced.
fn with_replaced(file: &str, old: &str, new: &str) -> TempDir {
    let folder = recording();
    let path = folder.path().join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(old), "`{old}` is in {file}");
    fs::write(path, text.replacen(old, new, 1)).unwrap();
    folder
}

fn open(folder: &Path) -> Result<Player, SourceError> {
    Player::open(folder, Pace::Max, Repeat::ONCE)
}

fn open_error(folder: &TempDir) -> SourceError {
    let error = open(folder.path()).map(|_| ()).unwrap_err();
    assert!(!error.is_skippable());
    error
}

fn next(player: &mut Player) -> Result<Option<Frame>, SourceError> {
    match player.next_frame(Duration::from_secs(60))? {
        Next::Frame(frame) => Ok(Some(frame)),
        Next::TimedOut => panic!("no recording here is that long"),
        Next::End => Ok(None),
    }
}

fn all_frames(mut player: Player) -> Vec<Frame> {
    let frames = std::iter::from_fn(|| next(&mut player).unwrap()).collect();
    assert!(
        matches!(player.next_frame(Duration::ZERO), Ok(Next::End)),
        "the end stays the end"
    );
    frames
}

/// The error of the one bad frame of a recording, after checking that all others are good.
fn bad_frame(folder: &TempDir) -> SourceError {
    let mut player = open(folder.path()).unwrap();
    let (mut n_good, mut errors) = (0, Vec::new());
    loop {
        match next(&mut player) {
            Ok(Some(_)) => n_good += 1,
            Ok(None) => break,
            Err(error) => errors.push(error),
        }
    }
    assert_eq!((n_good, errors.len()), (2 * N_FRAMES - 1, 1));
    let error = errors.remove(0);
    assert!(error.is_skippable());
    assert!(error.to_string().contains("line 3"), "{error}");
    error
}

/// What is wrong with the picture of the first frame of the ball camera, once `spoil` has changed the file.
fn picture_error(spoil: impl FnOnce(&Path)) -> PictureError {
    let folder = recording();
    spoil(&folder.path().join("probe/000000.png"));
    let SourceError::BadFrame {
        camera,
        sequence: 0,
        source,
        ..
    } = bad_frame(&folder)
    else {
        panic!()
    };
    assert_eq!(camera, "probe");
    *source
}

#[test]
fn frames_come_in_order_with_all_they_carry() {
    let folder = recording();
    let player = open(folder.path()).unwrap();
    assert_eq!(player.n_frames() as u64, 2 * N_FRAMES);
    let frames = all_frames(player);
    assert_eq!(frames.len() as u64, 2 * N_FRAMES);
    let last = frames.last().unwrap();
    assert_eq!(
        (&*last.meta.camera, last.meta.sequence, last.meta.timestamp_ns),
        ("probe", 3, 1_032_000_000)
    );
    assert_eq!((last.meta.exposure.time_s, last.meta.exposure.gain), (0.004, 2.0));
    assert_eq!(last.meta.exposure.white_balance, [1.0, 1.25, 1.5]);
    assert_eq!([last.size.width, last.size.height], SIDES_PX);
    assert!(last.pixels.len() == 8 * 6 * 3 && last.pixels.iter().all(|&code| code == 103));
}

#[test]
fn the_recorded_pace_waits_and_says_so() {
    let folder = recording();
    let mut player = Player::open(folder.path(), Pace::Recorded, Repeat::ONCE).unwrap();
    let started = std::time::Instant::now();
    let (mut n_frames, mut n_timeouts) = (0, 0);
    loop {
        match player.next_frame(Duration::from_micros(100)).unwrap() {
            Next::Frame(frame) => {
                n_frames += 1;
                assert!(started.elapsed() >= Duration::from_nanos(frame.meta.timestamp_ns - 1_000_000_000));
            }
            Next::TimedOut => n_timeouts += 1,
            Next::End => break,
        }
    }
    assert_eq!(n_frames, 2 * N_FRAMES);
    assert!(n_timeouts > 0);
}

#[test]
fn a_repeated_recording_goes_on_rising() {
    let folder = recording();
    let repeat = Repeat::Times(NonZeroU32::new(3).unwrap());
    let frames = all_frames(Player::open(folder.path(), Pace::Max, repeat).unwrap());
    assert_eq!(frames.len() as u64, 3 * 2 * N_FRAMES);
    assert!(frames.is_sorted_by_key(|frame| frame.meta.timestamp_ns));
    for camera in ["scene", "probe"] {
        let of_camera: Vec<_> = frames.iter().filter(|frame| &*frame.meta.camera == camera).collect();
        let sequences: Vec<_> = of_camera.iter().map(|frame| frame.meta.sequence).collect();
        assert_eq!(sequences, (0..3 * N_FRAMES).collect::<Vec<_>>());
        assert!(
            of_camera
                .windows(2)
                .all(|pair| pair[0].meta.timestamp_ns < pair[1].meta.timestamp_ns)
        );
    }
}

#[test]
fn an_endless_recording_ends_when_its_clock_runs_out() {
    let lines = "scene,0,0,scene/000000.png,1,1,1,1,1\nscene,1,4611686018427387904,scene/000001.png,1,1,1,1,1\n";
    let folder = recording();
    let list = fs::read_to_string(folder.path().join("frames.csv")).unwrap();
    let header = list.lines().next().unwrap();
    fs::write(folder.path().join("frames.csv"), format!("{header}\n{lines}")).unwrap();
    let frames = all_frames(Player::open(folder.path(), Pace::Max, Repeat::Forever).unwrap());
    assert_eq!(frames.len(), 4);
}

#[test]
fn jpeg_is_read_too() {
    let folder = with_replaced("frames.csv", "scene/000000.png", "scene/first.jpg");
    let pixels = vec![128; 8 * 6 * 3];
    image::save_buffer(
        folder.path().join("scene/first.jpg"),
        &pixels,
        8,
        6,
        image::ColorType::Rgb8,
    )
    .unwrap();
    let frame = next(&mut open(folder.path()).unwrap()).unwrap().unwrap();
    assert!(frame.pixels.iter().all(|code| code.abs_diff(128) <= 2));
}

#[test]
fn a_camera_without_frames_is_not_announced() {
    let folder = recording();
    let list = fs::read_to_string(folder.path().join("frames.csv")).unwrap();
    let lines: Vec<_> = list.lines().filter(|line| !line.starts_with("probe")).collect();
    fs::write(folder.path().join("frames.csv"), lines.join("\n")).unwrap();
    let player = open(folder.path()).unwrap();
    assert_eq!(player.cameras().len(), 1);
    assert_eq!(all_frames(player).len() as u64, N_FRAMES);
}

#[test]
fn what_is_missing_is_named() {
    let folder = recording();
    let missing = open(&folder.path().join("nothing")).map(|_| ()).unwrap_err();
    assert!(matches!(missing, SourceError::NotAFolder { .. }));
    assert!(missing.to_string().contains("nothing"));
    let file = open(&folder.path().join("rig.toml")).map(|_| ()).unwrap_err();
    assert!(matches!(file, SourceError::NotAFolder { .. }));
    for name in ["rig.toml", "frames.csv"] {
        let folder = recording();
        fs::remove_file(folder.path().join(name)).unwrap();
        let SourceError::ReadFile { path, .. } = open_error(&folder) else {
            panic!()
        };
        assert!(path.ends_with(name));
    }
}

#[test]
fn an_empty_recording_is_refused() {
    let folder = recording();
    let path = folder.path().join("frames.csv");
    let list = fs::read_to_string(&path).unwrap();
    fs::write(&path, list.lines().next().unwrap()).unwrap();
    assert!(matches!(open_error(&folder), SourceError::NoLeaderFrame { .. }));
    fs::write(&path, "").unwrap();
    assert!(matches!(open_error(&folder), SourceError::ListHeader { .. }));
}

#[test]
fn a_bad_rig_is_refused() {
    let folder = with_replaced("rig.toml", "[[camera]]", "[[camera]");
    assert!(matches!(open_error(&folder), SourceError::RigSyntax { .. }));
    let folder = with_replaced("rig.toml", "\"ball\"", "\"scene\"");
    assert!(matches!(
        open_error(&folder),
        SourceError::RigLeader { n_leaders: 2, .. }
    ));
    let folder = with_replaced("rig.toml", "[8, 6]", "[8, 0]");
    assert!(matches!(open_error(&folder), SourceError::RigValue { .. }));
}

#[test]
fn a_bad_list_is_refused() {
    let folder = with_replaced("frames.csv", "wb_b\n", "wb_b,iso\n");
    assert!(matches!(open_error(&folder), SourceError::ListHeader { .. }));
    let folder = with_replaced("frames.csv", "scene,1,", "scene,1,7,");
    assert!(matches!(open_error(&folder), SourceError::ListSyntax { line: 4, .. }));
    let folder = with_replaced("frames.csv", "probe,2,", "moon,2,");
    assert!(matches!(
        open_error(&folder),
        SourceError::ListValue {
            line: 7,
            field: "camera",
            ..
        }
    ));
    let folder = with_replaced("frames.csv", "scene/000001.png", "../000001.png");
    assert!(matches!(
        open_error(&folder),
        SourceError::ListValue {
            line: 4,
            field: "file",
            ..
        }
    ));
}

#[test]
fn a_list_that_is_no_text_is_refused() {
    let folder = recording();
    fs::write(folder.path().join("frames.csv"), [0xFF, 0xFE, 0x00, b'\n', 0x80]).unwrap();
    assert!(matches!(
        open_error(&folder),
        SourceError::ListSyntax { .. } | SourceError::ListHeader { .. }
    ));
    fs::write(folder.path().join("rig.toml"), [0xFF, 0xFE, 0x00]).unwrap();
    assert!(matches!(open_error(&folder), SourceError::ReadFile { .. }));
}

#[test]
fn a_bad_picture_costs_only_its_frame() {
    let missing = picture_error(|path| fs::remove_file(path).unwrap());
    assert!(matches!(missing, PictureError::Read(_)), "{missing:?}");
    let garbage = picture_error(|path| fs::write(path, b"no picture").unwrap());
    assert!(matches!(garbage, PictureError::Decode(_)), "{garbage:?}");
    let empty = picture_error(|path| fs::write(path, b"").unwrap());
    assert!(matches!(empty, PictureError::Decode(_)), "{empty:?}");
    let cut = picture_error(|path| {
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..bytes.len() - 20]).unwrap();
    });
    assert!(
        matches!(cut, PictureError::Decode(_) | PictureError::Read(_)),
        "{cut:?}"
    );
    let folder = picture_error(|path| {
        fs::remove_file(path).unwrap();
        fs::create_dir(path).unwrap();
    });
    assert!(matches!(folder, PictureError::Read(_)), "{folder:?}");
}

#[test]
fn a_picture_of_the_wrong_kind_costs_only_its_frame() {
    let grey = picture_error(|path| image::save_buffer(path, &[0; 48], 8, 6, image::ColorType::L8).unwrap());
    assert!(
        matches!(&grey, PictureError::PixelKind { found } if found == "L8"),
        "{grey:?}"
    );
    let large = picture_error(|path| image::save_buffer(path, &[0; 144], 6, 8, image::ColorType::Rgb8).unwrap());
    assert!(matches!(large, PictureError::WrongSize { .. }), "{large:?}");
    assert_eq!(large.to_string(), "the picture is 6×8 px, the rig file says 8×6 px");
    let gif = picture_error(|path| fs::write(path, b"GIF89a\x01\x00\x01\x00\x00\x00\x00;").unwrap());
    assert!(matches!(gif, PictureError::Decode(_)), "{gif:?}");
}

/// Plays a recording on a thread and returns the sequence numbers of the sets, the error and the skipped frames.
fn play(folder: &Path, policy: BadFramePolicy) -> (Vec<u64>, Option<HandoverError>, u64) {
    let player = open(folder).unwrap();
    let grouper = Grouper::for_cameras(player.cameras(), DEFAULT_MAX_SKEW);
    let (publisher, mut subscriber) = handover::lossless(1);
    let thread = play_in_thread(Box::new(player), grouper, publisher, policy).unwrap();
    let mut sequences = Vec::new();
    let error = loop {
        match subscriber.receive(Duration::MAX) {
            Ok(Received::Set(set)) => sequences.push(set.frames[0].meta.sequence),
            Ok(Received::TimedOut) => panic!("a year has passed"),
            Ok(Received::Ended) => break None,
            Err(error) => break Some(error),
        }
    };
    (sequences, error, thread.join().unwrap().skipped_frames)
}

#[test]
fn the_embedded_mode_takes_every_frame() {
    let folder = recording();
    let (sequences, error, skipped) = play(folder.path(), BadFramePolicy::Fail);
    assert_eq!(sequences, (0..N_FRAMES).collect::<Vec<_>>());
    assert!(error.is_none() && skipped == 0);
}

#[test]
fn the_embedded_mode_fails_at_a_bad_frame_or_skips_it() {
    let folder = recording();
    fs::remove_file(folder.path().join("scene/000002.png")).unwrap();
    let (sequences, error, _) = play(folder.path(), BadFramePolicy::Fail);
    assert_eq!(sequences, [0, 1]);
    let error = error.unwrap();
    assert!(
        error.is_bad_input() && matches!(error, HandoverError::Source(SourceError::BadFrame { .. })),
        "{error}"
    );
    let (sequences, error, skipped) = play(folder.path(), BadFramePolicy::Skip);
    assert_eq!(sequences, [0, 1, 3]);
    assert!(error.is_none() && skipped == 1);
}
