//! `photometric`: a simulated camera's numbers come back through pictures, and bad input is told.

use std::{fmt::Write as _, fs, path::Path, process::Command};

use mirrorball_calib::{response::ResponseCurve, rig::RigParts};
use serde_json::Value;

const SIZE_PX: [u32; 2] = [256, 192];
const FULL_WELL_E: f64 = 12_000.0;
const READ_NOISE_E: f64 = 9.0;
const VIGNETTING: [f64; 2] = [-0.28, 0.05];
const NOMINAL_S: [f64; 4] = [0.002, 0.008, 0.032, 0.128];
/// True over nominal exposure; neither a common factor nor a slope is in it, as no picture could tell.
const FACTORS: [f64; 4] = [1.01, 0.99, 0.99, 1.01];

/// Numbers that look random: xorshift64* (Vigna 2016).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        ((self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// The picture of signals: red, green, blue of each pixel.
    fn shoot(&mut self, signal: impl Fn(u32, u32) -> f64) -> Vec<u8> {
        let curve = ResponseCurve::srgb();
        let mut codes = Vec::new();
        for y in 0..SIZE_PX[1] {
            for x in 0..SIZE_PX[0] {
                let y = signal(x, y);
                for tint in [1.0, 0.9, 0.8] {
                    let variance = tint * y / FULL_WELL_E + (READ_NOISE_E / FULL_WELL_E).powi(2);
                    codes.push(curve.encode(tint * y + variance.sqrt() * self.normal()));
                }
            }
        }
        codes
    }
}

/// Squares of 8 pixels, of a range of 1000, each with a slow gradient.
fn scene(x: u32, y: u32) -> f64 {
    let square = f64::from(x / 8 + 1000 * (y / 8));
    let level = (square * 0.754_877_666).fract();
    0.08 * 1e3f64.powf(level) * (1.0 + 0.004 * f64::from(x % 8 + y % 8))
}

fn save(file: &Path, codes: &[u8]) {
    image::save_buffer(file, codes, SIZE_PX[0], SIZE_PX[1], image::ColorType::Rgb8)
        .expect("a temporary folder can be written");
}

/// Folders `bracket`, `flat` and `dark`, and `exposures.csv`.
fn take_pictures(folder: &Path) {
    let mut random = Random(88_172_645_463_325_252);
    for name in ["bracket", "flat", "dark"] {
        fs::create_dir(folder.join(name)).expect("a temporary folder can be written");
    }
    let mut list = "file,exposure_s,gain\n".to_owned();
    for (index, (nominal, factor)) in NOMINAL_S.into_iter().zip(FACTORS).enumerate() {
        for repeat in 0..2 {
            let codes = random.shoot(|x, y| scene(x, y) * nominal * factor);
            save(&folder.join(format!("bracket/{index}{repeat}.png")), &codes);
            writeln!(list, "{index}{repeat}.png,{nominal},1").expect("a text can be written");
        }
    }
    fs::write(folder.join("exposures.csv"), list).expect("a temporary folder can be written");
    for (index, slope) in [0.2, -0.15, 0.1].into_iter().enumerate() {
        let half = 0.5 * f64::from(SIZE_PX[0]).hypot(f64::from(SIZE_PX[1]));
        let codes = random.shoot(|x, y| {
            let [u, v] =
                [(x, SIZE_PX[0]), (y, SIZE_PX[1])].map(|(at, n)| (f64::from(at) - 0.5 * f64::from(n - 1)) / half);
            let s = u * u + v * v;
            0.5 * (slope * (u - v)).exp() * (1.0 + s * (VIGNETTING[0] + s * VIGNETTING[1]))
        });
        save(&folder.join(format!("flat/{index}.png")), &codes);
    }
    save(&folder.join("dark/0.png"), &random.shoot(|_, _| 0.0));
}

fn run(folder: &Path, more: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .current_dir(folder)
        .args(["photometric", "--camera", "scene"])
        .args(more)
        .output()
        .expect("the program starts");
    (
        output.status.code(),
        String::from_utf8(output.stderr).expect("text of the expected kind"),
    )
}

fn json(folder: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join("out.json")).expect("text of the expected kind"))
        .expect("text of the expected kind")
}

