//! The drift alarm of the program, on the recordings with truth and on rig files that are wrong on purpose.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

fn recording(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/data")
        .join(name)
        .join("recording")
}

fn check(arguments: &[&Path]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .arg("check")
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

/// What is said of a recording and its rig file with one number in it changed: exit code, error, numbers.
fn with_changed(name: &str, change: impl Fn(&mut toml::Table)) -> (Option<i32>, String, serde_json::Value) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (rig, json, page) = (
        folder.path().join("rig.toml"),
        folder.path().join("drift.json"),
        folder.path().join("drift.html"),
    );
    let mut table: toml::Table = fs::read_to_string(recording(name).join("rig.toml"))
        .expect("a readable file")
        .parse()
        .expect("a readable file");
    change(&mut table);
    fs::write(&rig, table.to_string()).expect("a temporary folder can be written");
    let output = check(&[
        &rig,
        Path::new("--recording"),
        &recording(name),
        Path::new("--json"),
        &json,
        Path::new("--report"),
        &page,
    ]);
    assert!(fs::read_to_string(page).expect("a readable file").contains("</html>"));
    let numbers = serde_json::from_str(&fs::read_to_string(json).expect("a readable file")).expect("a readable file");
    (output.status.code(), text(&output.stderr), numbers)
}

#[test]
fn the_recordings_hold() {
    for name in ["moving_lamp", "two_cameras", "fisheye"] {
        let output = check(&[&recording(name)]);
        assert_eq!(output.status.code(), Some(0), "{name}: {}", text(&output.stderr));
        assert!(text(&output.stdout).contains("rig: holds"), "{}", text(&output.stdout));
        let (code, error, numbers) = with_changed(name, |_| {});
        assert_eq!(code, Some(0), "{error}");
        assert_eq!(numbers["holds"], true);
    }
}

#[test]
fn a_marker_two_millimetres_off_is_named() {
    for (name, index) in [("moving_lamp", 1), ("moving_lamp", 3), ("two_cameras", 2)] {
        let (code, error, numbers) = with_changed(name, |rig| {
            let x = &mut rig["marker"][index]["world_from_marker"][0][3];
            *x = toml::Value::Float(x.as_float().unwrap() + 0.002);
        });
        let rig: toml::Table = fs::read_to_string(recording(name).join("rig.toml"))
            .unwrap()
            .parse()
            .unwrap();
        let id = rig["marker"][index]["id"].as_integer().unwrap();
        assert_eq!(code, Some(1), "{error}");
        assert!(error.contains(&format!("marker `{id}` has moved by ")), "{error}");
        assert!(
            error.contains("hint: ") && error.contains("`mirrorball-calib markers`"),
            "{error}"
        );
        let findings = numbers["findings"].as_array().unwrap();
        assert_eq!(findings.len(), 1, "{findings:?}");
        let distance_m = findings[0]["displacement"]["distance_m"].as_f64().unwrap();
        assert!((distance_m - 0.002).abs() < 0.0003, "{distance_m}");
    }
}

#[test]
fn a_focal_length_one_percent_off_is_named() {
    let (code, error, numbers) = with_changed("moving_lamp", |rig| {
        for axis in 0..2 {
            let focal = &mut rig["camera"][0]["lens"]["focal_px"][axis];
            *focal = toml::Value::Float(focal.as_float().unwrap() * 1.01);
        }
    });
    assert_eq!(code, Some(1), "{error}");
    assert!(
        error.contains("the lens of camera `scene` has changed: focal length -"),
        "{error}"
    );
    let ratio = numbers["findings"][0]["focal_ratio"].as_f64().unwrap();
    assert!((ratio - 1.0 / 1.01).abs() < 0.002, "{ratio}");
}

#[test]
fn a_ball_three_millimetres_off_is_named() {
    for axis in 0..3 {
        let (code, error, numbers) = with_changed("moving_lamp", |rig| {
            let place = &mut rig["ball"]["center_m"][axis];
            *place = toml::Value::Float(place.as_float().unwrap() + 0.003);
        });
        assert_eq!(code, Some(1), "{error}");
        assert!(error.contains("the ball has moved by "), "{error}");
        assert!(error.contains("`mirrorball-calib ball`"), "{error}");
        assert_eq!(numbers["findings"][0]["kind"], "ball_moved");
        // Seen from the rig's place, the true ball lies the other way. The recording's two pictures were taken from nearly
        // the same place, and say little along their line of sight.
        let shift = numbers["ball"]["shift_m"].as_array().unwrap();
        let off_squared: f64 = (0..3)
            .map(|index| shift[index].as_f64().unwrap() + if index == axis { 0.003 } else { 0.0 })
            .map(|off| off * off)
            .sum();
        assert!(off_squared.sqrt() < 0.0015, "{shift:?}");
    }
}

#[test]
fn what_cannot_be_checked_is_bad_input() {
    let rig = recording("fisheye").join("rig.toml");
    let output = check(&[&rig]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("alone cannot be checked"),
        "{}",
        text(&output.stderr)
    );
    let output = check(&[&rig, Path::new("--recording"), Path::new("nowhere")]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("cannot play recording `nowhere`"),
        "{}",
        text(&output.stderr)
    );
}
