//! The command `probe`: pictures with known lamps in, directions and figures out.

mod support;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use glam::{DVec3, Vec3};
use mirrorball_calib::{
    pose::Pose,
    probe::mirror_ball::MirrorBall,
    rig::{Camera, Rig},
};
use support::{RIG, looking_at, picture};

/// Exposure of all pictures.
const EXPOSURE_S: f64 = 0.01;
/// Radiance of the walls, and of the lamps: unclipped at that exposure, signal 40 · 0.01 · L.
const WALL: f64 = 0.15;
const LAMP: f64 = 2.0;
const LAMP_RADIUS_DEG: f64 = 4.0;

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("text")
}

/// Lamps in a far room, by direction.
fn lamps() -> [DVec3; 2] {
    [DVec3::new(0.3, -0.5, 0.8), DVec3::new(-0.6, 0.4, 0.5)].map(DVec3::normalize)
}

/// Radiance of the far room.
fn radiance(direction: DVec3) -> f64 {
    let is_lamp = |lamp: DVec3| direction.angle_between(lamp) < LAMP_RADIUS_DEG.to_radians();
    if lamps().into_iter().any(is_lamp) { LAMP } else { WALL }
}

/// Code of a pixel: the mean over places in it of what `seen` gives, if it gives anything.
fn code(camera: &Camera, pixel: glam::DVec2, seen: impl Fn(DVec3) -> Option<f64>) -> Option<u8> {
    const SAMPLES: u32 = 4;
    let (mut sum, mut is_seen) = (0.0, false);
    for i in 0..SAMPLES * SAMPLES {
        let offset = (glam::DVec2::new(f64::from(i % SAMPLES), f64::from(i / SAMPLES)) + 0.5) / f64::from(SAMPLES);
        let ray = camera.intrinsics.unproject(pixel - 0.5 + offset)?;
        if let Some(value) = seen(ray) {
            sum += value;
            is_seen = true;
        }
    }
    let signal = sum / f64::from(SAMPLES * SAMPLES) * camera.photometry.sensitivity * EXPOSURE_S;
    let vignetting = camera.photometry.vignetting_at(pixel, camera.intrinsics.size_px);
    is_seen.then(|| camera.photometry.response.encode(signal * vignetting))
}

/// Every pixel of a camera, in the order of its picture.
fn pixels(camera: &Camera) -> impl Iterator<Item = glam::DVec2> + use<> {
    let [width, height] = camera.intrinsics.size_px;
    (0..height).flat_map(move |y| (0..width).map(move |x| glam::DVec2::new(f64::from(x), f64::from(y))))
}

fn save(file: &Path, rgb: &[u8], [width, height]: [u32; 2]) {
    fs::create_dir_all(file.parent().expect("a folder")).expect("a temporary folder can be written");
    image::save_buffer(file, rgb, width, height, image::ColorType::Rgb8).expect("a temporary folder can be written");
}

/// The rig of the tests with a fisheye camera, and what that sees.
fn fisheye(folder: &Path) {
    fs::write(folder.join("rig.toml"), RIG).expect("a temporary folder can be written");
    let rig = support::rig();
    let camera = rig.probe_camera().expect("the fisheye camera");
    let world_from_camera = camera.camera_from_world.expect("a fixed camera").inverse();
    let see = |ray: DVec3| Some(radiance(world_from_camera.transform_vector(ray)));
    let rgb: Vec<u8> = pixels(camera)
        .flat_map(|pixel| [code(camera, pixel, see).unwrap_or(0); 3])
        .collect();
    save(&folder.join("fisheye.png"), &rgb, camera.intrinsics.size_px);
}

/// A rig with one camera and a large ball, in a folder; its text.
fn one_camera_rig(folder: &Path) -> Rig {
    let (head, rest) = RIG.split_once("[[camera]]\nname = \"probe\"").expect("two cameras");
    let (_, markers) = rest.split_once("[[marker]]").expect("markers");
    let text = format!("{head}[[marker]]{markers}")
        .replace("reflectance = [0.7, 0.69, 1.0]", "reflectance = [0.7, 0.7, 0.7]")
        .replace("color = [[1.1, -0.1, 0.0], [0.0, 1.0, 0.0], [0.05, 0.0, 0.95]]\n", "")
        .replace("radius_m = 0.038", "radius_m = 0.06");
    fs::write(folder.join("rig.toml"), &text).expect("a temporary folder can be written");
    Rig::from_toml(&text, Path::new("rig.toml")).expect("a valid rig")
}

/// A camera that sees markers and ball.
fn pose() -> Pose {
    looking_at(DVec3::new(0.12, 0.08, 0.0), DVec3::new(0.15, -0.2, 0.42), 0.0)
}