#[test]
fn a_cameras_numbers_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    take_pictures(folder);
    let input = [
        "--images",
        "bracket",
        "--exposures",
        "exposures.csv",
        "--flat",
        "flat",
        "--dark",
        "dark",
    ];
    let output = ["--out", "rig.toml", "--json", "out.json", "--report", "out.html"];
    let (code, stderr) = run(folder, &[&input[..], &output[..]].concat());
    assert_eq!(code, Some(0), "{stderr}");
    let json = json(folder);
    println!("{}", serde_json::to_string(&json["ratio_errors"]).unwrap());
    let number = |key: &str| json[key].as_f64().unwrap();
    println!(
        "{} {} {} {}",
        number("full_well_e"),
        number("read_noise_e"),
        json["vignetting"],
        json["exposures"]
    );
    assert!((number("full_well_e") / FULL_WELL_E - 1.0).abs() < 0.05);
    assert!((number("read_noise_e") / READ_NOISE_E - 1.0).abs() < 0.3);
    assert!(number("black_code") < 3.0);
    let corner = json["vignetting"][0].as_f64().unwrap() + json["vignetting"][1].as_f64().unwrap();
    assert!((corner - VIGNETTING[0] - VIGNETTING[1]).abs() < 0.005, "{corner}");
    for (found, factor) in json["exposures"].as_array().unwrap().iter().zip(FACTORS) {
        let ratio = found["true_s"].as_f64().unwrap() / found["nominal_s"].as_f64().unwrap();
        assert!((ratio / factor - 1.0).abs() < 0.005, "{found} {factor}");
    }
    let error = |key: &str| json[key]["median"].as_f64().unwrap();
    assert!(
        error("ratio_errors") < 0.005 && error("ratio_errors") < error("ratio_errors_debevec_malik"),
        "{json}"
    );
    let text = fs::read_to_string(folder.join("rig.toml")).unwrap();
    let parts = RigParts::from_toml(&text, Path::new("rig.toml")).unwrap();
    let camera = parts.camera("scene").unwrap();
    assert_eq!(camera.size_px, SIZE_PX);
    let photometry = camera.photometry.as_ref().unwrap();
    assert_eq!(photometry.full_well_e, number("full_well_e"));
    assert_eq!(photometry.sensitivity, 1.0);
    assert!(
        fs::read_to_string(folder.join("out.html"))
            .unwrap()
            .contains("Photometry of camera scene")
    );
}

#[test]
fn latency_is_counted_in_frames() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("bracket")).unwrap();
    let mut random = Random(7);
    let asked = [(0, 0.002), (12, 0.004), (26, 0.001), (41, 0.003)];
    let in_force = |frame: u32| {
        asked
            .iter()
            .rfind(|(from, _)| *from <= frame.saturating_sub(3))
            .unwrap()
            .1
    };
    let mut list = "file,exposure_s\n".to_owned();
    for frame in 0..55 {
        let codes = random.shoot(|x, y| scene(x, y) * 8.0 * in_force(frame));
        save(&folder.join(format!("bracket/{frame:03}.png")), &codes);
        writeln!(list, "{frame:03}.png,{}", in_force(frame)).unwrap();
    }
    fs::write(folder.join("exposures.csv"), list).unwrap();
    let requests = asked
        .map(|(frame, exposure_s)| format!("{frame},{exposure_s}\n"))
        .concat();
    fs::write(folder.join("requests.csv"), format!("frame,exposure_s\n{requests}")).unwrap();
    let input = [
        "--images",
        "bracket",
        "--exposures",
        "exposures.csv",
        "--response",
        "srgb",
    ];
    let more = ["--requests", "requests.csv", "--json", "out.json"];
    let (code, stderr) = run(folder, &[&input[..], &more[..]].concat());
    assert_eq!(code, Some(0), "{stderr}");
    let json = json(folder);
    assert_eq!(
        (&json["latency_frames"], &json["latency_of_changes"]),
        (&3.into(), &vec![3, 3, 3].into())
    );
}

