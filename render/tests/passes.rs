//! Passes from picture to picture against their CPU twins or against light whose answer is known; those that make maps of
//! light are in `light_maps.rs` and `comparison_maps.rs`.

mod support;

use glam::{DVec2, DVec3, Vec3, Vec4, Vec4Swizzles};
use mirrorball_calib::camera::LensModel;
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::mirror_ball::MirrorBall;
use mirrorball_calib::probe::radiance::Picture;
use mirrorball_calib::probe::radiance_map::{Seen, Surroundings};
use mirrorball_calib::probe::{ProbeOptics, View};
use mirrorball_calib::rig::Camera;
use mirrorball_render::config::{MappingName, ProbeConfig};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::passes::composite::Composite;
use mirrorball_render::passes::radiance_map::{CubePlace, RadianceMap, gpu_probe};
use mirrorball_render::probe::surroundings::NOTHING_M;
use mirrorball_render::reference;
use mirrorball_render::reference::receive::Blockers;
use mirrorball_render::scene::{Kind, Scene};
use mirrorball_render::scene_gpu::PictureBuffers;
use mirrorball_render::shadow::dome::DomeLight;
use support::stage::{Stage, environment_stage, light};
use support::{EXPOSURE, Errors, cube_of, halves, spread};

// ---- radiance_map ----------------------------------------------------------------------------------------------------

/// Distance of everything in the probe's tests, metres.
const ROOM_M: f32 = 2.0;
/// Towards the one lamp, which clips.
const LAMP: DVec3 = DVec3::new(0.48, -0.36, 0.8);

/// The mirror ball.
const BALL: MirrorBall = MirrorBall {
    center_m: DVec3::new(0.1, 0.2, 0.05),
    radius_m: 0.05,
};

/// A smooth room with a lamp.
fn room(direction: DVec3) -> DVec3 {
    if direction.angle_between(LAMP) < 0.15 {
        return DVec3::splat(50.0);
    }
    let wave = (3.0 * direction.x).sin() + (4.0 * direction.y + direction.z).cos();
    DVec3::new(2.0, 1.6, 1.2) + 0.5 * wave
}

/// A probe with its camera and a picture of the room.
#[derive(Clone)]
struct ProbeCase {
    camera: Camera,
    camera_from_world: Pose,
    optics: ProbeOptics,
    /// Where the light is measured.
    origin_m: Vec3,
    config: ProbeConfig,
    frame: mirrorball_capture::frame::Frame,
}

fn ball_case() -> ProbeCase {
    ball_case_around(BALL.center_m)
}

/// A ball in a room whose middle is `origin_m`.
fn ball_case_around(origin_m: DVec3) -> ProbeCase {
    let mut camera = support::rig().scene_camera().clone();
    camera.intrinsics.focal_px = DVec2::new(900.0, 902.0);
    let ball = BALL;
    let reflectance = Vec3::new(0.7, 0.69, 0.8);
    let camera_m = ball.center_m + DVec3::new(0.05, -0.35, 0.25);
    let camera_from_world = support::looking_at(ball.center_m, camera_m);
    let world_from_camera = camera_from_world.inverse();
    let frame = support::frame(&camera, 1, 2, |ray| {
        let Some((out, point)) = ball.reflect(camera_m, world_from_camera.transform_vector(ray)) else {
            return DVec3::ONE;
        };
        let from_origin = point - origin_m;
        let b = from_origin.dot(out);
        let room_m = f64::from(ROOM_M);
        let way = -b + (b * b + room_m * room_m - from_origin.length_squared()).sqrt();
        room((from_origin + out * way).normalize()) * reflectance.as_dvec3()
    });
    ProbeCase {
        camera,
        camera_from_world,
        optics: ProbeOptics::MirrorBall { ball, reflectance },
        origin_m: origin_m.as_vec3(),
        config: probe_config(),
        frame,
    }
}

fn fisheye_case() -> ProbeCase {
    fisheye_case_of(|_| ())
}

