//! The ball's place, size and reflectance from synthetic pictures of a room whose every length is known.

mod support;

use std::{path::Path, sync::OnceLock};

use glam::{DVec2, DVec3};
use mirrorball_calib::{
    ball_fit::{
        self, BallError, BallFit, BallPrior, BallView, Measured, ViewResult, direction::used_direction, reflectance,
    },
    pose::{Pose, Twist},
    probe::{View, mirror_ball::MirrorBall, radiance::Picture},
    rig::{Camera, Rig},
};
use mirrorball_capture::frame::{Exposure, Frame, FrameMeta, PixelFormat, Size};
use rayon::prelude::*;
use support::{looking_at, paper, rig};

const EXPOSURE: Exposure = Exposure {
    time_s: 0.01,
    gain: 1.0,
    white_balance: [1.0; 3],
};

const REFLECTANCE: DVec3 = DVec3::new(0.72, 0.68, 0.6);

const BALL: MirrorBall = MirrorBall {
    center_m: DVec3::new(0.02, -0.095, 0.045),
    radius_m: 0.0385,
};

/// Numbers of a normal distribution, the same every time (splitmix64, Box and Muller 1958).
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Radiance of the room along a ray: paper and a grainy table, a stand under the ball, walls with a window.
fn room(rig: &Rig, from: DVec3, ray: DVec3) -> DVec3 {
    let stand = DVec2::new(from.x - BALL.center_m.x, from.y - BALL.center_m.y);
    let across = ray.truncate();
    // The stand is a black cylinder of 12 mm up to 12 mm.
    let (a, b, c) = (
        across.length_squared(),
        stand.dot(across),
        stand.length_squared() - 0.012f64.powi(2),
    );
    let at_stand = (-b - (b * b - a * c).sqrt()) / a;
    if at_stand > 1e-6 && (0.0..0.012).contains(&(from.z + ray.z * at_stand)) {
        return DVec3::splat(0.02);
    }
    if let Some((_, is_white)) = paper(rig, from, ray) {
        return if is_white {
            DVec3::new(0.72, 0.7, 0.66)
        } else {
            DVec3::splat(0.03)
        };
    }
    if ray.z < -1e-6 {
        let at = from - ray * ((from.z + 0.001) / ray.z);
        let grain =
            0.06 * (400.0 * at.x + 3.0 * (110.0 * at.y).sin()).sin() + 0.03 * (1700.0 * at.y + 250.0 * at.x).sin();
        // The ball's contact shadow.
        let shadow = 1.0 - 0.6 * (-((at - BALL.center_m).truncate().length() / 0.03).powi(2)).exp();
        return DVec3::new(0.45, 0.33, 0.22) * (1.0 + grain) * shadow;
    }
    if ray.angle_between(DVec3::new(-0.7, 0.3, 0.5)) < 0.25 {
        DVec3::new(4.0, 4.3, 4.6)
    } else {
        DVec3::new(0.5, 0.52, 0.55) * (1.0 + 0.3 * ray.x + 0.2 * ray.z)
    }
}

/// How a picture is taken.
#[derive(Clone, Copy)]
struct Take {
    camera_from_world: Pose,
    /// Standard deviation of the lens's blur, pixels.
    blur_px: f64,
    seed: u64,
    /// A card covers this share of the ball from its left.
    covered: f64,
    /// A finger's width of something else: the ball stands elsewhere in this picture.
    moved_m: DVec3,
}

