use proptest::prelude::*;

use super::*;
use crate::lockstep::{Mains, ManualWhiteBalance, Mode};

/// The least that a configuration needs.
const LEAST: &str = r#"
version = 1
[[camera]]
name = "scene"
role = "scene"
device = "/dev/video0"
size_px = [1280, 720]
"#;

/// Every key, with values other than the defaults.
const ALL: &str = r#"
version = 1
rig = "rig.toml"

[service]
name = "lab/frames"
max_skew_ms = 20
status_socket = "/run/lab/status.sock"

[[camera]]
name = "scene"
role = "scene"
card = "HD Webcam"
usb_path = "usb-0000:00:14.0-1"
size_px = [1280, 720]
rate_hz = 60
formats = ["mjpeg", "yuyv"]
method = "mmap"
buffers = 8
stamps = "mapped"
stamp_offset_s = -0.0125
response = "srgb"
sensitivity = [1.1, 1.0, 0.9]
latency_frames = 2
[camera.exposure_table]
points = [[1, 0.00011], [5000, 0.5]]
[camera.gain_table]
points = [[0, 1.0], [100, 8.0]]
[camera.white_balance_table]
temperatures = [[2800, [1.2, 1.0, 2.4]], [6500, [1.9, 1.0, 1.3]]]

[[camera]]
name = "ball"
role = "ball"
device = "/dev/video2"
size_px = [640, 480]

[lockstep]
mode = "bracket"
anti_flicker_hz = 50
max_exposure_s = 0.03
measure_latency = false
[lockstep.auto_exposure]
key = 0.2
highlight_drop_max_ev = 0.5
dead_band_ev = 0.1
settle_s = 0.2
[lockstep.fixed_ratio]
offsets_ev = { ball = -2.0 }
[lockstep.bracket]
camera = "ball"
steps = 5
step_ev = 1.5
[lockstep.manual]
exposure_s = 0.005
gain = 2.0
white_balance_gains = [2.0, 1.0, 1.5]

[record]
directory = "recordings"
max_queue_mb = 1024

[log]
format = "json"
"#;

fn parse(text: &str) -> Result<CaptureConfig, ConfigError> {
    CaptureConfig::parse(text, Path::new("/etc/mirrorball/capture.toml"))
}

/// `ALL` with one line replaced.
fn with(line: &str, replacement: &str) -> String {
    assert_eq!(ALL.matches(line).count(), 1, "{line}");
    ALL.replace(line, replacement)
}

/// Number of the last line with this text, from 1.
fn line_of(text: &str, part: &str) -> usize {
    let lines: Vec<&str> = text.lines().collect();
    1 + lines.iter().rposition(|line| line.contains(part)).unwrap()
}

#[test]
fn the_least_configuration_has_all_defaults() {
    let config = parse(LEAST).unwrap();
    let camera = &config.cameras[0];
    assert_eq!(config.service.name, crate::handover::DEFAULT_SERVICE);
    assert_eq!(config.service.max_skew, crate::DEFAULT_MAX_SKEW);
    assert_eq!((camera.rate_hz, camera.n_buffers, camera.stamp_offset_ns), (30.0, 6, 0));
    assert_eq!(
        (camera.response.clone(), camera.tables.clone()),
        (Response::srgb(), Tables::default())
    );
    assert_eq!(config.lockstep, LockstepSettings::default());
    assert_eq!((config.record, config.log), (None, LogFormat::Text));
}

