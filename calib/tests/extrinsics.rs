//! `markers`, `extrinsics`, `hand-eye` and `display`, as programs, on pictures of known truth.

mod support;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
    sync::OnceLock,
};

use glam::{DQuat, DVec3};
use mirrorball_calib::{
    pose::{Pose, Twist},
    rig::{RigDraft, RigParts, Role},
};
use serde_json::Value;
use support::{RIG, looking_at, picture, rig};

const N: usize = 10;

/// Time between pictures.
const STEP_NS: u64 = 100_000_000;

fn twist(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::exp(Twist {
        rotation: DVec3::from_array(rotation),
        translation: DVec3::from_array(translation),
    })
}

/// Where the scene camera is at a time in units of [`STEP_NS`].
fn scene(t: f64) -> Pose {
    let from = DVec3::new(
        0.25 * (0.5 * t).sin(),
        -0.33 + 0.08 * (0.6 * t).sin(),
        0.45 + 0.06 * (0.4 * t).cos(),
    );
    looking_at(DVec3::new(0.01 * t.sin(), 0.05, 0.0), from, 0.4 * (0.45 * t).sin())
}

fn right_from_scene() -> Pose {
    twist([0.02, 0.06, 0.0], [-0.06, 0.0, 0.01])
}

fn left_from_world() -> Pose {
    looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(-0.2, -0.3, 0.4), 0.1)
}

fn headset_from_camera() -> Pose {
    twist([0.2, -0.4, 1.0], [0.02, 0.05, -0.03])
}

fn world_from_tracker() -> Pose {
    twist([1.0, 0.2, -0.5], [1.0, 2.0, 0.5])
}

/// A recording: `scene` moves, `right` beside it in the first three pictures, `left` stands still; all have one lens. Written once.
fn recording() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER.get_or_init(write_recording).path()
}

fn write_recording() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be written");
    let rig = rig();
    let mut draft = RigDraft::from_toml(RIG, Path::new("rig.toml")).expect("what the program writes can be read");
    for name in ["left", "right"] {
        draft.set_camera(name, Role::Ball, rig.scene_camera().intrinsics.size_px);
        draft.set_lens(name, &rig.scene_camera().intrinsics);
        draft.set_photometry(name, &rig.scene_camera().photometry);
    }
    draft.set_camera_from_world("left", &Pose::identity());
    draft.set_camera_from_world("right", &Pose::identity());
    fs::write(folder.path().join("rig.toml"), draft.to_toml()).expect("a temporary folder can be written");
    let mut list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n".to_owned();
    let mut add = |camera: &str, index: usize, pose: &Pose| {
        fs::create_dir_all(folder.path().join(camera)).expect("a temporary folder can be written");
        let file = format!("{camera}/{index:06}.png");
        let pixels = picture(&rig, pose, 2);
        image::save_buffer(folder.path().join(&file), &pixels, 640, 480, image::ColorType::Rgb8)
            .expect("a temporary folder can be written");
        let ns = 1_000_000_000 + STEP_NS * index as u64;
        list += &format!("{camera},{index},{ns},{file},0.01,1.0,1.0,1.0,1.0\n");
    };
    for index in 0..N {
        let scene_from_world = scene(index as f64);
        add("scene", index, &scene_from_world);
        if index < 3 {
            add("right", index, &(right_from_scene() * scene_from_world));
        }
        if index < 1 {
            add("left", index, &left_from_world());
        }
    }
    fs::write(folder.path().join("frames.csv"), list).expect("a temporary folder can be written");
    folder
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// Runs a command that must succeed, and reads the numbers it writes.
fn numbers(arguments: &[&str]) -> Value {
    let folder = tempfile::tempdir().expect("a temporary folder can be written");
    let (json, page) = (folder.path().join("n.json"), folder.path().join("page.html"));
    let more = [
        "--json",
        json.to_str().expect("a temporary folder has a plain name"),
        "--report",
        page.to_str().expect("a temporary folder has a plain name"),
    ];
    let output = run(&[arguments, &more].concat());
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        fs::read_to_string(page)
            .expect("what the program writes can be read")
            .contains("<h1>")
    );
    let text = fs::read_to_string(json).expect("what the program writes can be read");
    let first = format!("{{\n  \"routine\": \"{}\",", arguments[0]);
    assert!(text.starts_with(&first), "{text}");
    serde_json::from_str(&text).expect("what the program writes can be read")
}

