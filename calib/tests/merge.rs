//! `mirrorball-calib merge`: brackets made by code, merged by the program.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use mirrorball_calib::response::ResponseCurve;

const SIZE_PX: [u32; 2] = [160, 120];

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("text")
}

/// Radiance at a pixel: squares of 8 pixels from 0.002 to 2, and a lamp of 8 that only the shortest exposure holds.
fn radiance(x: u32, y: u32) -> f64 {
    if (64..80).contains(&x) && (40..56).contains(&y) {
        8.0
    } else {
        let square = (x / 8 * 7 + y / 8 * 13) % 97;
        0.002 * 1000f64.powf(f64::from(square) / 96.0)
    }
}

/// A gamma of 2.
fn truth() -> ResponseCurve {
    let values: Vec<f64> = (0..256).map(|code| (f64::from(code) / 255.0).powi(2)).collect();
    ResponseCurve::from_table(&values).expect("a curve")
}

/// Writes a picture with the codes of that radiance, and noise of half a code that the place decides.
fn shoot(file: &Path, exposure_s: f64, size_px: [u32; 2]) {
    let curve = truth();
    let picture = image::RgbImage::from_fn(size_px[0], size_px[1], |x, y| {
        let noise = f64::from((x * 31 + y * 17 + x * y * 7) % 11) / 10.0 - 0.5;
        let signal = radiance(x, y) * exposure_s;
        let code = f64::from(curve.encode(signal)) + noise;
        image::Rgb(
            [if signal >= 1.0 {
                255
            } else {
                code.round().clamp(0.0, 255.0) as u8
            }; 3],
        )
    });
    picture.save(file).expect("a temporary folder can be written");
}

const TIMES: [(&str, f64); 4] = [("1/10", 0.1), ("0.4", 0.4), ("1.6", 1.6), ("6.4", 6.4)];

/// A bracket in a folder: the files and their exposure times as text.
fn bracket(folder: &Path) -> (Vec<String>, String) {
    let files = (0..TIMES.len()).map(|i| {
        let file = folder.join(format!("{i}.png"));
        shoot(&file, TIMES[i].1, SIZE_PX);
        file.display().to_string()
    });
    (files.collect(), TIMES.map(|(text, _)| text).join(","))
}

fn merge(files: &[String], more: &[&str], out: &Path) -> Output {
    let mut arguments = vec!["merge"];
    arguments.extend(files.iter().map(String::as_str));
    arguments.extend(more);
    let out = out.display().to_string();
    arguments.extend(["--out", &out]);
    run(&arguments)
}

fn read_exr(file: &Path) -> Vec<[f32; 3]> {
    use exr::prelude::*;
    let image = read_first_rgba_layer_from_file(
        file,
        |size, _| (size.width(), vec![[0.0f32; 3]; size.area()]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
    )
    .expect("an OpenEXR picture");
    image.layer_data.channel_data.pixels.1
}

#[test]
fn a_bracket_becomes_radiance_and_a_response() {
    let folder = tempfile::tempdir().unwrap();
    let (files, times) = bracket(folder.path());
    let out = folder.path().join("out");
    let output = merge(&files, &["--exposure-s", &times, "--json"], &out);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["pictures"].as_array().unwrap().len(), 4);
    let error = report["response"]["exposure_ratio"]["pair_median"].as_f64().unwrap();
    assert!(error < 0.01, "{error}");
    assert!(report["merged"]["measured"].as_f64().unwrap() > 0.999);
    assert_eq!(report["merged"]["moved"], 0.0);

    // The unit of radiance is set by the response's 1 at code 255, as the truth's is.
    let merged = read_exr(&out.join("merged.exr"));
    assert_eq!(merged.len(), (SIZE_PX[0] * SIZE_PX[1]) as usize);
    let mut errors: Vec<f64> = Vec::new();
    for (index, rgb) in merged.iter().enumerate() {
        let truth = radiance(index as u32 % SIZE_PX[0], index as u32 / SIZE_PX[0]);
        errors.extend(rgb.iter().map(|&value| (f64::from(value) / truth - 1.0).abs()));
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() / 2] < 0.02, "median {}", errors[errors.len() / 2]);
    let lamp = merged[(48 * SIZE_PX[0] + 72) as usize][1];
    assert!((lamp / 8.0 - 1.0).abs() < 0.03, "{lamp}");

    let view = image::open(out.join("merged.png")).unwrap();
    assert_eq!([view.width(), view.height()], [2 * SIZE_PX[0], SIZE_PX[1]]);
    assert!(fs::read(out.join("merged.hdr")).unwrap().starts_with(b"#?RADIANCE\n"));

    // What it writes it reads, and so does a rig.
    let response = out.join("response.toml").display().to_string();
    let again = folder.path().join("again");
    let output = merge(&files, &["--exposure-s", &times, "--response", &response], &again);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("exposure-ratio error:") && text.contains("nothing was warped"),
        "{text}"
    );
    let toml: toml::Table = fs::read_to_string(&response).unwrap().parse().unwrap();
    let values: Vec<f64> = toml["response"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_float().unwrap())
        .collect();
    let curve = ResponseCurve::from_table(&values).unwrap();
    for code in 32..=224 {
        let ratio = curve.linear_from_code(code) / truth().linear_from_code(code);
        assert!((ratio - 1.0).abs() < 0.03, "code {code}: {ratio}");
    }
}