#[test]
fn every_key_is_read() {
    let config = parse(ALL).unwrap();
    let [scene, ball] = &config.cameras[..] else { panic!() };
    assert_eq!(config.leader(), scene);
    assert_eq!(config.rig.as_deref(), Some(Path::new("/etc/mirrorball/rig.toml")));
    assert_eq!(config.service.max_skew, Duration::from_millis(20));
    assert_eq!(
        config.service.status_socket.as_deref(),
        Some(Path::new("/run/lab/status.sock"))
    );
    assert_eq!(scene.formats, [FormatKind::Mjpeg, FormatKind::Yuyv]);
    assert_eq!((scene.method, scene.n_buffers, scene.rate_hz), (Method::Mmap, 8, 60.0));
    assert_eq!(
        (scene.stamps, scene.stamp_offset_ns),
        (StampPolicy::Mapped, -12_500_000)
    );
    assert_eq!(scene.latency_frames, Some(2));
    assert_ne!(scene.tables.sensitivity, ball.tables.sensitivity);
    assert!((scene.tables.exposure.time_s(1) - 0.00011).abs() < 1e-12);
    assert!(scene.tables.gain.is_some());
    assert_eq!(ball.address, CameraAddress::Path("/dev/video2".into()));
    let expected = Mode::Bracket {
        camera: 1,
        n_steps: 5,
        step_ev: 1.5,
    };
    assert_eq!((&config.lockstep.mode, config.lockstep.mains), (&expected, Mains::Hz50));
    assert_eq!(
        (config.lockstep.auto_exposure.key, config.lockstep.measure_latency),
        (0.2, false)
    );
    let record = config.record.unwrap();
    assert_eq!(record.directory, Path::new("/etc/mirrorball/recordings"));
    assert_eq!((record.max_queue_mb, config.log), (1024, LogFormat::Json));
}

#[test]
fn every_mode_is_read() {
    let mode = |name: &str| {
        parse(&with("mode = \"bracket\"", &format!("mode = \"{name}\"")))
            .unwrap()
            .lockstep
            .mode
    };
    assert_eq!(mode("locked"), Mode::Locked);
    assert_eq!(mode("follow_leader"), Mode::FollowLeader);
    let fixed_ratio = Mode::FixedRatio {
        offsets_ev: vec![0.0, -2.0],
    };
    assert_eq!(mode("fixed_ratio"), fixed_ratio);
    let manual = Mode::Manual {
        exposure_s: 0.005,
        gain: 2.0,
        white_balance: ManualWhiteBalance::Gains([2.0, 1.0, 1.5]),
    };
    assert_eq!(mode("manual"), manual);
}

#[test]
fn an_unknown_key_is_named_with_its_line_and_the_nearest_known_one() {
    let cases = [
        ("rate_hz = 60", "rate_fps = 60", "rate_hz"),
        ("rate_hz = 60", "rate_khz = 60", "rate_hz"),
        ("size_px = [640, 480]", "size = [640, 480]", "size_px"),
        ("stamp_offset_s = -0.0125", "stamp_offset_ms = 3", "stamp_offset_s"),
        ("max_exposure_s = 0.03", "max_exposure_us = 3", "max_exposure_s"),
        ("steps = 5", "step = 5", "steps"),
        ("[camera.gain_table]", "[camera.gain_tables]", "gain_table"),
        ("[log]", "[logs]", "log"),
        ("max_queue_mb = 1024", "max_queue = 1024", "max_queue_mb"),
    ];
    for (line, replacement, expected) in cases {
        let text = with(line, replacement);
        let error = parse(&text).unwrap_err();
        let ConfigError::UnknownKey { line, nearest, .. } = &error else {
            panic!("{error}")
        };
        assert_eq!(nearest.as_deref(), Some(expected), "{error}");
        assert_eq!(*line, line_of(&text, replacement), "{error}");
        assert!(error.hint().contains(expected), "{}", error.hint());
    }
    let error = parse(&with("gain = 2.0", "zzz = 2.0")).unwrap_err();
    assert!(
        matches!(error, ConfigError::UnknownKey { nearest: None, .. }),
        "{error}"
    );
}

