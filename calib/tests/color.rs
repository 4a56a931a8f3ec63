//! `color`: two cameras of a rig, one of which mixes its colours, look at the same patches.

mod support;

use std::{fmt::Write as _, fs, path::Path, process::Command};

use glam::{DMat3, DVec2, DVec3};
use mirrorball_calib::{
    pose::Pose,
    rig::{Camera, Rig},
};
use serde_json::Value;
use support::{RIG, looking_at, picture};

const SIDE_M: f64 = 0.04;

/// Middle, name and linear colour of the patches: a grid beside the markers.
fn patches() -> Vec<(DVec2, String, DVec3)> {
    let colors = [
        [0.9, 0.9, 0.9],
        [0.5, 0.5, 0.5],
        [0.2, 0.2, 0.2],
        [0.1, 0.1, 0.1],
        [0.7, 0.3, 0.2],
        [0.2, 0.6, 0.3],
        [0.2, 0.3, 0.7],
        [0.8, 0.7, 0.2],
        [0.6, 0.2, 0.5],
        [0.2, 0.6, 0.7],
        [0.4, 0.3, 0.2],
        [6.0, 6.0, 6.0],
    ];
    let place = |i: usize| DVec2::new(0.2 + 0.05 * (i % 4) as f64, -0.06 + 0.05 * (i / 4) as f64);
    colors
        .into_iter()
        .enumerate()
        .map(|(i, color)| (place(i), format!("patch {i}"), DVec3::from(color)))
        .collect()
}

/// Paints the patches into a picture of the table.
fn paint(codes: &mut [u8], camera: &Camera, camera_from_world: &Pose, camera_from_common: DMat3) {
    let world_from_camera = camera_from_world.inverse();
    let [width, height] = camera.intrinsics.size_px;
    for y in 0..height {
        for x in 0..width {
            let pixel = DVec2::new(f64::from(x), f64::from(y));
            let Some(ray) = camera.intrinsics.unproject(pixel) else {
                continue;
            };
            let (from, ray) = (world_from_camera.translation, world_from_camera.transform_vector(ray));
            if ray.z >= -1e-3 {
                continue;
            }
            let point = (from - ray * (from.z / ray.z)).truncate();
            let patch = patches()
                .into_iter()
                .find(|(middle, ..)| (*middle - point).abs().max_element() < 0.5 * SIDE_M);
            if let Some((_, _, color)) = patch {
                let vignetting = camera.photometry.vignetting_at(pixel, camera.intrinsics.size_px);
                // Sensitivity 40, 10 ms, no gains: 0.4 of the scale per unit of radiance.
                let signal = camera_from_common * color * 0.4 * vignetting;
                let at = 3 * (y * width + x) as usize;
                for channel in 0..3 {
                    codes[at + channel] = camera.photometry.response.encode(signal[channel]);
                }
            }
        }
    }
}

/// The rig of the tests with a probe camera that sees the table; the recording of both cameras.
fn record(folder: &Path, truth: DMat3) -> Rig {
    let middle = DVec3::new(0.2, 0.0, 0.0);
    let [a, b, c, _] = looking_at(middle, DVec3::new(0.3, -0.2, 0.45), 0.1).to_rows4();
    let text = RIG.replacen(
        "camera_from_world = [[1.0, 0.0, 0.0, 0.2], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.05]]",
        &format!("camera_from_world = {:?}", [a, b, c]),
        1,
    );
    let rig = Rig::from_toml(&text, Path::new("rig.toml")).expect("the rig of the tests is valid");
    fs::write(folder.join("rig.toml"), &text).expect("a temporary folder can be written");
    let pose = looking_at(DVec3::new(0.15, 0.0, 0.0), DVec3::new(0.1, -0.35, 0.5), 0.0);
    let mut list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n".to_owned();
    let scene = rig.scene_camera();
    let probe = rig.camera("probe").expect("the rig of the tests is valid");
    let mut codes = [picture(&rig, &pose, 1), vec![60; 3 * 640 * 640]];
    paint(&mut codes[0], scene, &pose, DMat3::IDENTITY);
    paint(
        &mut codes[1],
        probe,
        &probe.camera_from_world.expect("the rig of the tests is valid"),
        truth.inverse(),
    );
    for ((camera, codes), time) in [scene, probe]
        .into_iter()
        .zip(codes)
        .zip([1_000_000_000u64, 1_001_000_000])
    {
        let [width, height] = camera.intrinsics.size_px;
        let name = &camera.name;
        fs::create_dir(folder.join(name)).expect("a temporary folder can be written");
        let file = folder.join(format!("{name}/000000.png"));
        image::save_buffer(file, &codes, width, height, image::ColorType::Rgb8)
            .expect("a temporary folder can be written");
        writeln!(list, "{name},0,{time},{name}/000000.png,0.01,1.0,1.0,1.0,1.0").expect("a text can be written");
    }
    fs::write(folder.join("frames.csv"), list).expect("a temporary folder can be written");
    let mut sheet = "marker = 0\n".to_owned();
    for (middle, name, _) in patches() {
        let (x, y) = (middle.x, middle.y);
        writeln!(
            sheet,
            "[[patch]]\nname = \"{name}\"\nx_m = {x}\ny_m = {y}\nside_m = {SIDE_M}"
        )
        .expect("the simulated input is complete");
    }
    fs::write(folder.join("patches.toml"), sheet).expect("a temporary folder can be written");
    rig
}

