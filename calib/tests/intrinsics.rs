//! `mirrorball-calib intrinsics`: corners in, rig file, numbers and page out; and what it says when there is no lens.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use glam::{DMat3, DVec2, DVec3};
use mirrorball_calib::{
    board::Board,
    camera::{Intrinsics, LensModel},
    pose::{Pose, Twist},
    rig::RigParts,
};
use serde_json::{Value, json};

const BOARD: &str = "kind = \"chessboard\"\ncolumns = 8\nrows = 6\nsquare_m = 0.04\n";

fn board() -> Board {
    Board::Chessboard {
        columns: 8,
        rows: 6,
        square_m: 0.04,
    }
}

fn lens() -> Intrinsics {
    Intrinsics {
        size_px: [640, 480],
        focal_px: DVec2::new(612.0, 609.5),
        principal_point_px: DVec2::new(325.1, 236.9),
        lens: LensModel::BrownConrady {
            k1: -0.12,
            k2: 0.05,
            p1: 0.0005,
            p2: -0.0003,
            k3: 0.0,
        },
    }
}

/// Twelve views, each turned another way by `tilt` radians; corners off by up to 0.02 px, by a rule without a pattern.
fn corners(tilt: f64) -> Value {
    let views = (0..12).map(|index| {
        let about = f64::from(index) * 2.4;
        let twist = |rotation| {
            Pose::exp(Twist {
                rotation,
                translation: DVec3::ZERO,
            })
        };
        let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rotation = facing * twist(DVec3::new(about.cos(), about.sin(), 0.0) * tilt).rotation;
        let place = DVec3::new(
            0.12 * (1.3 * about).sin(),
            0.09 * (0.7 * about).cos(),
            0.45 + 0.02 * f64::from(index),
        );
        let pose = Pose {
            rotation,
            translation: place - rotation * DVec3::new(0.14, 0.1, 0.0),
        };
        let seen = board()
            .corners_m()
            .into_iter()
            .enumerate()
            .filter_map(|(corner, point)| {
                let pixel = lens()
                    .project(pose.transform_point(point))
                    .filter(|pixel| lens().contains(*pixel))?;
                let phase = f64::from(index * 48) + corner as f64;
                let off = DVec2::new((phase * 12.9898).sin(), (phase * 78.233).sin()) * 0.02;
                Some(json!({ "corner": corner, "pixel": (pixel + off).to_array() }))
            });
        json!({ "name": format!("{index}.png"), "corners": seen.collect::<Vec<_>>() })
    });
    json!({ "size_px": [640, 480], "views": views.collect::<Vec<_>>() })
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    fs::write(folder.join("board.toml"), BOARD).expect("a temporary folder can be written");
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .current_dir(folder)
        .args([
            "intrinsics",
            "--board",
            "board.toml",
            "--model",
            "brown_conrady",
            "--out",
            "rig.toml",
        ])
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

fn failure(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stdout));
    assert!(!folder.join("rig.toml").exists(), "a rig was written");
    text(&output.stderr)
}