/// A line of `ALL`, what it is replaced by, and part of the error that this makes.
const REFUSED: [(&str, &str, &str); 25] = [
    ("version = 1", "version = 2", "`version` = `2` (allowed: 1)"),
    (
        "rate_hz = 60",
        "rate_hz = 0",
        "`camera[0].rate_hz` = `0` (allowed: 1 to 1000)",
    ),
    ("rate_hz = 60", "rate_hz = nan", "`camera[0].rate_hz` = `NaN`"),
    (
        "buffers = 8",
        "buffers = 2",
        "`camera[0].buffers` = `2` (allowed: 3 to 32)",
    ),
    (
        "size_px = [640, 480]",
        "size_px = [640, -480]",
        "`camera[1].size_px` = `-480` (allowed: 1 to 16384)",
    ),
    (
        "stamp_offset_s = -0.0125",
        "stamp_offset_s = -12.5",
        "(allowed: -1 to 1)",
    ),
    ("latency_frames = 2", "latency_frames = 9", "(allowed: 0 to 8)"),
    ("max_skew_ms = 20", "max_skew_ms = 0.05", "(allowed: 1 to 1000)"),
    (
        "anti_flicker_hz = 50",
        "anti_flicker_hz = 100",
        "(allowed: 0, 50 or 60)",
    ),
    (
        "max_exposure_s = 0.03",
        "max_exposure_s = 30",
        "`lockstep.max_exposure_s` = `30`",
    ),
    ("step_ev = 1.5", "step_ev = 0", "`lockstep.bracket.step_ev` = `0`"),
    (
        "camera = \"ball\"",
        "camera = \"scene\"",
        "`lockstep.bracket.camera` = `scene`",
    ),
    (
        "offsets_ev = { ball = -2.0 }",
        "offsets_ev = { bell = 1 }",
        "names of cameras: `scene`, `ball`",
    ),
    ("gain = 2.0", "gain = 0", "`lockstep.manual.gain`"),
    ("max_queue_mb = 1024", "max_queue_mb = 1", "(allowed: 16 to 65536)"),
    (
        "method = \"mmap\"",
        "method = \"map\"",
        "`camera[0].method` = `map` (allowed: `auto`, `mmap`, `userptr`; did you mean `mmap`?)",
    ),
    (
        "formats = [\"mjpeg\", \"yuyv\"]",
        "formats = [\"yuyv\", \"yuyv\"]",
        "none twice",
    ),
    ("formats = [\"mjpeg\", \"yuyv\"]", "formats = []", "at least one"),
    ("role = \"ball\"", "role = \"scene\"", "2 cameras with the role scene"),
    ("name = \"ball\"", "name = \"scene\"", "a name used only once"),
    ("name = \"ball\"", "name = \"a ball\"", "letters, digits"),
    ("device = \"/dev/video2\"", "device = \"video2\"", "a path such as"),
    (
        "device = \"/dev/video2\"",
        "device = \"/dev/video2\"\ncard = \"x\"",
        "either `device`, or `card`",
    ),
    (
        "device = \"/dev/video2\"",
        "card = \"HD Webcam\"",
        "each need a `usb_path`",
    ),
    ("response = \"srgb\"", "response = \"rec709\"", "`srgb` or 256 numbers"),
];

#[test]
fn a_value_that_is_not_allowed_is_named_with_its_line_and_what_is() {
    for (line, replacement, expected) in REFUSED {
        let text = with(line, replacement);
        let error = parse(&text).unwrap_err();
        assert!(matches!(error, ConfigError::Value { .. }), "{error}");
        let expected_line = format!(" line {} ", line_of(&text, replacement.lines().next().unwrap()));
        assert!(
            error.to_string().contains(&expected_line),
            "{error}, expected{expected_line}"
        );
        assert!(error.to_string().contains(expected), "{error}, expected {expected}");
    }
}

#[test]
fn values_of_the_wrong_kind_and_missing_keys_are_named() {
    let cases = [
        (
            "rate_hz = 60",
            "rate_hz = \"60\"",
            "line 16 has the wrong kind of value for `camera[0].rate_hz`",
        ),
        (
            "response = \"srgb\"",
            "response = 3",
            "expected \"srgb\" or 256 numbers",
        ),
        ("name = \"ball\"", "", "line 32 lacks the key `camera[1].name`"),
        ("directory = \"recordings\"", "", "lacks the key `record.directory`"),
        ("device = \"/dev/video2\"", "", "a camera without address"),
        ("version = 1", "", "lacks the key `version`"),
        ("rate_hz = 60", "rate_hz 60", "line 16 is no TOML"),
    ];
    for (line, replacement, expected) in cases {
        let error = parse(&with(line, replacement)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}, expected {expected}");
    }
}

#[test]
fn tables_and_responses_that_cannot_be_used_are_named() {
    let text = with("points = [[0, 1.0], [100, 8.0]]", "points = [[0, 1.0], [0, 8.0]]");
    let error = parse(&text).unwrap_err();
    let ConfigError::Table { line, camera, .. } = &error else {
        panic!("{error}")
    };
    let is_there = [line_of(&text, "[camera.gain_table]"), line_of(&text, "[0, 8.0]")].contains(line);
    assert!(is_there && camera == "scene", "{error}");
    let error = parse(&with("response = \"srgb\"", "response = [0.0, 1.0]")).unwrap_err();
    assert!(matches!(error, ConfigError::Response { line: 22, .. }), "{error}");
}