#[test]
fn bad_pictures_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("bracket")).unwrap();
    let mut random = Random(11);
    save(&folder.join("bracket/a.png"), &random.shoot(|x, y| scene(x, y) * 0.002));
    let (code, stderr) = run(folder, &["--images", "bracket"]);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("picture `a.png` has no exposure: its EXIF data has no block"),
        "{stderr}"
    );
    assert!(stderr.contains("hint: give `--exposures FILE.csv`"), "{stderr}");
    save(
        &folder.join("bracket/b.png"),
        &vec![255; 3 * (SIZE_PX[0] * SIZE_PX[1]) as usize],
    );
    fs::write(folder.join("list.csv"), "file,exposure_s,gain\na.png,0.002,1\n").unwrap();
    let listed = ["--images", "bracket", "--exposures", "list.csv", "--out", "rig.toml"];
    let (code, stderr) = run(folder, &listed);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("picture `b.png` has no exposure: `list.csv` does not list it"),
        "{stderr}"
    );
    fs::write(
        folder.join("list.csv"),
        "file,exposure_s,gain\na.png,0.002,1\nb.png,0.1,1\n",
    )
    .unwrap();
    let (code, stderr) = run(folder, &listed);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("picture `b.png` is saturated: `100 %` of it is white"),
        "{stderr}"
    );
    fs::write(
        folder.join("list.csv"),
        "file,exposure_s,gain\na.png,0.002,1\nb.png,nonsense,1\n",
    )
    .unwrap();
    let (code, stderr) = run(folder, &listed);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("line 3 of `list.csv` is not usable"), "{stderr}");
    fs::remove_file(folder.join("bracket/b.png")).unwrap();
    let (code, stderr) = run(folder, &[&listed[..], &["--response", "srgb"]].concat());
    assert_eq!(code, Some(2), "{stderr}");
    fs::write(folder.join("list.csv"), "file,exposure_s,gain\na.png,0.002,1\n").unwrap();
    let (code, stderr) = run(folder, &[&listed[..], &["--response", "srgb"]].concat());
    assert_eq!(code, Some(2));
    assert!(stderr.contains("the noise was not measured"), "{stderr}");
    assert!(!folder.join("rig.toml").exists());
    // What was measured is there all the same.
    let outputs = ["--response", "srgb", "--json", "out.json", "--report", "out.html"];
    let (code, _) = run(folder, &[&listed[..], &outputs[..]].concat());
    assert_eq!(code, Some(2));
    assert_eq!(json(folder)["response"][0].as_array().map(Vec::len), Some(256));
    let text = fs::read_to_string(folder.join("out.json")).unwrap();
    assert!(text.starts_with("{\n  \"routine\": \"photometric\""), "{text}");
    assert!(folder.join("out.html").exists() && !folder.join("rig.toml").exists());
    // A picture of another size is named with its folder, as another folder may have one of its name.
    fs::create_dir(folder.join("flat")).unwrap();
    image::RgbImage::new(8, 8).save(folder.join("flat/a.png")).unwrap();
    let (code, stderr) = run(
        folder,
        &[&listed[..], &["--response", "srgb", "--flat", "flat"]].concat(),
    );
    assert_eq!(code, Some(2));
    assert!(stderr.contains("picture `flat/a.png` is `8 x 8`"), "{stderr}");
}

/// Folder `bracket` with one picture of each exposure, and `list.csv` with these exposures.
fn take_bracket(folder: &Path, edit: impl Fn(&mut Vec<u8>), listed_s: [f64; 4]) {
    let mut random = Random(19);
    fs::create_dir_all(folder.join("bracket")).expect("a temporary folder can be written");
    let mut list = "file,exposure_s\n".to_owned();
    for (index, (taken_s, listed_s)) in NOMINAL_S.into_iter().zip(listed_s).enumerate() {
        let mut codes = random.shoot(|x, y| scene(x, y) * taken_s);
        edit(&mut codes);
        save(&folder.join(format!("bracket/{index}.png")), &codes);
        writeln!(list, "{index}.png,{listed_s}").expect("a text can be written");
    }
    fs::write(folder.join("list.csv"), list).expect("a temporary folder can be written");
}

const BRACKET: [&str; 6] = ["--images", "bracket", "--exposures", "list.csv", "--json", "out.json"];

#[test]
fn exposures_of_other_pictures_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut reversed = NOMINAL_S;
    reversed.reverse();
    take_bracket(folder, |_| (), reversed);
    let (code, stderr) = run(folder, &BRACKET);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("pictures of longer exposure are darker"), "{stderr}");
    take_bracket(folder, |_| (), NOMINAL_S);
    let list = fs::read_to_string(folder.join("list.csv")).unwrap();
    fs::write(folder.join("list.csv"), format!("{list}nosuch.png,0.1\n")).unwrap();
    let (code, stderr) = run(folder, &BRACKET);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(
        json(folder)["exposures_without_picture"],
        serde_json::json!(["nosuch.png"])
    );
}

#[test]
fn masked_borders_do_not_count() {
    // A border that is the same at every exposure; as a bright one it contradicts the exposures.
    let border = |codes: &mut Vec<u8>| {
        for pixel in codes.chunks_exact_mut(3).take(90 * SIZE_PX[0] as usize) {
            pixel.copy_from_slice(&[60, 60, 200]);
        }
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    take_bracket(folder, border, NOMINAL_S);
    let median = |more: &[&str]| {
        let (code, stderr) = run(folder, &[&BRACKET[..], more].concat());
        assert_eq!(code, Some(0), "{stderr}");
        json(folder)["ratio_errors"]["median"].as_f64().unwrap()
    };
    let (masked, unmasked) = (median(&["--mask-rgb", "60,60,200"]), median(&[]));
    println!("{masked} {unmasked}");
    assert!(masked < 0.01 && unmasked > 3.0 * masked, "{masked} {unmasked}");
}