#[test]
fn a_list_gives_pictures_and_exposures() {
    let folder = tempfile::tempdir().unwrap();
    bracket(folder.path());
    let list = folder.path().join("image_list.txt");
    let lines = (0..4).map(|i| format!("{i}.png {} {} 8 0 0\n", TIMES[i].1, 1.0 / TIMES[i].1));
    fs::write(&list, format!("# name exposure\n{}", lines.collect::<String>())).unwrap();
    let out = folder.path().join("out");
    let list = list.display().to_string();
    let output = merge(
        &[],
        &["--list", &list, "--response", "fit-channels", "--nominal-exposures"],
        &out,
    );
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("  6.400000  ") && table.contains("3.png"), "{table}");
    // All channels are alike here, and so are their curves.
    let toml = fs::read_to_string(out.join("response.toml")).unwrap();
    assert!(toml.contains("response = ["), "{toml}");
}

/// Runs and expects exit code 2 with this on standard error, and no picture.
fn refused(files: &[String], more: &[&str], message: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let output = merge(files, more, folder.path());
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains(message), "{}", stderr(&output));
    assert!(!folder.path().join("merged.exr").exists());
}

#[test]
fn bad_input_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (files, times) = bracket(folder.path());
    let file = |name: &str| folder.path().join(name);
    let text = |path: &PathBuf| path.display().to_string();
    refused(
        &files[..1],
        &["--exposure-s", "1"],
        "there are `1` pictures (allowed: 2 to 255)",
    );
    refused(&files, &[], "there are `0` exposure times for `4` pictures");
    refused(
        &files[..2],
        &["--exposure-s", "1,soon"],
        "exposure time `soon` of picture",
    );
    refused(&files[..2], &["--exposure-s", "1,0"], "exposure time `0` of picture");
    refused(
        &files[..2],
        &["--exposure-s", "1,1/0"],
        "exposure time `1/0` of picture",
    );
    refused(&files[..2], &["--exposure-s", "1,1"], "all exposure times are `1` s");
    refused(
        &files,
        &["--exposure-s", &times, "--response", "srgb", "--nominal-exposures"],
        "only where the response is fitted",
    );

    let small = file("small.png");
    shoot(&small, 1.0, [80, 60]);
    refused(
        &[files[0].clone(), text(&small)],
        &["--exposure-s", "1,2"],
        "is `80 x 60` (allowed: `160 x 120`",
    );

    let ends = [0u8, 255].map(|code| {
        let path = file(&format!("all{code}.png"));
        image::RgbImage::from_pixel(160, 120, image::Rgb([code; 3]))
            .save(&path)
            .unwrap();
        text(&path)
    });
    refused(
        &ends,
        &["--exposure-s", "1,2"],
        "all pixels of all pictures are clipped or black",
    );
    refused(
        &[text(&file("none.png")), files[0].clone()],
        &["--exposure-s", "1,2"],
        "cannot read picture",
    );

    let mut values: Vec<String> = (0..256).map(|code| format!("{}", f64::from(code) / 255.0)).collect();
    values[77] = "0.1".to_owned();
    let curve = file("response.toml");
    fs::write(&curve, format!("response = [{}]", values.join(", "))).unwrap();
    refused(
        &files,
        &["--exposure-s", &times, "--response", &text(&curve)],
        "at code `77`",
    );
    fs::write(&curve, "response_red = [1.0]").unwrap();
    refused(
        &files,
        &["--exposure-s", &times, "--response", &text(&curve)],
        "is not a response",
    );

    let list = file("list.txt");
    fs::write(&list, "0.png 32\n1.png\n").unwrap();
    refused(&[], &["--list", &text(&list)], "line 2 has `1` columns");
    refused(&[], &["--list", &text(&file("none.txt"))], "cannot read");
}