#[test]
fn a_bracket_needs_a_camera() {
    let error = parse(&format!("{LEAST}\n[lockstep]\nmode = \"bracket\"\n")).unwrap_err();
    assert!(
        error.to_string().contains("no camera besides the scene camera"),
        "{error}"
    );
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture.toml");
    assert!(matches!(
        CaptureConfig::load(&path).unwrap_err(),
        ConfigError::Read { .. }
    ));
    std::fs::write(&path, "#".repeat(2 << 20)).unwrap();
    assert!(matches!(
        CaptureConfig::load(&path).unwrap_err(),
        ConfigError::TooLong { .. }
    ));
    std::fs::write(&path, [0xff, 0xfe]).unwrap();
    assert!(matches!(
        CaptureConfig::load(&path).unwrap_err(),
        ConfigError::Read { .. }
    ));
    std::fs::write(&path, ALL).unwrap();
    assert_eq!(
        CaptureConfig::load(&path).unwrap().rig,
        Some(folder.path().join("rig.toml"))
    );
}

#[test]
fn the_description_names_what_matters() {
    let text = parse(ALL).unwrap().describe();
    for expected in [
        "`lab/frames`",
        "`scene` (scene)",
        "HD Webcam@usb-0000:00:14.0-1",
        "MJPEG or YUYV",
        "brackets 5",
    ] {
        assert!(text.contains(expected), "{text}");
    }
}

/// Pieces that a mutated file is made of: of the file itself, and what may be typed by mistake.
const PIECES: [&str; 16] = [
    "[[camera]]\n",
    "[camera]\n",
    "[lockstep]\n",
    "= ",
    "\"",
    "[",
    "]",
    "{",
    "-1",
    "1e999",
    "nan",
    "99999999999999999999",
    "\n",
    "é",
    "\0",
    "'''",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn mutated_files_never_panic(
        edits in proptest::collection::vec((any::<prop::sample::Index>(), 0usize..40, 0..PIECES.len() + 1), 1..6),
    ) {
        let mut text = ALL.to_owned();
        for (place, n_removed, piece) in edits {
            let boundaries: Vec<usize> = text.char_indices().map(|(offset, _)| offset).chain([text.len()]).collect();
            let start = place.index(boundaries.len());
            let end = (start + n_removed).min(boundaries.len() - 1);
            text.replace_range(boundaries[start]..boundaries[end], PIECES.get(piece).unwrap_or(&""));
        }
        match parse(&text) {
            Ok(config) => prop_assert!(!config.describe().is_empty()),
            Err(error) => {
                prop_assert!(error.to_string().contains("capture.toml") && !error.hint().is_empty());
                prop_assert!(!error.to_string().contains('\n'), "{error}");
            }
        }
    }

    #[test]
    fn any_text_never_panics(text in "\\PC{0,200}") {
        let _ = parse(&text);
    }

    /// One value replaced by any other: an error names the key's line.
    #[test]
    fn any_value_is_taken_or_refused_with_its_line(
        place in any::<prop::sample::Index>(),
        value in prop_oneof![
            any::<i64>().prop_map(|n| n.to_string()),
            any::<f64>().prop_map(|x| format!("{x:?}").replace("NaN", "nan")),
            "[a-z_]{0,8}".prop_map(|s| format!("\"{s}\"")),
            Just("[]".to_owned()), Just("{}".to_owned()), Just("true".to_owned()), Just("[1, 2, 3]".to_owned()),
        ],
    ) {
        let lines: Vec<&str> = ALL.lines().collect();
        let assignments: Vec<usize> = (0..lines.len()).filter(|&i| lines[i].contains(" = ")).collect();
        let changed = assignments[place.index(assignments.len())];
        let replaced = format!("{} = {value}", lines[changed].split(" = ").next().unwrap());
        let text: Vec<&str> = (0..lines.len()).map(|i| if i == changed { &replaced } else { lines[i] }).collect();
        if let Err(error) = parse(&text.join("\n")) {
            let has_line = error.to_string().contains(&format!(" line {}", changed + 1));
            // What another line says may be what is wrong now: the second of two names, a table, roles.
            let is_elsewhere = error.to_string().contains("camera") || error.to_string().contains("offsets_ev");
            prop_assert!(has_line || is_elsewhere, "{error}");
        }
    }
}