/// Runs a command that must blame its input, and gives what it says.
fn refused(arguments: &[&str]) -> String {
    let output = run(arguments);
    let said = String::from_utf8(output.stderr).expect("what the program writes can be read");
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("\n  hint: "), "{said}");
    said
}

fn pose(rows: &Value) -> Pose {
    Pose::from_rows(&serde_json::from_value(rows.clone()).expect("what the program writes can be read"))
        .expect("what the program writes can be read")
}

/// How far two poses are from each other: degrees and millimetres.
fn off(a: &Pose, b: &Pose) -> (f64, f64) {
    let off = *a * b.inverse();
    (
        off.angle_to(&Pose::identity()).to_degrees(),
        1e3 * off.translation.length(),
    )
}

fn path(name: &str) -> String {
    recording().join(name).display().to_string()
}

#[test]
fn markers_are_found_anew() {
    let (rig_file, folder) = (path("rig.toml"), path(""));
    let out = tempfile::tempdir().unwrap();
    let out = out.path().join("found.toml");
    // The rig without its markers.
    let text = fs::read_to_string(&rig_file).unwrap();
    let bare = out.with_file_name("bare.toml");
    let (head, rest) = text.split_at(text.find("[[marker]]").unwrap());
    let cameras = rest.find("[[camera]]").map_or("", |start| &rest[start..]);
    fs::write(
        &bare,
        format!("{head}{cameras}").replace("main_marker", "# main_marker"),
    )
    .unwrap();
    let from = |rig: &str| ["--rig", rig, "--recording", &folder, "--camera", "scene"].map(str::to_owned);
    let truth = rig();
    let mut arguments = vec!["markers".to_owned()];
    arguments.extend(from(bare.to_str().unwrap()));
    arguments.extend(["--main", "0", "--out", out.to_str().unwrap()].map(str::to_owned));
    for marker in &truth.markers {
        arguments.extend(["--side".to_owned(), format!("{}={}", marker.id, marker.side_m)]);
    }
    let found = numbers(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(found["markers"].as_array().unwrap().len(), truth.markers.len());
    let parts = RigParts::from_toml(&fs::read_to_string(&out).unwrap(), &out).unwrap();
    assert_eq!(parts.main_marker, Some(0));
    for (marker, truth) in parts.markers.iter().zip(&truth.markers) {
        assert_eq!(marker.id, truth.id);
        let place_mm = 1e3
            * marker
                .world_from_marker
                .translation
                .distance(truth.world_from_marker.translation);
        let angle_deg = marker.world_from_marker.angle_to(&truth.world_from_marker).to_degrees();
        assert!(
            place_mm < 0.5 && angle_deg < 0.3,
            "{}: {place_mm} mm, {angle_deg}°",
            marker.id
        );
    }
    let mut arguments = vec!["markers".to_owned()];
    arguments.extend(from(&rig_file));
    arguments.extend(["--main", "77", "--side-m", "0.1"].map(str::to_owned));
    let said = refused(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(said.contains("the side of main marker `77` is not known"), "{said}");
    // A side that the pictures contradict is bad input.
    let mut arguments = vec!["markers".to_owned()];
    arguments.extend(from(&rig_file));
    arguments.extend(["--side", "1=0.09"].map(str::to_owned));
    let said = refused(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(
        said.contains("the pictures of marker `1` agree on no place for it"),
        "{said}"
    );
    // Numbers that cannot be written leave the rig as it was.
    let before = fs::read_to_string(&out).unwrap();
    let mut arguments = vec!["markers".to_owned()];
    arguments.extend(from(&rig_file));
    arguments.extend(["--out", out.to_str().unwrap(), "--json", "/dev/full"].map(str::to_owned));
    let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(fs::read_to_string(&out).unwrap(), before);
}

#[test]
fn cameras_are_located() {
    let (rig_file, folder) = (path("rig.toml"), path(""));
    let from = ["--rig", &rig_file, "--recording", &folder];
    let out = tempfile::tempdir().unwrap();
    let out = out.path().join("found.toml");
    let to = ["--out", out.to_str().unwrap()];
    let found = numbers(&[&["extrinsics", "--camera", "left"][..], &from, &to].concat());
    let (angle_deg, place_mm) = off(&pose(&found["cameras"][0]["camera_from_world"]), &left_from_world());
    assert!(angle_deg < 0.05 && place_mm < 0.3, "{angle_deg}° {place_mm} mm");
    let parts = RigParts::from_toml(&fs::read_to_string(&out).unwrap(), &out).unwrap();
    assert!(
        off(
            &parts.camera("left").unwrap().camera_from_world.unwrap(),
            &left_from_world()
        )
        .1 < 0.3
    );
    let found = numbers(&[&["extrinsics", "--pair", "scene,right"][..], &from].concat());
    let camera = &found["cameras"][0];
    assert_eq!(
        (&camera["first_camera"], &camera["camera"]),
        (&"scene".into(), &"right".into())
    );
    assert_eq!(camera["views"].as_array().unwrap().len(), 6);
    let (angle_deg, place_mm) = off(&pose(&camera["camera_from_first_camera"]), &right_from_scene());
    assert!(angle_deg < 0.05 && place_mm < 0.3, "{angle_deg}° {place_mm} mm");
    let said = refused(&[&["extrinsics", "--pair", "left,right"][..], &from].concat());
    assert!(
        said.contains("both cameras see markers of the rig at `1` moments"),
        "{said}"
    );
    let said = refused(&[&["extrinsics", "--camera", "scene"][..], &from].concat());
    assert!(said.contains("camera `scene` moves"), "{said}");
}

/// What the tracker gave, from 0.3 s before the first picture to 0.3 s after the last.
fn track(offset_ns: u64) -> String {
    let mut list = "timestamp_ns,qw,qx,qy,qz,x,y,z\n".to_owned();
    for i in 0..=(N + 5) * 10 {
        let t = 0.1 * i as f64 - 3.0;
        let world_from_camera = scene(t).inverse();
        let tracked = world_from_tracker().inverse() * world_from_camera * headset_from_camera().inverse();
        let (q, p) = (DQuat::from_mat3(&tracked.rotation), tracked.translation);
        let ns = 1_000_000_000 - 3 * STEP_NS + STEP_NS / 10 * i as u64 + offset_ns;
        list += &format!("{ns},{},{},{},{},{},{},{}\n", q.w, q.x, q.y, q.z, p.x, p.y, p.z);
    }
    list
}

#[test]
fn a_camera_is_found_on_a_tracked_headset() {
    let (rig_file, folder) = (path("rig.toml"), path(""));
    let temporary = tempfile::tempdir().unwrap();
    let poses = temporary.path().join("poses.csv");
    fs::write(&poses, track(40_000_000)).unwrap();
    let from = [
        "--rig",
        &rig_file,
        "--recording",
        &folder,
        "--camera",
        "scene",
        "--poses",
        poses.to_str().unwrap(),
    ];
    let found = numbers(&[&["hand-eye", "--time-offset"][..], &from].concat());
    let (angle_deg, place_mm) = off(&pose(&found["headset_from_camera"]), &headset_from_camera());
    assert!(angle_deg < 0.1 && place_mm < 1.0, "{angle_deg}° {place_mm} mm");
    let offset_s = found["tracker_minus_camera_s"].as_f64().unwrap();
    assert!((offset_s - 0.04).abs() < 1e-3, "{offset_s}");
    fs::write(&poses, "timestamp_ns,qw,qx,qy,qz,x,y,z\n1,2,0,0,0,0,0,0\n").unwrap();
    let said = refused(&[&["hand-eye"][..], &from].concat());
    assert!(said.contains("poses.csv`, line 2: `qw` is `2`"), "{said}");
    fs::write(&poses, "timestamp_ns,qw,qx,qy,qz,x,y,z\n1,1,0,0,0,0,0,0\n").unwrap();
    let said = refused(&[&["hand-eye"][..], &from].concat());
    assert!(
        said.contains("`0` pictures are located while the tracker gave poses"),
        "{said}"
    );
}

#[test]
fn prompts_are_written_and_an_eye_is_found() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("prompts");
    let output = run(&[
        "display",
        "--prompts",
        folder.to_str().unwrap(),
        "--size-px",
        "640,360",
        "--points",
        "15",
    ]);
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let prompts = fs::read_to_string(folder.join("prompts.csv")).unwrap();
    let lines: Vec<&str> = prompts.lines().collect();
    assert_eq!((lines[0], lines.len()), ("number,u,v,distance_m", 16));
    assert_eq!(image::open(folder.join("015.png")).unwrap().width(), 640);
    // A person who aligns exactly.
    let eye_from_headset = twist([0.05, 0.02, 0.0], [0.03, 0.04, 0.02]);
    let mut list = "number,u,v,x,y,z\n".to_owned();
    for line in &lines[1..] {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let in_eye = DVec3::new((cells[1] - 320.0) / 900.0, (cells[2] - 180.0) / 900.0, 1.0) * cells[3];
        let p = eye_from_headset.inverse().transform_point(in_eye);
        list += &format!("{},{},{},{},{},{}\n", cells[0], cells[1], cells[2], p.x, p.y, p.z);
    }
    let alignments = temporary.path().join("alignments.csv");
    fs::write(&alignments, &list).unwrap();
    let file = alignments.to_str().unwrap();
    let found = numbers(&["display", "--alignments", file]);
    let (angle_deg, place_mm) = off(&pose(&found["eye_from_headset"]), &eye_from_headset);
    assert!(angle_deg < 1e-3 && place_mm < 1e-3, "{angle_deg}° {place_mm} mm");
    assert!((found["focal_px"][0].as_f64().unwrap() - 900.0).abs() < 1e-2);
    let few: Vec<&str> = list.lines().take(6).collect();
    fs::write(&alignments, few.join("\n")).unwrap();
    let said = refused(&["display", "--alignments", file]);
    assert!(said.contains("there are `5` alignments (needed: `8`)"), "{said}");
}

#[test]
fn points_to_align_may_come_from_a_recording() {
    let temporary = tempfile::tempdir().unwrap();
    let eye_from_headset = twist([0.05, 0.02, 0.0], [0.03, 0.04, 0.02]);
    let mut list = "number,u,v,sequence\n".to_owned();
    for index in 0..N {
        let p = eye_from_headset.transform_point(scene(index as f64).translation);
        list += &format!(
            "{index},{},{},{index}\n",
            900.0 * p.x / p.z + 320.0,
            900.0 * p.y / p.z + 180.0
        );
    }
    let alignments = temporary.path().join("alignments.csv");
    fs::write(&alignments, &list).unwrap();
    let file = alignments.to_str().unwrap();
    let said = refused(&["display", "--alignments", file]);
    assert!(said.contains("names frames, but there is no `--recording`"), "{said}");
    let (rig_file, folder) = (path("rig.toml"), path(""));
    let from = [
        "--rig",
        &rig_file,
        "--recording",
        &folder,
        "--camera",
        "scene",
        "--marker",
        "0",
    ];
    // The marker stays at one distance here: that is told, from points that are right.
    let said = refused(&[&["display", "--alignments", file][..], &from].concat());
    assert!(said.contains("all points"), "{said}");
}