/// The same through other lenses.
fn other_lenses() -> Vec<(&'static str, ProbeCase)> {
    let max_angle_rad = 92.5f64.to_radians();
    [
        ("an equisolid fisheye", LensModel::Equisolid { max_angle_rad }),
        (
            "an EUCM fisheye",
            LensModel::Eucm {
                alpha: 0.62,
                beta: 1.1,
                max_angle_rad,
            },
        ),
        (
            "a double sphere fisheye",
            LensModel::DoubleSphere {
                xi: -0.2,
                alpha: 0.6,
                max_angle_rad: 3.0,
            },
        ),
        (
            "a rational lens",
            LensModel::Rational {
                coefficients: [0.8, 0.06, 1e-3, -7e-4, 0.004, 1.05, 0.09, 0.006],
            },
        ),
    ]
    .map(|(name, lens)| (name, fisheye_case_of(|camera| camera.intrinsics.lens = lens)))
    .into()
}

fn fisheye_case_of(change: impl Fn(&mut Camera)) -> ProbeCase {
    let mut camera = support::rig()
        .probe_camera()
        .expect("the rig has a probe camera")
        .clone();
    change(&mut camera);
    let camera_from_world = camera.camera_from_world.expect("the probe stands still");
    let world_from_camera = camera_from_world.inverse();
    let frame = support::frame(&camera, 1, 2, |ray| room(world_from_camera.transform_vector(ray)));
    let optics = ProbeOptics::Fisheye {
        lens_m: world_from_camera.translation,
    };
    ProbeCase {
        camera,
        camera_from_world,
        origin_m: optics.position_m(),
        optics,
        config: probe_config(),
        frame,
    }
}

fn probe_config() -> ProbeConfig {
    ProbeConfig {
        cube_size: 32,
        ..ProbeConfig::default()
    }
}

/// The pass and its twin on one picture.
fn both_cubes(gpu: &Gpu, case: &ProbeCase, near_m: &Cube<f32>) -> [Cube<Vec4>; 2] {
    let config = &case.config;
    let camera = GpuCamera::new(&case.camera, &case.camera_from_world, &EXPOSURE, [0.02, 20.0]);
    let place = CubePlace {
        origin_m: case.origin_m,
        room_m: ROOM_M,
    };
    let probe = gpu_probe(&case.optics, camera.position_m.truncate(), config, place);
    let mut picture = PictureBuffers::new(gpu, &case.camera);
    picture.upload(gpu, &case.frame);
    let mut pass = RadianceMap::new(gpu, near_m);
    let measured = pass
        .run(gpu, &mut Timer::new(gpu), (&camera, &probe, &picture))
        .expect("the device works");
    let view = View {
        picture: Picture::new(&case.frame, &case.camera),
        camera: &case.camera,
        camera_from_world: case.camera_from_world,
    };
    let around = Surroundings {
        origin_m: case.origin_m,
        near_m,
        room_m: ROOM_M,
    };
    let twin = reference::radiance_map::cube(&view, &case.optics, config.mapping(), &config.trust(), &around);
    [Cube::from_texels(near_m.size(), measured).expect("six faces"), twin]
}

fn assert_radiance_map(gpu: &Gpu, name: &str, case: &ProbeCase) {
    // Near things in half of the directions.
    let near_m = cube_of(32, |d| {
        if (5.0 * d.x).sin() > 0.0 {
            0.3 + 0.1 * d.y
        } else {
            NOTHING_M
        }
    });
    let [measured, twin] = both_cubes(gpu, case, &near_m);
    let seen = |cube: &Cube<Vec4>| -> Vec<Option<Seen>> { cube.texels().iter().map(|t| Seen::unpack(*t)).collect() };
    let pairs: Vec<_> = seen(&measured).into_iter().zip(seen(&twin)).collect();
    // Single precision moves a place by about 1e-4 of a pixel, so a texel in a thousand changes sides at an outline.
    let bits = |seen: &Option<Seen>| seen.map(|seen| (seen.clipped, seen.clipped_everywhere));
    let differ = pairs.iter().filter(|(a, b)| bits(a) != bits(b)).count();
    assert!(
        differ * 500 <= pairs.len(),
        "{name}: {differ} of {} texels differ in what is seen or clipped",
        pairs.len()
    );
    let both: Vec<(Seen, Seen)> = pairs
        .iter()
        .filter(|(a, b)| bits(a) == bits(b))
        .filter_map(|&(a, b)| a.zip(b))
        .collect();
    let errors = Errors::of(
        name,
        both.iter()
            .map(|(a, b)| ((a.radiance - b.radiance) / b.radiance).abs().max_element()),
    );
    // 1e-4 of a pixel across the lamp's edge (2 to clipping 5) is 3e-4 of the radiance.
    assert!(errors.mean < 2e-5 && errors.worst < 2e-3, "{name}: {errors:?}");
    // A texel is a pixel wide or so: 1e-4 of a pixel is 4e-4 of its area; quality comes in steps of 1/255.
    let errors = Errors::of(
        &format!("{name}: quality"),
        both.iter().map(|(a, b)| a.quality - b.quality),
    );
    assert!(errors.mean < 5e-4 && errors.worst < 3.0 / 255.0, "{name}: {errors:?}");
}

