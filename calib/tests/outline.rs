//! The ball's outline in synthetic pictures whose ball stands exactly where it is known to stand.

use glam::{DMat3, DVec2, DVec3};
use mirrorball_calib::{
    camera::{Intrinsics, LensModel},
    photometry::Photometry,
    pose::Pose,
    probe::{
        View,
        mirror_ball::MirrorBall,
        outline::{OutlineError, OutlineFinder, OutlineFit, OutlineSettings},
        radiance::Picture,
    },
    response::ResponseCurve,
    rig::{Camera, Role},
};
use mirrorball_capture::frame::{Exposure, Frame, FrameMeta, PixelFormat, Size};

const EXPOSURE: Exposure = Exposure {
    time_s: 0.01,
    gain: 1.0,
    white_balance: [1.0; 3],
};

const REFLECTANCE: DVec3 = DVec3::new(0.7, 0.69, 0.66);

fn camera() -> Camera {
    Camera {
        name: "scene".to_owned(),
        role: Role::Scene,
        intrinsics: Intrinsics {
            size_px: [320, 240],
            focal_px: DVec2::new(600.0, 599.0),
            principal_point_px: DVec2::new(161.2, 118.6),
            lens: LensModel::BrownConrady {
                k1: -0.12,
                k2: 0.05,
                p1: 0.001,
                p2: -0.0007,
                k3: 0.0,
            },
        },
        photometry: Photometry {
            sensitivity: 40.0,
            vignetting: [-0.1, 0.0],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response: ResponseCurve::srgb(),
            color: DMat3::IDENTITY,
        },
        camera_from_world: None,
    }
}

/// What stands in the picture besides the ball.
#[derive(Debug, Clone, Copy, Default)]
struct Scene {
    /// A card before the ball covers this share of its width, from the left.
    covered: f64,
    /// The ball stands on a black stand.
    has_stand: bool,
    /// Brightness of everything.
    brightness: f64,
}

/// Radiance of the room: a grainy table below, walls with a window, clutter on the table.
fn room(from: DVec3, ray: DVec3) -> DVec3 {
    // The camera looks down a little; `up` is the table's normal.
    let up = DVec3::new(0.0, -0.8, -0.6);
    let height = from.dot(up) + 0.4;
    let down = -ray.dot(up);
    if down > 1e-3 {
        let point = from + ray * (height / down);
        let (x, y) = (point.x, point.dot(DVec3::new(0.0, -0.6, 0.8)));
        let grain = 0.06 * (40.0 * y + 3.0 * (11.0 * x).sin()).sin() + 0.03 * (170.0 * y + 25.0 * x).sin();
        let is_sheet = (x + 0.1).abs() < 0.1 && (y - 0.25).abs() < 0.07;
        let is_card = (x - 0.15).abs() < 0.03 && (y - 0.6).abs() < 0.05;
        return match (is_sheet, is_card) {
            (true, _) => DVec3::splat(1.1),
            (_, true) => DVec3::new(0.6, 0.1, 0.1),
            _ => DVec3::new(0.55, 0.38, 0.25) * (1.0 + grain),
        };
    }
    let is_window = ray.angle_between(DVec3::new(-0.7, -0.7, 0.2)) < 0.25;
    if is_window {
        DVec3::new(7.0, 7.5, 8.0)
    } else {
        DVec3::new(0.7, 0.72, 0.75) * (1.0 + 0.3 * ray.x)
    }
}

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