#[test]
fn corners_become_a_rig_numbers_and_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let mut seen = corners(0.6);
    // One corner is wrong.
    seen["views"][3]["corners"][7]["pixel"][0] =
        json!(seen["views"][3]["corners"][7]["pixel"][0].as_f64().unwrap() + 3.0);
    let wrong = seen["views"][3]["corners"][7]["corner"].clone();
    fs::write(folder.path().join("corners.json"), seen.to_string()).unwrap();
    let arguments = [
        "--corners",
        "corners.json",
        "--camera",
        "left",
        "--role",
        "ball",
        "--json",
        "n.json",
        "--report",
        "r.html",
    ];
    let output = run(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    assert!(table.contains("camera left: brown_conrady, 640 x 480 px"), "{table}");

    let rig = fs::read_to_string(folder.path().join("rig.toml")).unwrap();
    let parts = RigParts::from_toml(&rig, Path::new("rig.toml")).unwrap();
    let camera = parts.camera("left").unwrap();
    assert_eq!((camera.role.name(), camera.size_px), ("ball", [640, 480]));
    let found = camera.intrinsics.unwrap().parameters();
    for (truth, found) in lens().parameters().iter().zip(&found).take(4) {
        assert!((truth - found).abs() < 5e-3 * truth.abs().max(1.0), "{truth} {found}");
    }

    let numbers: Value = serde_json::from_str(&fs::read_to_string(folder.path().join("n.json")).unwrap()).unwrap();
    assert_eq!(numbers["routine"], "intrinsics");
    assert_eq!(numbers["model"], "brown_conrady");
    assert_eq!(numbers["parameter_names"].as_array().unwrap().len(), 9);
    assert_eq!(numbers["covariance"].as_array().unwrap().len(), 9);
    assert_eq!(numbers["covariance"][8].as_array().unwrap().len(), 9);
    assert_eq!(numbers["parameters"][0].as_f64().unwrap(), found[0]);
    assert_eq!(numbers["views"].as_array().unwrap().len(), 12);
    assert_eq!(numbers["views"][0]["camera_from_board"][2].as_array().unwrap().len(), 4);
    let rejected = numbers["rejected_corners"].as_array().unwrap();
    assert_eq!(rejected.len(), 1, "{rejected:?}");
    assert_eq!(
        (&rejected[0]["view"], &rejected[0]["corner"]),
        (&json!("3.png"), &wrong)
    );
    assert!((rejected[0]["residual_px"][0].as_f64().unwrap() - 3.0).abs() < 0.05);
    let map = &numbers["uncertainty"];
    let cells = map["columns"].as_u64().unwrap() * map["rows"].as_u64().unwrap();
    assert_eq!(map["sigma_px"].as_array().unwrap().len() as u64, cells);

    let page = fs::read_to_string(folder.path().join("r.html")).unwrap();
    for part in [
        "Lens of camera left",
        "Seen minus expected",
        "Corners seen in each part",
        "3.png",
    ] {
        assert!(page.contains(part), "{part}");
    }

    // Once more: the camera keeps its role, and the old file is kept.
    let output = run(folder.path(), &["--corners", "corners.json", "--camera", "left"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(fs::read_to_string(folder.path().join("rig.toml.old")).unwrap(), rig);
    let again = fs::read_to_string(folder.path().join("rig.toml")).unwrap();
    assert_eq!(again, rig, "the same corners give the same lens");
}

#[test]
fn what_cannot_be_calibrated_leaves_no_rig() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let write = |corners: &Value| fs::write(path.join("corners.json"), corners.to_string()).unwrap();

    write(&corners(0.0));
    let said = failure(path, &["--corners", "corners.json"]);
    assert!(said.contains("do not determine the focal length"), "{said}");
    assert!(said.contains("hint: take pictures of the board tilted"), "{said}");

    let mut few = corners(0.6);
    few["views"].as_array_mut().unwrap().truncate(2);
    write(&few);
    let said = failure(path, &["--corners", "corners.json"]);
    assert!(
        said.contains("`2` of `2` views can be used (needed: at least `3`)"),
        "{said}"
    );

    fs::write(path.join("corners.json"), "{\"size_px\": [640, 480], \"view\": []}").unwrap();
    let said = failure(path, &["--corners", "corners.json"]);
    assert!(
        said.contains("`corners.json` is no file of corners") && said.contains("`view`"),
        "{said}"
    );

    let said = failure(path, &["--corners", "corners.json", "--images", "."]);
    assert!(said.contains("cannot be used with"), "{said}");
}

#[test]
fn pictures_of_several_sizes_or_without_a_board_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = folder.path().join("pictures");
    fs::create_dir(&pictures).unwrap();
    let grey = |name: &str, width, height| {
        image::RgbImage::from_pixel(width, height, image::Rgb([90, 90, 90]))
            .save(pictures.join(name))
            .unwrap();
    };
    grey("a.png", 160, 120);
    grey("b.png", 160, 120);
    let said = failure(folder.path(), &["--images", "pictures"]);
    assert!(
        said.contains("the board was found in `0` of `2` pictures") && said.contains("`a.png`"),
        "{said}"
    );
    grey("c.png", 200, 120);
    let said = failure(folder.path(), &["--images", "pictures"]);
    assert!(
        said.contains("view `c.png` has `200×120` pixels, `a.png` has `160×120`"),
        "{said}"
    );
}