/// Mean radiance of every pixel, before blur and noise.
fn light(rig: &Rig, take: &Take) -> Vec<DVec3> {
    let camera = rig.scene_camera();
    let ball = MirrorBall {
        center_m: BALL.center_m + take.moved_m,
        ..BALL
    };
    let world_from_camera = take.camera_from_world.inverse();
    let from = world_from_camera.translation;
    let [width, height] = camera.intrinsics.size_px;
    let center = take.camera_from_world.transform_point(ball.center_m);
    let card_to = center.x + ball.radius_m * (2.0 * take.covered - 1.0);
    let radiance = |ray: DVec3| {
        let at_ball = ray * (center.z / ray.z);
        if take.covered > 0.0 && at_ball.x < card_to && (at_ball - center).length() < 2.0 * ball.radius_m {
            return DVec3::new(0.2, 0.5, 0.3);
        }
        let ray = world_from_camera.transform_vector(ray);
        match ball.reflect(from, ray) {
            Some((out, point)) => room(rig, point, out) * REFLECTANCE,
            None => room(rig, from, ray),
        }
    };
    let center_px = camera.intrinsics.project(center).expect("before the camera");
    let radius_px = camera.intrinsics.focal_px.x * ball.radius_m / center.z;
    let pixel = |index: u32| {
        let middle = DVec2::new(f64::from(index % width), f64::from(index / width));
        // Many rays where they count.
        let from_outline = middle.distance(center_px) - radius_px;
        let parts: u32 = if from_outline.abs() < 8.0 {
            6
        } else if from_outline < 0.0 {
            3
        } else {
            2
        };
        let mut sum = DVec3::ZERO;
        for i in 0..parts * parts {
            let offset = (DVec2::new(f64::from(i % parts), f64::from(i / parts)) + 0.5) / f64::from(parts) - 0.5;
            sum += radiance(camera.intrinsics.unproject(middle + offset).expect("inside the lens"));
        }
        sum / f64::from(parts * parts)
    };
    (0..width * height).into_par_iter().map(pixel).collect()
}

fn picture(rig: &Rig, take: &Take) -> Frame {
    photograph(rig, take, &light(rig, take))
}

/// The picture that a camera takes of some light.
fn photograph(rig: &Rig, take: &Take, light: &[DVec3]) -> Frame {
    let camera = rig.scene_camera();
    let [width, height] = camera.intrinsics.size_px;
    let light = blurred(light, [width as usize, height as usize], take.blur_px);
    let mut noise = Noise(take.seed);
    let photometry = &camera.photometry;
    let mut pixels = Vec::with_capacity(3 * light.len());
    for (index, light) in (0..width * height).zip(light) {
        let middle = DVec2::new(f64::from(index % width), f64::from(index / width));
        let signal = DVec3::from_array(photometry.signal_per_radiance(&EXPOSURE))
            * photometry.vignetting_at(middle, camera.intrinsics.size_px)
            * light;
        pixels.extend(signal.to_array().map(|y| {
            let electrons = y * photometry.full_well_e;
            let sigma = (electrons + photometry.read_noise_e.powi(2)).sqrt();
            let sensed = (electrons + sigma * noise.normal()) / photometry.full_well_e;
            photometry.response.encode(sensed)
        }));
    }
    Frame {
        meta: FrameMeta::new("scene".into(), 0, 0, EXPOSURE),
        size: Size { width, height },
        format: PixelFormat::Rgb8,
        pixels: pixels.into(),
    }
}

/// Blurs by a normal distribution, rows and then columns.
fn blurred(light: &[DVec3], [width, height]: [usize; 2], sigma_px: f64) -> Vec<DVec3> {
    if sigma_px <= 0.0 {
        return light.to_vec();
    }
    let reach = (3.0 * sigma_px).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach)
        .map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp())
        .collect();
    let total: f64 = weights.iter().sum();
    let pass = |light: &[DVec3], (step_x, step_y): (i64, i64)| -> Vec<DVec3> {
        let at = |x: i64, y: i64| {
            light[(y.clamp(0, height as i64 - 1) * width as i64 + x.clamp(0, width as i64 - 1)) as usize]
        };
        let pixel = |index: usize| {
            let (x, y) = ((index % width) as i64, (index / width) as i64);
            let taps = weights.iter().zip(-reach..=reach);
            taps.map(|(weight, i)| at(x + i * step_x, y + i * step_y) * (weight / total))
                .sum()
        };
        (0..light.len()).into_par_iter().map(pixel).collect()
    };
    pass(&pass(light, (1, 0)), (0, 1))
}

/// The rig of the tests, with a camera whose colours are the common ones.
fn plain_rig() -> Rig {
    let mut rig = rig();
    rig.cameras[0].photometry.color = glam::DMat3::IDENTITY;
    rig
}