/// The picture of a ball that a camera at the origin of the world takes, with shot and read noise.
fn picture(camera: &Camera, ball: &MirrorBall, scene: Scene, seed: u64) -> Frame {
    let [width, height] = camera.intrinsics.size_px;
    let card_to = ball.center_m.x - ball.radius_m + 2.0 * ball.radius_m * scene.covered;
    let radiance = |ray: DVec3| {
        let at_ball = ray * (ball.center_m.z / ray.z);
        if scene.covered > 0.0 && at_ball.x < card_to && (at_ball - ball.center_m).length() < 2.0 * ball.radius_m {
            return DVec3::new(0.2, 0.5, 0.3);
        }
        if let Some((out, point)) = ball.reflect(DVec3::ZERO, ray) {
            return room(point, out) * REFLECTANCE;
        }
        let below = at_ball - ball.center_m;
        if scene.has_stand && below.x.abs() < 0.4 * ball.radius_m && (0.0..1.3 * ball.radius_m).contains(&below.y) {
            return DVec3::splat(0.02);
        }
        room(DVec3::ZERO, ray)
    };
    let center_px = camera.intrinsics.project(ball.center_m).expect("before the camera");
    let radius_px = camera.intrinsics.focal_px.x * ball.radius_m / ball.center_m.z;
    let mut noise = Noise(seed);
    let mut pixels = Vec::with_capacity(3 * (width * height) as usize);
    for index in 0..width * height {
        let middle = DVec2::new(f64::from(index % width), f64::from(index / width));
        // Many rays where they count.
        let parts = if (middle.distance(center_px) - radius_px).abs() < 5.0 {
            8
        } else {
            1
        };
        let mut light = DVec3::ZERO;
        for i in 0..parts * parts {
            let offset = (DVec2::new(f64::from(i % parts), f64::from(i / parts)) + 0.5) / f64::from(parts) - 0.5;
            let ray = camera.intrinsics.unproject(middle + offset).expect("inside the lens");
            light += radiance(ray) / f64::from(parts * parts);
        }
        let photometry = &camera.photometry;
        let signal = DVec3::from_array(photometry.signal_per_radiance(&EXPOSURE))
            * photometry.vignetting_at(middle, camera.intrinsics.size_px)
            * light
            * scene.brightness;
        let sensed = signal.to_array().map(|y| {
            let electrons = y * photometry.full_well_e;
            let sigma = (electrons + photometry.read_noise_e.powi(2)).sqrt();
            photometry
                .response
                .encode((electrons + sigma * noise.normal()) / photometry.full_well_e)
        });
        pixels.extend(sensed);
    }
    Frame {
        meta: FrameMeta::new("scene".into(), 0, 0, EXPOSURE),
        size: Size { width, height },
        format: PixelFormat::Rgb8,
        pixels: pixels.into(),
    }
}

/// Searches the picture of `ball` for one that is believed to stand `offset_m` beside it.
fn find(ball: &MirrorBall, offset_m: DVec3, scene: Scene, seed: u64) -> Result<OutlineFit, OutlineError> {
    let camera = camera();
    let frame = picture(&camera, ball, scene, seed);
    let view = View {
        picture: Picture::new(&frame, &camera),
        camera: &camera,
        camera_from_world: Pose::identity(),
    };
    let believed = MirrorBall {
        center_m: ball.center_m + offset_m,
        ..*ball
    };
    OutlineFinder::new(OutlineSettings::default()).find(&view, &believed, REFLECTANCE.as_vec3())
}

/// A ball of 39 pixels' radius, moved a little with every seed so that its outline falls differently on the pixels.
fn ball(seed: u64) -> MirrorBall {
    let mut noise = Noise(1000 + seed);
    let mut around = |middle: f64, by: f64| middle + by * (2.0 * noise.uniform() - 1.0);
    MirrorBall {
        center_m: DVec3::new(around(0.03, 0.04), around(0.01, 0.02), around(0.6, 0.03)),
        radius_m: 0.039,
    }
}

const BRIGHT: Scene = Scene {
    covered: 0.0,
    has_stand: true,
    brightness: 1.0,
};

/// Distance in the picture between the ball found and the ball, pixels.
fn error_px(ball: &MirrorBall, fit: &OutlineFit) -> f64 {
    let project = |point| camera().intrinsics.project(point).expect("in front of the camera");
    project(fit.center_m).distance(project(ball.center_m))
}