/// How far off the room the pass measures it, relative, where nothing clips.
fn against_the_room(gpu: &Gpu, name: &str, case: &ProbeCase) -> (Errors, f32) {
    let near_m = cube_of(32, |_| NOTHING_M);
    let [measured, _] = both_cubes(gpu, case, &near_m);
    let n_seen = measured.texels().iter().filter(|t| t.w > 0.0).count();
    let errors = measured
        .texels()
        .iter()
        .enumerate()
        .filter_map(|(index, texel)| Seen::unpack(*texel).map(|seen| (index, seen)))
        .filter_map(|(index, seen)| {
            // A texel's and a pixel's width from the lamp's edge the picture shows both sides of it.
            let direction = measured.direction(index).as_dvec3();
            let is_clear = direction.angle_between(LAMP) > 0.15 + 0.12 && seen.clipped == 0;
            // A share of what is little trusted is the background of the ball.
            let is_clear = is_clear && seen.quality > 0.25;
            is_clear.then(|| (seen.radiance / room(direction).as_vec3() - 1.0).abs().max_element())
        });
    (Errors::of(name, errors), n_seen as f32 / measured.texels().len() as f32)
}

#[test]
fn radiance_map_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    assert_radiance_map(&gpu, "radiance_map of a ball", &ball_case());
    assert_radiance_map(&gpu, "radiance_map of a fisheye", &fisheye_case());
    for (name, case) in other_lenses() {
        assert_radiance_map(&gpu, &format!("radiance_map of {name}"), &case);
    }
}

#[test]
fn the_simple_mapping_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    for (name, case) in [("ball", ball_case()), ("fisheye", fisheye_case())] {
        for wrap in [1.0, 0.87, 0.04] {
            let mut case = case.clone();
            case.config.mapping = MappingName::Simple;
            case.config.wrap = wrap;
            assert_radiance_map(&gpu, &format!("simple map of a {name}, wrap {wrap}"), &case);
        }
    }
}

#[test]
fn a_probe_beside_the_place_measures_its_light() {
    let Some(gpu) = support::gpu() else { return };
    // The room as the place sees it, shown by a ball 40 cm away.
    let origin_m = DVec3::new(-0.2, 0.0, 0.1);
    let case = ball_case_around(origin_m);
    assert_radiance_map(&gpu, "radiance_map of a ball beside", &case);
    let (errors, seen) = against_the_room(&gpu, "room in a ball beside", &case);
    assert!(errors.mean < 0.008 && errors.worst < 0.08, "{errors:?}");
    assert!((0.9..1.0).contains(&seen), "a ball shows {seen} of the sphere");
    // Taken for the ball's own surroundings the same picture is wrong by the room's parallax.
    let there = ProbeCase {
        origin_m: case.optics.position_m(),
        ..case
    };
    let (errors, _) = against_the_room(&gpu, "the same without its place", &there);
    assert!(errors.mean > 0.05, "{errors:?}");
}

#[test]
fn the_probes_measure_a_known_room() {
    let Some(gpu) = support::gpu() else { return };
    // Half a code of 8 bits is 0.6 % at the room's brightness; a texel of 0.05 rad over which the room's slope changes
    // by 5 per radian adds 0.05² * 5 / 12 / 1.5, below 0.1 %.
    let (errors, seen) = against_the_room(&gpu, "room in a fisheye", &fisheye_case());
    assert!(errors.mean < 0.005 && errors.worst < 0.03, "{errors:?}");
    assert!(
        (0.48..0.56).contains(&seen),
        "a lens of 92.5° sees {seen} of the sphere"
    );
    // Towards its rim the ball packs many directions into a pixel.
    let (errors, seen) = against_the_room(&gpu, "room in a ball", &ball_case());
    assert!(errors.mean < 0.008 && errors.worst < 0.08, "{errors:?}");
    assert!((0.9..1.0).contains(&seen), "a ball shows {seen} of the sphere");
}