/// What the scene camera sees: markers, and in the ball the far room.
fn ball(folder: &Path, rig: &Rig) {
    let camera = rig.scene_camera();
    let mut rgb = picture(rig, &pose(), 2);
    let world_from_camera = pose().inverse();
    let given = rig.ball.expect("a ball");
    let ball = MirrorBall {
        center_m: given.center_m,
        radius_m: given.radius_m,
    };
    let see = |ray: DVec3| {
        let (direction, _) = ball.reflect(world_from_camera.translation, world_from_camera.transform_vector(ray))?;
        Some(given.reflectance[0] * radiance(direction))
    };
    for (index, pixel) in pixels(camera).enumerate() {
        if let Some(code) = code(camera, pixel, see) {
            rgb[3 * index..3 * index + 3].fill(code);
        }
    }
    save(&folder.join("scene/000000.png"), &rgb, camera.intrinsics.size_px);
}

fn report(output: &Output) -> serde_json::Value {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Directions of the lights that are not of the dome, from strong to weak.
fn found(report: &serde_json::Value) -> Vec<Vec3> {
    let number = |value: &serde_json::Value| value.as_f64().expect("a number") as f32;
    (report["lights"].as_array().expect("lights").iter())
        .filter(|light| light["is_dome"] == false)
        .map(|light| {
            let direction = &light["direction"];
            Vec3::new(number(&direction[0]), number(&direction[1]), number(&direction[2]))
        })
        .collect()
}

fn assert_lamps_are_found(report: &serde_json::Value) {
    let lights = found(report);
    assert_eq!(lights.len(), lamps().len(), "{report}");
    for lamp in lamps() {
        let off_deg = lights
            .iter()
            .map(|light| light.as_dvec3().angle_between(lamp).to_degrees())
            .fold(f64::INFINITY, f64::min);
        assert!(off_deg < 0.3, "a lamp is {off_deg}° off");
    }
}

#[test]
fn a_fisheye_picture_gives_lamps_maps_and_a_chart() {
    let folder = tempfile::tempdir().unwrap();
    fisheye(folder.path());
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (image, rig, out) = (path("fisheye.png"), path("rig.toml"), path("out"));
    let command = ["probe", &image, "--rig", &rig, "--exposure-s", "0.01", "--out", &out];
    let report = report(&run(&[&command[..], &["--json"]].concat()));
    assert_lamps_are_found(&report);
    assert_eq!(report["camera"], "probe");
    let seen = report["seen"].as_f64().unwrap();
    assert!((0.48..0.54).contains(&seen), "{seen}");
    assert_eq!(report["clipped"], serde_json::json!([0.0, 0.0, 0.0]));

    // The map: equirectangular, radiance of lamp and wall, the same in both formats to RGBE's precision.
    let exr = exr::prelude::read_first_rgba_layer_from_file(
        path("out/environment.exr"),
        |size, _| vec![vec![Vec3::ZERO; size.width()]; size.height()],
        |rows: &mut Vec<Vec<Vec3>>, at, (r, g, b, _): (f32, f32, f32, f32)| {
            rows[at.y()][at.x()] = Vec3::new(r, g, b);
        },
    )
    .unwrap();
    let rows = exr.layer_data.channel_data.pixels;
    assert_eq!((rows[0].len(), rows.len()), (512, 256));
    let hdr = image::open(path("out/environment.hdr")).unwrap().into_rgb32f();
    let lamp = lamps()[0];
    let column = ((lamp.x.atan2(lamp.y) / std::f64::consts::TAU + 0.5) * 512.0) as usize;
    let row = (lamp.z.acos() / std::f64::consts::PI * 256.0) as usize;
    for (at, expected) in [((column, row), LAMP), ((10, 40), WALL)] {
        let value = rows[at.1][at.0].y;
        assert!(
            (f64::from(value) / expected - 1.0).abs() < 0.02,
            "{value}, expected {expected}"
        );
        let coarse = hdr.get_pixel(at.0 as u32, at.1 as u32).0[1];
        assert!((coarse / value - 1.0).abs() < 0.01, "{coarse} {value}");
    }
    let chart = image::open(path("out/environment.png")).unwrap();
    assert!(chart.width() == 1024 && chart.height() > 1024);
}

#[test]
fn a_ball_in_a_recording_is_measured_with_the_recorded_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let rig = one_camera_rig(folder.path());
    ball(folder.path(), &rig);
    let list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n\
                scene,0,1000000000,scene/000000.png,0.01,1.0,1.0,1.0,1.0\n";
    fs::write(folder.path().join("frames.csv"), list).unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (image, rig_file, out) = (path("scene/000000.png"), path("rig.toml"), path("out"));
    // The lamps are far away: at 2 m a ball of 6 cm would show them up to a degree elsewhere.
    let far = ["--room-distance-m", "1000"];
    let command = ["probe", &image, "--rig", &rig_file, "--out", &out];
    let report = report(&run(&[&command[..], &far, &["--json"]].concat()));
    assert_lamps_are_found(&report);
    assert_eq!(report["pictures"][0]["exposure_s"], 0.01);
    assert!(report["seen"].as_f64().unwrap() > 0.9);
    assert!(report["reprojection_error_px"].as_f64().unwrap() < 0.2);
    for method in ["median_cut", "regions"] {
        let output = run(&[&command[..], &far, &["--lights", method, "--lights-count", "8"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(text.contains(&format!("lights ({method})")), "{text}");
    }
}

/// A folder with the fisheye's rig and picture; runs the program on a picture there, expecting an error with a hint.
struct Bad {
    folder: tempfile::TempDir,
}

impl Bad {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fisheye(folder.path());
        Self { folder }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    fn save(&self, name: &str, rgb: &[u8], size_px: [u32; 2]) {
        save(&self.folder.path().join(name), rgb, size_px);
    }

    fn assert_refused(&self, picture: &str, options: &[&str], expected: &str) {
        let (image, rig, out) = (self.path(picture), self.path("rig.toml"), self.path("out"));
        let output = run(&[&["probe", &image, "--rig", &rig, "--out", &out], options].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{picture} {options:?}: {message}");
        assert!(
            message.contains(expected) && message.contains("\n  hint: "),
            "{picture} {options:?}: {message}"
        );
        assert!(!Path::new(&out).exists(), "{picture} {options:?} left files");
    }
}

#[test]
fn bad_options_are_named_with_a_hint() {
    let bad = Bad::new();
    let image = bad.path("fisheye.png");
    let exposed = ["--exposure-s", "0.01"];
    for (options, expected) in [
        (vec![], "the exposure of picture `"),
        (vec!["--exposure-s", "0"], "is `0 s` (allowed: 1e-7 to 100 s)"),
        (vec!["--exposure-s", "nan"], "is `NaN s` (allowed: 1e-7 to 100 s)"),
        ([&exposed[..], &["--gain", "1e9"]].concat(), "the gain of picture `"),
        (
            [&exposed[..], &["--wb", "1,2"]].concat(),
            "is `1,2` (allowed: three numbers of 1e-3 to 1e3)",
        ),
        (
            [&exposed[..], &["--camera", "left"]].concat(),
            "has no camera `left` (there are: `scene`, `probe`)",
        ),
        (
            [&exposed[..], &["--room-distance-m", "0"]].concat(),
            "the room's distance is `0 m`",
        ),
        (
            vec![&image, "--exposure-s", "0.01,0.02,0.03"],
            "`3` exposure times were given for `2` pictures",
        ),
    ] {
        bad.assert_refused("fisheye.png", &options, expected);
    }
}

#[test]
fn bad_pictures_are_named_with_a_hint() {
    let bad = Bad::new();
    bad.save("white.png", &[255; 3 * 640 * 640], [640; 2]);
    bad.save("black.png", &[1; 3 * 640 * 640], [640; 2]);
    bad.save("small.png", &[9; 12], [2, 2]);
    bad.save("empty.png", &[90; 3 * 640 * 480], [640, 480]);
    // The markers, from where the ball is out of the picture.
    let away = looking_at(DVec3::new(-0.12, 0.0, 0.0), DVec3::new(-0.2, 0.0, 0.22), 0.0);
    bad.save("away.png", &picture(&support::rig(), &away, 2), [640, 480]);
    let exposed = ["--exposure-s", "0.01"];
    for (picture, expected) in [
        ("small.png", "has `2×2` pixels, camera `probe` takes `640×640`"),
        ("none.png", "cannot read picture `"),
        ("white.png", "is clipped"),
        ("black.png", "is black"),
    ] {
        bad.assert_refused(picture, &exposed, expected);
    }
    let scene = [&exposed[..], &["--camera", "scene"]].concat();
    bad.assert_refused("empty.png", &scene, "caused by: no marker in the picture");
    bad.assert_refused("away.png", &scene, "does not show the probe: the ball");
}

#[test]
fn a_folder_that_cannot_be_made_is_no_fault_of_the_input() {
    let bad = Bad::new();
    let (image, rig, out) = (bad.path("fisheye.png"), bad.path("rig.toml"), bad.path("rig.toml/x"));
    let output = run(&["probe", &image, "--rig", &rig, "--exposure-s", "0.01", "--out", &out]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("cannot write `"));
}

#[test]
fn a_picture_of_another_camera_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fisheye(folder.path());
    let list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n\
                scene,0,1000000000,scene/000000.png,0.01,1.0,1.0,1.0,1.0\n\
                probe,0,1000000000,fisheye.png,0.01,1.0,1.0,1.0,1.0\n";
    fs::write(folder.path().join("frames.csv"), list).unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (image, rig, out) = (path("fisheye.png"), path("rig.toml"), path("out"));
    let output = run(&["probe", &image, "--rig", &rig, "--camera", "scene", "--out", &out]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("was taken by camera `probe`, not by `scene`"),
        "{}",
        stderr(&output)
    );
}