fn run(folder: &Path, more: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .current_dir(folder)
        .args([
            "color",
            "--rig",
            "rig.toml",
            "--recording",
            ".",
            "--patches",
            "patches.toml",
        ])
        .args(more)
        .output()
        .expect("the program starts");
    (
        output.status.code(),
        String::from_utf8(output.stderr).expect("text of the expected kind"),
    )
}

#[test]
fn a_camera_that_mixes_colours_is_matched_and_the_rig_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let truth = DMat3::from_cols_array_2d(&[[1.2, 0.1, -0.05], [-0.2, 0.95, 0.1], [0.05, -0.05, 1.3]]);
    let rig = record(folder, truth);
    let out = ["--out", "new.toml", "--json", "out.json", "--report", "out.html"];
    let (code, stderr) = run(folder, &[&["--cameras", "scene,probe"], &out[..]].concat());
    assert_eq!(code, Some(0), "{stderr}");
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.join("out.json")).unwrap()).unwrap();
    for row in 0..3 {
        for column in 0..3 {
            let found = json["first_from_second"][row][column].as_f64().unwrap();
            assert!((found - truth.row(row)[column]).abs() < 0.02, "{row} {column} {found}");
        }
    }
    let mean = json["after"]["delta_e00_mean"].as_f64().unwrap();
    assert!(
        mean < 0.5 && json["before"]["delta_e00_mean"].as_f64().unwrap() > 3.0,
        "{json}"
    );
    assert!(json["after"]["relative_mean"].as_f64().unwrap() < 0.01, "{json}");
    // The lamp-bright patch is clipped and named.
    let left_out = json["left_out"].as_array().unwrap();
    assert!(
        left_out
            .iter()
            .all(|left| left["patch"] == "patch 11" && left["reason"] == "clipped"),
        "{left_out:?}"
    );
    assert_eq!(left_out.len(), 2, "{left_out:?}");
    // The common colours are those that the first camera is taken to by its own matrix.
    let text = fs::read_to_string(folder.join("new.toml")).unwrap();
    let written = Rig::from_toml(&text, Path::new("new.toml")).unwrap();
    let expected = rig.scene_camera().photometry.color * truth;
    let found = written.camera("probe").unwrap().photometry.color;
    assert!((found - expected).abs_diff_eq(DMat3::ZERO, 0.03), "{found} {expected}");
    assert_eq!(written.scene_camera(), rig.scene_camera());
    assert!(
        fs::read_to_string(folder.join("out.html"))
            .unwrap()
            .contains("Colour of camera probe")
    );
}

#[test]
fn what_cannot_be_matched_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, DMat3::IDENTITY);
    let (code, stderr) = run(folder, &["--cameras", "scene,prone"]);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("no camera `prone` (there are: `scene`, `probe`)"),
        "{stderr}"
    );
    let (code, stderr) = run(folder, &["--cameras", "scene,probe", "--keep", "patch 11"]);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("patch `patch 11`, whose colour is to be kept"),
        "{stderr}"
    );
    let corners = "scene=0,0,1,0,2,0,3,0";
    let (code, stderr) = run(folder, &["--cameras", "scene,probe", "--chart-corners", corners]);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("needs a sheet with `corners_m`"), "{stderr}");
    let sheet = fs::read_to_string(folder.join("patches.toml")).unwrap();
    fs::write(
        folder.join("patches.toml"),
        sheet.replacen("marker = 0", "marker = 99", 1),
    )
    .unwrap();
    let (code, stderr) = run(folder, &["--cameras", "scene,probe"]);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("beside marker `99`, which the rig does not have"),
        "{stderr}"
    );
    assert!(stderr.contains("hint: name a marker of the rig"), "{stderr}");
}

fn program(folder: &Path, args: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program starts");
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8(text).expect("text of the expected kind"),
    )
}

/// Gains and grey light before them: the second camera set to k looks as the first one set to k + 300.
fn look(camera: usize, setting: f64) -> ([f64; 3], DVec3) {
    let raw = [DVec3::new(0.9, 1.0, 0.5), DVec3::new(0.7, 1.0, 0.8)];
    let mired = 1e6 / (setting + 300.0 * camera as f64);
    let given_out = DVec3::new((0.5 - 0.0026 * mired).exp(), 1.0, (-0.8 + 0.0031 * mired).exp());
    ((given_out / raw[camera]).to_array(), given_out)
}