#[test]
fn clipped_light_is_marked() {
    let Some(gpu) = support::gpu() else { return };
    for (name, case) in [("ball", ball_case()), ("fisheye", fisheye_case())] {
        let [measured, _] = both_cubes(&gpu, &case, &cube_of(32, |_| NOTHING_M));
        let lamp = Seen::unpack(measured.nearest(LAMP.as_vec3())).expect("the lamp is seen");
        assert_eq!(
            (lamp.clipped, lamp.clipped_everywhere),
            (7, 7),
            "{name}: all channels clip, anywhere and everywhere"
        );
    }
}

// ---- receive ---------------------------------------------------------------------------------------------------------

const GROUND_RADIUS_M: f32 = 0.25;

/// A sphere over ground beside a wall that is real.
fn shadow_scene() -> Scene {
    let ground = support::square(Vec3::ZERO, Vec3::X * GROUND_RADIUS_M, Vec3::Y * GROUND_RADIUS_M);
    let wall = support::square(Vec3::new(-0.1, 0.0, 0.06), Vec3::Y * 0.1, Vec3::Z * 0.06);
    let sphere = support::sphere(Vec3::new(0.02, 0.01, 0.06), 0.03, 16, support::diffuse(0.8));
    support::scene([
        ("ground", Kind::Phantom, ground),
        ("wall", Kind::Phantom, wall),
        ("sphere", Kind::Virtual, sphere),
    ])
}

/// Lights over the upper half, one of them behind the wall as seen from the sphere.
fn lights() -> Vec<KeyLight> {
    support::directions(24)
        .filter(|d| d.z > 0.15)
        .enumerate()
        .map(|(i, d)| light(d * 2.0, 0.5 + spread(i, 0.0) as f32))
        .collect()
}

#[test]
fn ratios_on_phantoms_equal_cast_shadows() {
    let Some(gpu) = support::gpu() else { return };
    let (scene, rig, lights) = (shadow_scene(), support::rig(), lights());
    let mut stage = Stage::new(gpu, &rig, &scene, [512, lights.len() as u32]);
    let pose = support::looking_at(DVec3::new(0.0, 0.02, 0.0), DVec3::new(0.05, -0.35, 0.35));
    let ratios = stage.ratios(&rig, &pose, &lights);
    let (phantoms, virtuals) = (
        support::occluders(&scene, Kind::Phantom),
        support::occluders(&scene, Kind::Virtual),
    );
    let blockers = Blockers {
        phantoms: &phantoms,
        virtuals: &virtuals,
    };
    let dome: Vec<DomeLight> = lights
        .iter()
        .map(|l| DomeLight {
            position_m: l.direction * l.distance_m,
            intensity: l.irradiance * l.distance_m * l.distance_m,
            angular_radius_rad: 0.0,
        })
        .collect();
    let camera = &rig.scene_camera().intrinsics;
    let world_from_camera = pose.inverse();
    let eye = world_from_camera.translation.as_vec3();
    let mut errors = Vec::new();
    let mut darkest = 1.0f32;
    for (index, found) in ratios.iter().enumerate().step_by(7) {
        let pixel = DVec2::new((index % 320) as f64, (index / 320) as f64);
        let ray = world_from_camera
            .transform_vector(camera.unproject(pixel).unwrap())
            .as_vec3();
        let Some(distance) = phantoms.distance_m(eye, ray, 0.0) else {
            continue;
        };
        let point = eye + ray * distance;
        // On the ground, away from its edge and from the wall's foot.
        let is_inside = point.truncate().abs().max_element() < GROUND_RADIUS_M - 0.01;
        if point.z.abs() > 1e-4 || !is_inside || (point.x + 0.1).abs() < 0.005 {
            continue;
        }
        assert_eq!(found.w, 1.0, "the ground at {point} is not covered");
        let expected = reference::receive::ratio(point, Vec3::Z, &dome, blockers, Vec3::ZERO);
        darkest = darkest.min(expected.x);
        errors.push((found.xyz() - expected).abs().max_element());
    }
    assert!(darkest < 0.8, "nothing is shaded: {darkest}");
    let off = errors.iter().filter(|e| **e > 0.01).count();
    let n = errors.len();
    let errors = Errors::of("ratios", errors);
    // A map texel is 1 mm on the ground (phantoms) and 0.25 mm (virtual objects), and rays are put together over 4 pixels:
    // outlines of eleven shadows, softened by about that, cover some per cent of the ground, each with one light's share
    // of at most 0.2.
    assert!(
        errors.mean < 0.004 && off * 10 < n,
        "{errors:?}, {off} of {n} off by over 0.01"
    );
    assert!(errors.worst < 0.3, "{errors:?}");
}