/// A camera on a ring around the ball, that sees it 200 pixels wide and 15° off its axis.
fn pose(turn_rad: f64, rise: f64) -> Pose {
    let away = DVec3::new(turn_rad.cos(), turn_rad.sin(), rise).normalize() * 0.245;
    let straight = looking_at(BALL.center_m, BALL.center_m + away, 0.0);
    Pose::exp(Twist {
        rotation: DVec3::new(0.05, 15f64.to_radians(), 0.3) * if turn_rad.sin() > 0.0 { 1.0 } else { -1.0 },
        translation: DVec3::ZERO,
    }) * straight
}

/// Most pictures of a test.
const N_TAKES: usize = 5;

fn ordinary_takes(n: usize, blur_px: f64) -> Vec<Take> {
    (0..n)
        .map(|i| Take {
            camera_from_world: pose(1.3 + 1.25 * i as f64, 0.9 + 0.25 * (i % 3) as f64),
            blur_px,
            seed: 7 + i as u64,
            covered: 0.0,
            moved_m: DVec3::ZERO,
        })
        .collect()
}

fn views<'a>(camera: &'a Camera, takes: &[Take], frames: &'a [Frame]) -> Vec<BallView<'a>> {
    let view = |(index, (take, frame)): (usize, (&Take, &'a Frame))| BallView {
        name: format!("view {index}"),
        view: View {
            picture: Picture::new(frame, camera),
            camera,
            camera_from_world: take.camera_from_world,
        },
        position_sigma_m: 2e-4,
    };
    takes.iter().zip(frames).enumerate().map(view).collect()
}

fn prior() -> BallPrior {
    BallPrior {
        center_m: BALL.center_m + DVec3::new(0.002, -0.0015, 0.0015),
        radius_m: None,
        measured_radius: None,
        reflectance: ball_fit::TYPICAL_REFLECTANCE,
    }
}

/// The pictures of takes; the light of those in which nothing is out of the ordinary is computed once for all tests.
fn frames(rig: &Rig, takes: &[Take]) -> Vec<Frame> {
    static LIGHTS: [OnceLock<Vec<DVec3>>; N_TAKES] = [const { OnceLock::new() }; N_TAKES];
    let ordinary = ordinary_takes(N_TAKES, 0.0);
    let frame = |take: &Take| {
        let known = ordinary.iter().position(|known| {
            (known.camera_from_world, known.covered, known.moved_m)
                == (take.camera_from_world, take.covered, take.moved_m)
        });
        match known {
            Some(index) => photograph(rig, take, LIGHTS[index].get_or_init(|| light(rig, take))),
            None => picture(rig, take),
        }
    };
    takes.iter().map(frame).collect()
}

fn fitted(takes: &[Take], prior: &BallPrior) -> Result<BallFit, BallError> {
    let rig = plain_rig();
    let frames = frames(&rig, takes);
    ball_fit::fit(&views(rig.scene_camera(), takes, &frames), prior)
}

/// Errors of the reflected direction over the used part of the ball's face, degrees: median and 95th percentile.
fn direction_errors_deg(fit: &BallFit, takes: &[Take]) -> [f64; 2] {
    let rig = plain_rig();
    let intrinsics = &rig.scene_camera().intrinsics;
    let mut errors = Vec::new();
    for take in takes {
        let world_from_camera = take.camera_from_world.inverse();
        let (camera_m, [width, height]) = (world_from_camera.translation, intrinsics.size_px);
        for index in (0..width * height).step_by(7) {
            let pixel = DVec2::new(f64::from(index % width), f64::from(index / width));
            let ray = world_from_camera.transform_vector(intrinsics.unproject(pixel).expect("inside the lens"));
            let Some(truth) = used_direction(&BALL, camera_m, ray) else {
                continue;
            };
            let found = fit
                .ball
                .reflect(camera_m, ray)
                .map_or(DVec3::ZERO, |(direction, _)| direction);
            errors.push(found.angle_between(truth).to_degrees());
        }
    }
    errors.sort_by(f64::total_cmp);
    [0.5, 0.95].map(|share| errors[(share * (errors.len() - 1) as f64) as usize])
}

#[test]
fn a_ball_of_200_pixels_shows_directions_to_a_tenth_of_a_degree() {
    let mut failed = false;
    let rig = plain_rig();
    for blur_px in [0.4, 0.8] {
        let takes = ordinary_takes(N_TAKES, blur_px);
        let frames = frames(&rig, &takes);
        let views = views(rig.scene_camera(), &takes, &frames);
        // As the command does: the outline's look depends on the reflectance, which is measured with the outline.
        let first = ball_fit::fit(&views, &prior()).expect("the ball is there");
        let measured = reflectance::measure(&views, &first.ball, &rig.markers).expect("papers are there");
        println!(
            "reflectance {:.4} (true {REFLECTANCE:.4}), {measured:?}",
            measured.value
        );
        let again = BallPrior {
            center_m: first.ball.center_m,
            radius_m: Some(first.ball.radius_m),
            reflectance: measured.value.as_vec3(),
            ..prior()
        };
        let fit = ball_fit::fit(&views, &again).expect("the ball is there");
        let off = (measured.value / REFLECTANCE - 1.0).abs().max_element();
        assert!(off < 0.02, "reflectance off by {off}");
        let [median, p95] = direction_errors_deg(&fit, &takes);
        let off = fit.ball.center_m - BALL.center_m;
        let sigma = fit.covariance_m2.diagonal().map(|v| 1e3 * v.sqrt());
        println!(
            "blur {blur_px}: median {median:.3}°, p95 {p95:.3}°, centre off {:.3} mm, radius {:+.4} mm, sigma {sigma:?} mm, scale {:.2}, blur {:.3}, growth {:.3}",
            1e3 * off.length(),
            1e3 * (fit.ball.radius_m - BALL.radius_m),
            fit.scale,
            fit.blur_px,
            fit.growth_px
        );
        failed |= median > 0.15 || p95 > 0.35;
    }
    assert!(!failed);
}

/// The fit for a radius that is known about, so that it need not be searched for.
fn about() -> BallPrior {
    BallPrior {
        radius_m: Some(1.01 * BALL.radius_m),
        reflectance: REFLECTANCE.as_vec3(),
        ..prior()
    }
}

#[test]
fn one_view_needs_a_ruler_and_then_does() {
    let takes = ordinary_takes(1, 0.4);
    let error = fitted(&takes, &about()).unwrap_err();
    assert_eq!(
        error,
        BallError::OneView {
            view: "view 0".to_owned()
        }
    );
    let measured = Measured {
        value_m: BALL.radius_m + 1e-4,
        sigma_m: 1e-4,
    };
    let fit = fitted(
        &takes,
        &BallPrior {
            measured_radius: Some(measured),
            ..about()
        },
    )
    .expect("the ruler helps");
    let offset = fit.ball.center_m - BALL.center_m;
    // The distance is as wrong as the ruler: 0.26 % of 245 mm.
    assert!(offset.length() < 3.0 * 0.0026 * 0.245, "{offset}");
    let [median, _] = direction_errors_deg(&fit, &takes);
    assert!(median < 0.4, "{median}");
}

#[test]
fn views_from_one_side_do_not_tell_the_radius() {
    let mut takes = ordinary_takes(2, 0.4);
    takes[1].camera_from_world = pose(1.31, 0.9);
    let error = fitted(&takes, &about()).unwrap_err();
    assert!(matches!(error, BallError::RadiusUnknown { .. }), "{error}");
}

#[test]
fn the_picture_in_which_the_ball_was_moved_is_left_out() {
    let mut takes = ordinary_takes(4, 0.4);
    takes[2].moved_m = DVec3::new(0.003, 0.002, 0.0);
    let fit = fitted(&takes, &about()).expect("three agree");
    println!("{fit:?}");
    let is_used = fit.views.iter().map(|view| matches!(view, ViewResult::Used(_)));
    assert_eq!(is_used.collect::<Vec<_>>(), [true, true, false, true]);
    let off = |fit: &BallFit| (fit.ball.center_m - BALL.center_m).length();
    assert!(off(&fit) < 1e-4, "{}", off(&fit));
    // By themselves the three could settle on reflections beside the edge.
    takes.remove(2);
    let fit = fitted(&takes, &about()).expect("three are enough");
    println!("{fit:?}");
    assert!(off(&fit) < 1e-4, "{}", off(&fit));
}

#[test]
fn a_card_before_a_fifth_of_the_ball_does_no_harm() {
    let mut takes = ordinary_takes(4, 0.4);
    takes[1].covered = 0.2;
    let fit = fitted(&takes, &about()).expect("the ball is there");
    println!("{fit:?}");
    let [median, p95] = direction_errors_deg(&fit, &takes);
    println!("median {median:.3}°, p95 {p95:.3}°");
    assert!(median <= 0.15 && p95 <= 0.35, "{median} {p95}");
}

#[test]
fn a_ball_that_is_elsewhere_is_not_found() {
    let elsewhere = BallPrior {
        center_m: BALL.center_m + DVec3::new(0.3, 0.3, 0.0),
        ..about()
    };
    let error = fitted(&ordinary_takes(2, 0.4), &elsewhere).unwrap_err();
    assert!(matches!(error, BallError::NotSeen { .. }), "{error}");
}

/// Three pictures of the ball, numbered, in a new folder.
fn save_pictures(pictures: &Path) {
    let rig = plain_rig();
    std::fs::create_dir(pictures).expect("a folder");
    for (index, turn) in [0.0f64, 1.6, 3.3].into_iter().enumerate() {
        let from = BALL.center_m + DVec3::new(0.26 * turn.cos(), 0.26 * turn.sin(), 0.26);
        let camera_from_world = looking_at(DVec3::new(0.01, -0.05, 0.02), from, 0.1);
        let frame = picture(
            &rig,
            &Take {
                camera_from_world,
                ..ordinary_takes(1, 0.3)[0]
            },
        );
        let file = pictures.join(format!("{index}.png"));
        image::save_buffer(file, &frame.pixels, 640, 480, image::ColorType::Rgb8).expect("a folder that takes it");
    }
}

#[test]
fn the_program_writes_the_ball_into_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    save_pictures(&folder.path().join("pictures"));
    let text = support::RIG.replace("color = [[1.1, -0.1, 0.0], [0.0, 1.0, 0.0], [0.05, 0.0, 0.95]]\n", "");
    let file = folder.path().join("rig.toml");
    std::fs::write(&file, &text).unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let inputs = [path("rig.toml"), path("pictures")];
    let run = |more: &[&str]| {
        let arguments = [
            &["ball", "--rig", &inputs[0], "--images", &inputs[1], "--camera", "scene"][..],
            more,
        ];
        std::process::Command::new(env!("CARGO_BIN_EXE_mirrorball-calib"))
            .args(arguments.concat())
            .output()
            .unwrap()
    };
    let center = [
        "--center",
        "0.022,-0.0965,0.0465",
        "--radius-m",
        "0.0386",
        "--radius-sigma-m",
        "0.0002",
    ];
    let outputs = [path("rig.toml"), path("ball.json"), path("ball.html")];
    let output = run(&[
        &center[..],
        &["--out", &outputs[0], "--json", &outputs[1], "--report", &outputs[2]],
    ]
    .concat());
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let rig = Rig::from_toml(&std::fs::read_to_string(&file).unwrap(), &file).unwrap();
    let ball = rig.ball.expect("written");
    assert!((ball.center_m - BALL.center_m).length() < 4e-4, "{}", ball.center_m);
    assert!((ball.radius_m - BALL.radius_m).abs() < 2e-4, "{}", ball.radius_m);
    let off = (DVec3::from_array(ball.reflectance) / REFLECTANCE - 1.0)
        .abs()
        .max_element();
    assert!(off < 0.04, "{:?}", ball.reflectance);
    assert_eq!(ball.roughness, 0.02);
    let numbers: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&outputs[1]).unwrap()).unwrap();
    assert!(
        numbers["direction_sigma_deg"]["median"].as_f64().unwrap() < 0.5,
        "{numbers}"
    );
    assert!(
        std::fs::read_to_string(&outputs[2])
            .unwrap()
            .contains("<h1>Mirror ball</h1>")
    );
    let before = std::fs::read(&file).unwrap();
    let output = run(&["--center", "1,1,0.05", "--out", &outputs[0]]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("hint: the whole ball must be in the picture"));
    assert_eq!(std::fs::read(&file).unwrap(), before, "a failure writes no rig");
}