/// Records the sheet by both cameras at several settings each; the table of the settings.
fn record_settings(folder: &Path) -> String {
    let rig = record(folder, DMat3::IDENTITY);
    let pose = looking_at(DVec3::new(0.15, 0.0, 0.0), DVec3::new(0.1, -0.35, 0.5), 0.0);
    let cameras = [
        rig.scene_camera(),
        rig.camera("probe").expect("the rig of the tests has it"),
    ];
    let empty = [picture(&rig, &pose, 1), vec![60; 3 * 640 * 640]];
    let poses = [pose, cameras[1].camera_from_world.expect("it is fixed")];
    let mut list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n".to_owned();
    let mut settings = "camera,frame,setting\n".to_owned();
    for (index, all) in [&[4050.0, 5500.0][..], &[3000.0, 3500.0, 4000.0, 4500.0]]
        .into_iter()
        .enumerate()
    {
        let name = &cameras[index].name;
        for (frame, &setting) in all.iter().enumerate() {
            let ([r, g, b], given_out) = look(index, setting);
            let mut codes = empty[index].clone();
            paint(
                &mut codes,
                cameras[index],
                &poses[index],
                DMat3::from_diagonal(given_out),
            );
            let [width, height] = cameras[index].intrinsics.size_px;
            let file = format!("{name}/{frame:06}.png");
            image::save_buffer(folder.join(&file), &codes, width, height, image::ColorType::Rgb8)
                .expect("a folder that takes it");
            let time = 1_000_000_000 + 33_000_000 * (frame + 10 * index);
            writeln!(list, "{name},{frame},{time},{file},0.01,1.0,{r},{g},{b}").expect("a folder that takes it");
            writeln!(settings, "{name},{frame},{setting}").expect("a folder that takes it");
        }
    }
    fs::write(folder.join("frames.csv"), list).expect("a folder that takes it");
    fs::write(folder.join("settings.csv"), &settings).expect("a folder that takes it");
    settings
}

#[test]
fn the_settings_at_which_white_balances_agree_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let settings = record_settings(folder);
    let sheet = fs::read_to_string(folder.join("patches.toml")).unwrap();
    let ask = [
        "--cameras",
        "scene,probe",
        "--white-balance",
        "--settings",
        "settings.csv",
    ];
    let (code, stderr) = run(folder, &ask);
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.contains("the sheet has no neutral patch"), "{stderr}");
    let greys = ["patch 0", "patch 1", "patch 11"].iter().fold(sheet, |sheet, name| {
        let key = format!("name = \"{name}\"\n");
        sheet.replacen(&key, &format!("{key}neutral = true\n"), 1)
    });
    fs::write(folder.join("patches.toml"), greys).unwrap();
    let (code, stderr) = run(
        folder,
        &[&ask[..], &["--json", "wb.json", "--report", "wb.html"]].concat(),
    );
    assert_eq!(code, Some(0), "{stderr}");
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.join("wb.json")).unwrap()).unwrap();
    // The lamp-bright patch is not used.
    assert_eq!(json["patches"], serde_json::json!(["patch 0", "patch 1"]));
    let row = &json["white_balance"][0];
    let number = |key: &str| row[key].as_f64().unwrap();
    assert!((number("second_setting") - 3750.0).abs() < 30.0, "{row}");
    assert!(
        number("delta_e00") < 1.0 && number("second_setting_sigma") < 40.0,
        "{row}"
    );
    assert_eq!(row["is_at_end"], false);
    let row = &json["white_balance"][1];
    assert!(row["is_at_end"] == true && row["second_setting"] == 4500.0, "{row}");
    assert!(
        fs::read_to_string(folder.join("wb.html"))
            .unwrap()
            .contains("White balance of camera probe")
    );
    let few = settings.lines().take(5).collect::<Vec<_>>().join("\n");
    fs::write(folder.join("settings.csv"), few).unwrap();
    let (code, stderr) = run(folder, &ask);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("camera `probe` shows the patches at `2` settings (allowed: `3` or more)"),
        "{stderr}"
    );
}

#[test]
fn the_sheet_is_printed_with_the_marker_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (code, text) = program(folder, &["color", "--print-sheet", "sheet.svg", "--marker", "7"]);
    assert_eq!(code, Some(0), "{text}");
    let svg = fs::read_to_string(folder.join("sheet.svg")).unwrap();
    assert!(
        svg.contains("width=\"210mm\"") && svg.contains("Marker 7 of tag36h11"),
        "{svg}"
    );
    let (code, text) = program(folder, &["color", "--print-sheet", "sheet.svg", "--marker", "587"]);
    assert_eq!(code, Some(2));
    assert!(
        text.contains("there is no marker `587` (allowed: `0` to `586`)"),
        "{text}"
    );
    let (code, text) = program(folder, &["color", "--rig", "rig.toml"]);
    assert_eq!(code, Some(2));
    assert!(text.contains("--recording"), "{text}");
}
