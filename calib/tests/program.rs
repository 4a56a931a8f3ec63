//! The program: what it prints and how it ends.

mod support;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use glam::DVec3;
use support::{RIG, looking_at, picture, rig};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("text")
}

/// A recording of two frames: the markers, and nothing at all when `second_is_empty`.
fn record(folder: &Path, second_is_empty: bool) {
    let rig = rig();
    let pose = looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(0.05, -0.35, 0.45), 0.0);
    let seen = picture(&rig, &pose, 2);
    let empty = vec![90; seen.len()];
    fs::create_dir(folder.join("scene")).expect("a temporary folder can be written");
    for (index, pixels) in [&seen, if second_is_empty { &empty } else { &seen }]
        .into_iter()
        .enumerate()
    {
        let file = folder.join(format!("scene/{index:06}.png"));
        image::save_buffer(file, pixels, 640, 480, image::ColorType::Rgb8).expect("a temporary folder can be written");
    }
    fs::write(folder.join("rig.toml"), RIG).expect("a temporary folder can be written");
    let list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n\
                scene,0,1000000000,scene/000000.png,0.01,1.0,1.0,1.0,1.0\n\
                scene,1,1033000000,scene/000001.png,0.01,1.0,1.0,1.0,1.0\n";
    fs::write(folder.join("frames.csv"), list).expect("a temporary folder can be written");
}

#[test]
fn detect_prints_one_object_per_picture() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), true);
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (first, second, rig) = (file("scene/000000.png"), file("scene/000001.png"), file("rig.toml"));
    // A rig whose cameras have a lens but no photometry yet.
    let text = fs::read_to_string(&rig).unwrap();
    let mut is_kept = true;
    let lens_only: String = text
        .lines()
        .filter(|line| {
            if line.starts_with('[') {
                is_kept = *line != "[camera.photometry]";
            }
            is_kept
        })
        .map(|line| format!("{line}\n"))
        .collect();
    assert!(lens_only.len() < text.len());
    let partial = file("partial.toml");
    fs::write(&partial, lens_only).unwrap();
    for more in [
        &["--rig", &rig, "--camera", "scene"][..],
        &["--rig", &partial, "--camera", "scene"],
        &[],
    ] {
        let output = run(&[&["detect", "--json", &first, &second], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.len(), 2);
        assert_eq!(lines[0]["file"], first);
        assert!(lines[0]["ms"].as_f64().unwrap() > 0.0);
        let detections = lines[0]["detections"].as_array().unwrap();
        let ids: Vec<u64> = detections
            .iter()
            .map(|detection| detection["id"].as_u64().unwrap())
            .collect();
        assert_eq!(ids, [0, 1, 2, 3, 586]);
        assert_eq!(
            (&detections[0]["family"], &detections[0]["hamming"]),
            (&"tag36h11".into(), &0.into())
        );
        assert!(detections[0]["decision_margin"].as_f64().unwrap() > 30.0);
        assert_eq!(detections[0]["corners_px"].as_array().unwrap().len(), 4);
        assert_eq!(lines[1]["detections"].as_array().unwrap().len(), 0);
    }
}

#[test]
fn check_prints_every_frame_and_a_summary() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), false);
    let output = run(&["check", &folder.path().display().to_string()]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("2 frames, 2 located, 0 lost"), "{text}");
    assert!(text.contains("reprojection error px: median 0."), "{text}");
}

#[test]
fn exchanged_cameras_are_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), false);
    // The pictures in which the markers are now claim to be the fixed camera's, which has another size.
    let list = fs::read_to_string(folder.path().join("frames.csv")).unwrap();
    let exchanged = list.replacen("\nscene,0", "\nprobe,0", 1);
    fs::write(folder.path().join("frames.csv"), exchanged).unwrap();
    let output = run(&["check", &folder.path().display().to_string()]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(
        said.contains(
            "caused by: cameras `scene` and `probe` are exchanged: a picture of one has the size of the other"
        ),
        "{said}"
    );
    assert!(said.contains("hint: exchange the two names"), "{said}");
    // With one size for both it is the markers that tell.
    let rig = RIG.replacen("size_px = [640, 640]", "size_px = [640, 480]", 1);
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let empty = vec![90; 3 * 640 * 480];
    let file = folder.path().join("scene/000001.png");
    image::save_buffer(file, &empty, 640, 480, image::ColorType::Rgb8).unwrap();
    let output = run(&["check", &folder.path().display().to_string()]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(
        said.contains("none of `1` pictures of `scene` shows markers to locate it by, but `1` of `probe` do"),
        "{said}"
    );
}

#[test]
fn a_lost_frame_is_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), true);
    let output = run(&["check", &folder.path().display().to_string()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).starts_with("error: `1` of `2` frames have no pose\n  hint: "),
        "{}",
        stderr(&output)
    );
    assert!(
        String::from_utf8(output.stdout)
            .unwrap()
            .contains("1  lost: no marker in the picture")
    );
}

#[test]
fn bad_input_is_named_with_its_causes_and_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), false);
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(
        folder.path().join("bad.toml"),
        RIG.replacen("brown_conrady", "opencv5", 1),
    )
    .unwrap();
    fs::write(folder.path().join("text.png"), "no picture").unwrap();
    image::save_buffer(folder.path().join("small.png"), &[0; 12], 2, 2, image::ColorType::Rgb8).unwrap();
    let first = path("scene/000000.png");
    let cases = [
        (
            vec!["detect".to_owned(), path("none.png")],
            "error: cannot read picture `",
        ),
        (
            vec!["detect".to_owned(), path("text.png")],
            "error: cannot read picture `",
        ),
        (
            vec![
                "detect".to_owned(),
                first.clone(),
                "--rig".into(),
                path("bad.toml"),
                "--camera".into(),
                "scene".into(),
            ],
            "caused by: `",
        ),
        (
            vec![
                "detect".to_owned(),
                first,
                "--rig".into(),
                path("rig.toml"),
                "--camera".into(),
                "left".into(),
            ],
            "has no camera `left` (there are: `scene`, `probe`)",
        ),
        (
            vec![
                "detect".to_owned(),
                path("small.png"),
                "--rig".into(),
                path("rig.toml"),
                "--camera".into(),
                "scene".into(),
            ],
            "has `2×2` pixels",
        ),
        (
            vec!["check".to_owned(), path("nowhere")],
            "error: cannot play recording `",
        ),
    ];
    for (arguments, expected) in cases {
        let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(
            message.contains(expected) && message.contains("\n  hint: "),
            "{arguments:?}: {message}"
        );
    }
}