// ---- composite -------------------------------------------------------------------------------------------------------

/// The finished picture as RGBA codes.
fn composed(stage: &Stage, picture: &PictureBuffers) -> Vec<u8> {
    let pass = Composite::new(
        &stage.gpu,
        &stage.camera,
        picture,
        (&stage.shade, &stage.receive),
        [320, 240],
    );
    let mut encoder = stage
        .gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut Timer::new(&stage.gpu));
    pass.codes().record(&mut encoder);
    stage.gpu.queue.submit([encoder.finish()]);
    pass.codes().read(&stage.gpu).expect("the device works")
}

#[test]
fn composite_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let stage = environment_stage(gpu);
    let camera = rig.scene_camera();
    let n = 320 * 240;
    let codes: Vec<u8> = (0..3 * n).map(|i| (spread(i, 0.4) * 256.0) as u8).collect();
    let frame = support::frame_of(camera, 1, codes.clone());
    let mut picture = PictureBuffers::new(&stage.gpu, camera);
    picture.upload(&stage.gpu, &frame);
    // A third of the pixels as they are, a third dimmed, a third behind an object, some of those half covered.
    let value = |i: usize, offset: f64| spread(i, offset) as f32;
    let ratios = halves((0..n).map(|i| match i % 3 {
        0 => {
            if i % 2 == 0 {
                Vec4::ZERO
            } else {
                Vec4::ONE
            }
        }
        _ => Vec4::new(value(i, 0.1), value(i, 0.2), value(i, 0.5), 1.0),
    }));
    let over = halves((0..n).map(|i| match i % 3 {
        2 => {
            let coverage = [0.25, 0.5, 1.0][i % 9 / 3];
            (Vec3::new(value(i, 0.7), value(i, 0.8), value(i, 0.9)) * 5.0 * coverage).extend(coverage)
        }
        _ => Vec4::ZERO,
    }));
    // Lamps shine on some of those that change.
    let lit = halves((0..n).map(|i| {
        if i % 12 == 1 {
            Vec4::splat(value(i, 0.6))
        } else {
            Vec4::ZERO
        }
    }));
    support::write_texture(&stage.gpu, stage.receive.ratio().texture(), &ratios);
    support::write_texture(&stage.gpu, stage.receive.added().texture(), &lit);
    support::write_texture(&stage.gpu, stage.shade.radiance().texture(), &over);
    let gpu_camera = GpuCamera::new(camera, &Pose::identity(), &EXPOSURE, [0.02, 20.0]);
    stage.gpu.write(&stage.camera, &[gpu_camera]);
    let rgba = composed(&stage, &picture);
    let mut errors = Vec::new();
    for i in 0..n {
        let code = [codes[3 * i], codes[3 * i + 1], codes[3 * i + 2]];
        let found = [rgba[4 * i], rgba[4 * i + 1], rgba[4 * i + 2]];
        let vector = |t: [half::f16; 4]| Vec4::from_array(t.map(half::f16::to_f32));
        let (ratio, over, added) = (vector(ratios[i]), vector(over[i]), vector(lit[i]).xyz());
        let ratio = if ratio.w > 0.0 { ratio.xyz() } else { Vec3::ONE };
        let place = DVec2::new((i % 320) as f64, (i / 320) as f64);
        let of = reference::composite::PixelOf {
            camera,
            exposure: &EXPOSURE,
            pixel: place,
        };
        let expected = reference::composite::pixel(&of, code, [ratio, added], over);
        if i % 3 == 0 {
            assert_eq!(found, code, "pixel {i} has nothing to change it");
        } else {
            errors.extend((0..3).map(|c| f32::from(found[c]) - f32::from(expected[c])));
        }
    }
    let errors = Errors::of("composite, codes", errors);
    // The table rounds half way between two codes' light, the formula half way between the codes: they part for less
    // than 1 % of all values, by one code.
    assert!(errors.worst <= 1.0 && errors.mean < 0.01, "{errors:?}");
}