/// Fits of twelve balls, each believed a little beside itself; the error's median and worst in pixels.
#[expect(clippy::print_stdout, reason = "a figure, kept by the test runner unless asked for")]
fn errors_px(name: &str, scene: Scene, offset_m: f64) -> [f64; 2] {
    let mut errors: Vec<f64> = (0..12)
        .map(|seed| {
            let ball = ball(seed);
            let turn = 2.4 * seed as f64;
            let offset_m = offset_m * DVec3::new(turn.cos(), turn.sin(), 0.0);
            let fit = find(&ball, offset_m, scene, seed).expect("the ball is there");
            let error = error_px(&ball, &fit);
            assert!(error < 4.0 * fit.sigma_px, "{name}: {error} px off, {fit:?}");
            let distance = fit.center_m.length() / (ball.center_m + offset_m).length();
            assert!((distance - 1.0).abs() < 1e-12, "the distance stays as it was");
            error
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    let figures = [errors[errors.len() / 2], errors[errors.len() - 1]];
    println!("{name}: median {:.3} px, worst {:.3} px", figures[0], figures[1]);
    figures
}

#[test]
fn a_ball_that_stands_where_it_should_is_left_there() {
    let [median, worst] = errors_px("exact", BRIGHT, 0.0);
    assert!(median < 0.1 && worst < 0.3, "{median} {worst}");
    for seed in 0..12 {
        let fit = find(&ball(seed), DVec3::ZERO, BRIGHT, seed).expect("the ball is there");
        assert!(!fit.is_significant(), "{fit:?}");
    }
}

#[test]
fn a_ball_two_millimetres_beside_its_place_is_found() {
    let [median, worst] = errors_px("2 mm beside", BRIGHT, 0.002);
    assert!(median < 0.1 && worst < 0.3, "{median} {worst}");
    let fit = find(&ball(0), DVec3::new(0.002, 0.0, 0.0), BRIGHT, 0).expect("the ball is there");
    assert!(fit.is_significant());
    assert!((fit.shift_m.length() - 0.002).abs() < 2e-4, "{fit:?}");
}

#[test]
fn a_dark_picture_and_a_card_before_the_ball_are_borne() {
    let dark = Scene {
        brightness: 0.1,
        ..BRIGHT
    };
    let [median, worst] = errors_px("a tenth of the light", dark, 0.001);
    assert!(median < 0.15 && worst < 0.4, "{median} {worst}");
    let card = Scene { covered: 0.2, ..BRIGHT };
    let [median, worst] = errors_px("a fifth covered", card, 0.001);
    assert!(median < 0.15 && worst < 0.4, "{median} {worst}");
}

#[test]
fn what_cannot_be_told_is_refused() {
    let covered = Scene {
        covered: 0.95,
        ..BRIGHT
    };
    let error = find(&ball(3), DVec3::ZERO, covered, 3).unwrap_err();
    assert!(
        matches!(error, OutlineError::Covered { .. } | OutlineError::LowContrast { .. }),
        "{error}"
    );
    // No ball, but a believed one elsewhere on the table.
    let error = find(&ball(3), DVec3::new(-0.1, 0.0, 0.0), BRIGHT, 3).unwrap_err();
    assert!(
        matches!(error, OutlineError::Covered { .. } | OutlineError::LowContrast { .. }),
        "{error}"
    );
    let error = find(&ball(3), DVec3::new(0.3, 0.0, 0.0), BRIGHT, 3).unwrap_err();
    assert_eq!(error, OutlineError::OutOfPicture { share: 0.0 });
    assert!(error.to_string().contains("`0 %` of the ball's outline"), "{error}");
    let black = Scene {
        brightness: 0.0,
        ..BRIGHT
    };
    let error = find(&ball(3), DVec3::ZERO, black, 3).unwrap_err();
    assert!(matches!(error, OutlineError::LowContrast { .. }), "{error}");
    let error = find(&ball(3), DVec3::new(0.0, 0.0, 5.0), BRIGHT, 3).unwrap_err();
    assert!(matches!(error, OutlineError::TooSmall { .. }), "{error}");
}

#[test]
fn a_ball_behind_the_camera_is_out_of_the_picture() {
    let error = find(&ball(3), DVec3::new(0.0, 0.0, -2.0), BRIGHT, 3).unwrap_err();
    assert_eq!(error, OutlineError::OutOfPicture { share: 0.0 });
}
