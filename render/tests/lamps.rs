//! Virtual lamps against formulas, rays on the CPU and the path tracer.

mod support;

use std::f32::consts::PI;

use glam::{Affine3A, DVec2, DVec3, Vec3, Vec4, Vec4Swizzles};
use half::f16;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use mirrorball_render::camera_view::CameraView;
use mirrorball_render::config::LightConfig;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::passes::direct::ShadowedLight;
use mirrorball_render::passes::lamp_light::{GpuLamps, LampLight};
use mirrorball_render::passes::lamp_receive::LampReceive;
use mirrorball_render::passes::lens_surface::LensSurface;
use mirrorball_render::reference;
use mirrorball_render::scene::{Carrier, GONE, Kind, Lamp, LampKind, Material, Mesh, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;
use mirrorball_render::scene_rays::SceneRays;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::scene::TracedScene;
use mirrorball_render::shadow::path::{PathJob, PathSettings, PathTracer, PixelRays, Surfaces};
use support::Errors;

const FROM: DVec3 = DVec3::new(0.05, -0.30, 0.34);
const AT: DVec3 = DVec3::new(0.03, 0.0, 0.0);

fn pose() -> Pose {
    support::looking_at(AT, FROM)
}

/// A white lamp at a place that shines down, of radiant intensity 0.5.
fn lamp(kind: LampKind, position_m: Vec3) -> Lamp {
    Lamp {
        name: "lamp".into(),
        kind,
        irradiance: Vec3::new(0.5, 0.4, 0.3),
        carrier: Carrier::World,
        position_m,
        direction: Vec3::NEG_Z,
        across: Vec3::X,
    }
}

/// What lamps give the phantoms in the picture.
struct Lit {
    /// Place, w: 1 where there is one.
    places: Vec<Vec4>,
    normals: Vec<Vec3>,
    irradiance: Vec<Vec3>,
    lamps: GpuLamps,
}

fn lit(gpu: &Gpu, rig: &Rig, scene: &Scene) -> Lit {
    let buffers = SceneBuffers::new(gpu, scene, rig).expect("a small scene");
    let placements = vec![Affine3A::IDENTITY; scene.objects.len()];
    let rays = SceneRays::new(gpu, &buffers, &placements).expect("a small scene");
    let model = rig.scene_camera();
    let camera = gpu.buffer(
        "test: camera",
        &[GpuCamera::new(model, &pose(), &support::EXPOSURE, [0.02, 20.0])],
    );
    let surface = LensSurface::new(gpu, "phantoms", (&camera, &buffers), model.intrinsics.size_px);
    let light = ShadowedLight::new(gpu, surface.views());
    let pass = LampLight::new(gpu, (&buffers, &rays), (surface.views(), &light));
    let lamps = GpuLamps::new(&scene.lamps, |lamp| lamp.world_from_carrier(rig, &placements));
    gpu.write(&buffers.lamps, &[lamps]);
    let mut timer = Timer::new(gpu);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    surface.record(&mut encoder, &mut timer, (&buffers, &buffers.phantoms));
    pass.record(&mut encoder, &mut timer);
    gpu.queue.submit([encoder.finish()]);
    let halves = |view: &wgpu::TextureView| vectors(gpu, view);
    Lit {
        places: support::read_layer::<[f32; 4]>(gpu, surface.views().place.texture(), 0, 0)
            .into_iter()
            .map(Vec4::from_array)
            .collect(),
        normals: halves(surface.views().normal).iter().map(|n| n.xyz()).collect(),
        irradiance: halves(&light.lamps).iter().map(|e| e.xyz()).collect(),
        lamps,
    }
}

fn vectors(gpu: &Gpu, view: &wgpu::TextureView) -> Vec<Vec4> {
    support::read_layer::<[f16; 4]>(gpu, view.texture(), 0, 0)
        .into_iter()
        .map(|t| Vec4::from_array(t.map(f16::to_f32)))
        .collect()
}

fn over_ground(lamps: Vec<Lamp>, others: Vec<(&'static str, Kind, Mesh)>) -> Scene {
    let ground = ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y));
    Scene {
        lamps,
        ..support::scene(others.into_iter().chain([ground]))
    }
}

#[test]
fn a_point_lamp_falls_with_the_square_of_the_distance_and_the_cosine() {
    let Some(gpu) = support::gpu() else { return };
    let position_m = Vec3::new(0.1, 0.05, 0.3);
    let lamps = vec![lamp(LampKind::Point { radius_m: 0.0 }, position_m)];
    let lit = lit(&gpu, &support::rig(), &over_ground(lamps, vec![]));
    let errors = lit
        .places
        .iter()
        .zip(&lit.irradiance)
        .filter(|(place, _)| place.w > 0.0);
    let errors = Errors::of(
        "point lamp",
        errors.map(|(place, found)| {
            let to_lamp = position_m - place.xyz();
            let expected = 0.5 * to_lamp.normalize().z / to_lamp.length_squared();
            found.x / expected - 1.0
        }),
    );
    // Half floats.
    assert!(errors.n > 60_000 && errors.worst < 2e-3, "{errors:?}");
}

/// Place on the ground that a pixel shows.
fn on_ground(rig: &Rig, pixel: DVec2) -> Vec3 {
    let ray = rig
        .scene_camera()
        .intrinsics
        .unproject(pixel)
        .expect("a ray of the picture");
    let ray = pose().inverse().transform_vector(ray);
    (FROM - ray * (FROM.z / ray.z)).as_vec3()
}

#[test]
fn the_edge_of_a_hard_shadow_is_where_the_geometry_puts_it() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let (lamp_m, middle, half) = (Vec3::new(0.02, -0.03, 0.5), Vec3::new(0.04, 0.03, 0.1), 0.04);
    let blocker = support::square(middle, Vec3::X * half, Vec3::Y * half);
    let scene = |others| over_ground(vec![lamp(LampKind::Point { radius_m: 0.0 }, lamp_m)], others);
    let open = lit(&gpu, &rig, &scene(vec![]));
    let shaded = lit(&gpu, &rig, &scene(vec![("blocker", Kind::Virtual, blocker)]));
    let is_blocked = |point: Vec3| {
        let met = point + (lamp_m - point) * (middle.z / lamp_m.z);
        (met - middle).abs().truncate().max_element() < half
    };
    let mut edge = Vec::new();
    for (i, (shaded, open)) in shaded.irradiance.iter().zip(&open.irradiance).enumerate() {
        const N: i32 = 8;
        let pixel = DVec2::new((i % 320) as f64, (i / 320) as f64);
        let offset = |k: i32| DVec2::new(f64::from(k % N), f64::from(k / N)) / f64::from(N) - 0.4375;
        let blocked = (0..N * N)
            .filter(|&k| is_blocked(on_ground(&rig, pixel + offset(k))))
            .count();
        let expected = 1.0 - blocked as f32 / (N * N) as f32;
        let found = shaded.x / open.x;
        if expected == 0.0 || expected == 1.0 {
            // A rasterised place is a little off the plane that the formula knows.
            assert!(
                (found - expected).abs() <= 0.2501,
                "pixel {pixel}: {found}, not {expected}"
            );
        } else {
            edge.push(found - expected);
        }
    }
    let mean = edge.iter().sum::<f32>() / edge.len() as f32;
    let errors = Errors::of("edge of a hard shadow", edge);
    // Four rays tell quarters of a pixel; on the whole the edge is not moved.
    assert!(
        errors.n > 200 && errors.mean < 0.11 && mean.abs() < 0.03,
        "{errors:?}, edge moved by {mean} pixels"
    );
}

#[test]
fn the_penumbra_of_a_ball_is_as_wide_as_the_ball_makes_it() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let (radius_m, height_m, edge_m) = (0.05, 0.6, 0.1);
    // The edge of a half plane above x = 0.
    let blocker = support::square(Vec3::new(-0.5, 0.0, edge_m), Vec3::X * 0.5, Vec3::Y);
    let lamps = vec![lamp(LampKind::Point { radius_m }, Vec3::new(0.0, 0.02, height_m))];
    let open = lit(&gpu, &rig, &over_ground(lamps.clone(), vec![]));
    let shaded = lit(
        &gpu,
        &rig,
        &over_ground(lamps, vec![("blocker", Kind::Virtual, blocker)]),
    );
    let mut errors = Vec::new();
    let mut partly = 0;
    for ((place, shaded), open) in shaded.places.iter().zip(&shaded.irradiance).zip(&open.irradiance) {
        if place.w == 0.0 || place.y.abs() > 0.06 || place.x.abs() > 0.03 {
            continue;
        }
        // Where the line over the edge meets the lamp's height, in its radii.
        let t = (-place.x * (height_m - edge_m) / edge_m / radius_m).clamp(-1.0, 1.0);
        let expected = (t.acos() - t * (1.0 - t * t).sqrt()) / PI;
        partly += u32::from(expected > 0.02 && expected < 0.98);
        errors.push(shaded.x / open.x - expected);
    }
    let errors = Errors::of("penumbra", errors);
    // 64 rays of a tile; the tile widens the penumbra by four pixels' blur.
    assert!(
        partly > 500 && errors.mean < 0.02 && errors.worst < 0.1,
        "{errors:?}, {partly} in the penumbra"
    );
}

#[test]
fn every_kind_of_lamp_equals_its_twin_past_real_and_virtual_things() {
    let Some(gpu) = support::gpu() else { return };
    let kinds = [
        LampKind::Spot {
            radius_m: 0.0,
            inner_rad: 0.1,
            outer_rad: 0.35,
        },
        LampKind::Spot {
            radius_m: 0.03,
            inner_rad: 0.2,
            outer_rad: 0.5,
        },
        LampKind::Directional {
            angular_radius_rad: 0.0,
        },
        LampKind::Directional {
            angular_radius_rad: 0.08,
        },
        LampKind::Rectangle { half_m: [0.08, 0.03] },
    ];
    for kind in kinds {
        let mut of_kind = lamp(kind, Vec3::new(0.1, 0.05, 0.4));
        of_kind.direction = Vec3::new(-0.15, -0.05, -1.0).normalize();
        of_kind.across = of_kind.direction.cross(Vec3::new(0.3, 1.0, 0.0)).normalize();
        let balls = [
            ("real", Kind::Phantom, Vec3::new(0.08, 0.04, 0.06)),
            ("virtual", Kind::Virtual, Vec3::new(-0.02, -0.02, 0.05)),
        ];
        let balls = balls.map(|(name, kind, at)| (name, kind, support::sphere(at, 0.03, 24, support::diffuse(0.5))));
        let scene = over_ground(vec![of_kind], balls.to_vec());
        let lit = lit(&gpu, &support::rig(), &scene);
        let [real, added] = [Kind::Phantom, Kind::Virtual].map(|kind| support::occluders(&scene, kind));
        let all = real.triangles().iter().chain(added.triangles()).copied();
        let all = mirrorball_render::scene::occluders::Occluders::new(all);
        let brightest = lit.irradiance.iter().map(|e| e.x).fold(0.0, f32::max);
        let compared = (0..lit.places.len()).step_by(61).filter(|&i| lit.places[i].w > 0.0);
        let errors = compared.map(|i| {
            let (point, normal) = (lit.places[i].xyz(), lit.normals[i]);
            let from = (point + 3e-4 * normal, normal);
            let expected = reference::lamp_light::irradiance(&lit.lamps.all[0], from, &all, 12);
            (lit.irradiance[i].x - expected.x) / brightest
        });
        let errors = Errors::of(&format!("{kind:?}"), errors);
        // The pixels of an edge see it from four places, the twin from one.
        assert!(errors.n > 1000 && errors.mean < 0.006, "{kind:?}: {errors:?}");
    }
}

#[test]
fn a_highlight_on_rough_metal_is_the_path_tracers() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::pinhole_rig();
    let (center_m, radius_m) = (Vec3::new(0.03, 0.02, 0.06), 0.05);
    let metal = Material {
        base_color: [0.9, 0.7, 0.4],
        metallic: 1.0,
        roughness: 0.5,
        ..Material::default()
    };
    let lamp_m = Vec3::new(0.3, -0.2, 0.4);
    let mut scene = support::scene([("ball", Kind::Virtual, support::sphere(center_m, radius_m, 48, metal))]);
    scene.lamps = vec![lamp(LampKind::Point { radius_m: 0.0 }, lamp_m)];
    let settings = PathSettings {
        surfaces: Surfaces::AsGiven,
        pixel: PixelRays::Center,
        ..PathSettings::direct(16)
    };
    let traced = TracedScene::new(&gpu, (&scene, &[Affine3A::IDENTITY]), settings.surfaces).unwrap();
    let light = ShadowLight::Point {
        position_m: lamp_m,
        intensity: scene.lamps[0].irradiance,
    };
    let job = PathJob {
        view: &support::pinhole_view(FROM, AT),
        light: Some(&light),
        environment: Environment::Uniform(Vec3::ZERO),
        settings,
        target: None,
    };
    let expected = PathTracer::new(&gpu).render(&gpu, &traced, &job).unwrap().radiance;
    let mut stage = support::stage::Stage::new(gpu, &rig, &scene, [64, 1]);
    let lamps = GpuLamps::new(&scene.lamps, |lamp| {
        lamp.world_from_carrier(&rig, &[Affine3A::IDENTITY])
    });
    stage.gpu.write(&stage.buffers.lamps, &[lamps]);
    // All of the lamp's light arrives.
    let shares = support::halves((0..2 * 320 * 240).map(|_| Vec4::ONE));
    support::write_texture(&stage.gpu, stage.light_on[1].lamp_shares.texture(), &shares);
    let found = stage.shaded(&rig, &pose(), LightConfig::default());
    let errors = found.iter().zip(&expected).filter(|(found, _)| found.w == 1.0);
    let errors = Errors::of("highlight", errors.map(|(found, expected)| found.x - expected.x));
    let peak = expected.iter().map(|e| e.x).fold(0.0, f32::max);
    println!("peak radiance {peak}");
    // Both are the same formula; roughness grows where a pixel sweeps a wide reflection.
    assert!(
        errors.n > 3000 && peak > 0.5 && errors.mean < 0.01 * peak && errors.worst < 0.1 * peak,
        "{errors:?}"
    );
}

const SIZE: [usize; 2] = [320, 240];
const N_PIXELS: usize = SIZE[0] * SIZE[1];
/// Irradiance of lamps in the tests of real things.
const OF_LAMPS: Vec3 = Vec3::new(2.0, 1.0, 0.5);

/// Albedo of phantoms and what lamps add to them, where the camera sees `codes` and the light of the room is `room` (w: 0
/// for no phantom).
fn received(rig: &Rig, codes: &[u8], room: impl Fn(usize) -> Vec4) -> Option<[Vec<Vec4>; 2]> {
    let gpu = support::gpu()?;
    let scene = over_ground(vec![lamp(LampKind::Point { radius_m: 0.0 }, Vec3::Z)], vec![]);
    let stage = support::stage::Stage::new(gpu, rig, &scene, [64, 1]);
    let gpu = &stage.gpu;
    let camera = rig.scene_camera();
    let mut view = CameraView::new(gpu, camera, &stage.buffers);
    view.picture.upload(gpu, &support::frame_of(camera, 1, codes.to_vec()));
    let gpu_camera = GpuCamera::new(camera, &Pose::identity(), &support::EXPOSURE, [0.02, 20.0]);
    gpu.write(&view.camera, &[gpu_camera]);
    let light = ShadowedLight::new(gpu, view.phantoms.views());
    let of_room = support::halves((0..N_PIXELS).map(room));
    support::write_texture(gpu, stage.receive.real_light().texture(), &of_room);
    let of_lamps = support::halves((0..N_PIXELS).map(|_| OF_LAMPS.extend(1.0)));
    support::write_texture(gpu, light.lamps.texture(), &of_lamps);
    let pass = LampReceive::new(gpu, &view, (&light, &stage.receive), 1);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut Timer::new(gpu));
    gpu.queue.submit([encoder.finish()]);
    Some([vectors(gpu, pass.albedo()), vectors(gpu, stage.receive.added())])
}

/// Radiance of code 2, from which on a picture tells albedo.
fn dark_radiance(of: &reference::composite::PixelOf<'_>) -> Vec3 {
    let photometry = &of.camera.photometry;
    let signal = photometry.vignetting_at(of.pixel, of.camera.intrinsics.size_px)
        * DVec3::from_array(photometry.signal_per_radiance(of.exposure));
    (photometry.response.linear_from_code(2) / signal).as_vec3()
}

#[test]
fn albedo_and_added_light_equal_their_twin_and_have_bounds() {
    let rig = support::rig();
    let camera = rig.scene_camera();
    // Fields of 8 × 8 pixels of one code, neighbours far apart: dark ones and clipped ones among them.
    let code = |i: usize, factor: usize| {
        let field = (i % SIZE[0]) / 8 + 40 * (i / SIZE[0] / 8);
        (factor * field % 256) as u8
    };
    let codes: Vec<u8> = (0..N_PIXELS)
        .flat_map(|i| [37, 101, 59].map(|factor| code(i, factor)))
        .collect();
    // Next to no light, some, a lot; every seventh pixel is no phantom.
    let row = |i: usize| i / SIZE[0];
    let room = |i: usize| Vec4::splat([0.001, 1.0, 9.0][row(i) / 80]).with_w(f32::from(!i.is_multiple_of(7)));
    let Some([albedo, added]) = received(&rig, &codes, room) else {
        return;
    };
    // Well within a field, and away from where the light changes.
    let is_within =
        |i: usize| (2..6).contains(&(i % 8)) && (2..6).contains(&(row(i) % 8)) && (8..72).contains(&(row(i) % 80));
    let mut errors = Vec::new();
    for i in (0..N_PIXELS).filter(|&i| is_within(i)) {
        if i.is_multiple_of(7) {
            assert!(
                albedo[i] == Vec4::ZERO && added[i].xyz() == Vec3::ZERO,
                "pixel {i} is no phantom"
            );
            continue;
        }
        let of = reference::composite::PixelOf {
            camera,
            exposure: &support::EXPOSURE,
            pixel: DVec2::new((i % SIZE[0]) as f64, row(i) as f64),
        };
        let own = [0, 1, 2].map(|c| codes[3 * i + c]);
        let radiance = reference::real_radiance::pixel(&of, own, [Vec3::ONE, Vec3::ZERO]).max(Vec3::ZERO);
        let expected = reference::lamp_receive::albedo(radiance, room(i).xyz(), dark_radiance(&of));
        assert!(
            albedo[i].xyz().cmple(Vec3::splat(0.951)).all(),
            "pixel {i}: {}",
            albedo[i]
        );
        errors.extend((albedo[i].xyz() - expected).to_array());
        errors.extend((added[i].xyz() - expected * OF_LAMPS / PI).to_array());
    }
    let errors = Errors::of("albedo and added light", errors);
    // Half floats.
    assert!(errors.n > 40_000 && errors.worst < 0.003, "{errors:?}");
}

/// Codes of a matt grey surface in light that goes by pixel.
fn codes_of(rig: &Rig, albedo: f64, irradiance: impl Fn(usize) -> f64) -> Vec<u8> {
    let camera = rig.scene_camera();
    let signal = camera.photometry.signal_per_radiance(&support::EXPOSURE);
    let of_pixel = |i: usize| {
        let pixel = DVec2::new((i % SIZE[0]) as f64, (i / SIZE[0]) as f64);
        let radiance = albedo * irradiance(i) / std::f64::consts::PI;
        let vignetting = camera.photometry.vignetting_at(pixel, camera.intrinsics.size_px);
        signal.map(|s| camera.photometry.response.encode(s * vignetting * radiance))
    };
    (0..N_PIXELS).flat_map(of_pixel).collect()
}

#[test]
fn a_real_shadow_that_the_light_misplaces_leaves_no_line() {
    let rig = support::rig();
    // In the picture the shadow begins three pixels later.
    let light = |i: usize, edge: usize| if i % SIZE[0] < edge { 4.0 } else { 2.0 };
    let codes = codes_of(&rig, 0.4, |i| light(i, 163));
    let room = |i: usize| Vec4::splat(light(i, 160) as f32).with_w(1.0);
    let Some([albedo, _]) = received(&rig, &codes, room) else {
        return;
    };
    let errors = Errors::of("albedo at a shadow's edge", albedo.iter().map(|a| a.y / 0.4 - 1.0));
    // By its own light alone a pixel between the two edges would be twice as light.
    assert!(errors.worst < 0.11, "{errors:?}");
}

#[test]
fn a_lamp_does_not_light_up_the_noise_of_a_dark_picture() {
    let rig = support::rig();
    let irradiance = 0.3;
    let mut codes = codes_of(&rig, 0.4, |_| irradiance);
    for (i, code) in codes.iter_mut().enumerate() {
        *code = code
            .saturating_add((5.0 * support::spread(i * 7919, 0.2)) as u8)
            .saturating_sub(2);
    }
    let Some([albedo, _]) = received(&rig, &codes, |_| Vec4::splat(irradiance as f32).with_w(1.0)) else {
        return;
    };
    let camera = rig.scene_camera();
    let own = (0..N_PIXELS).map(|i| {
        let of = reference::composite::PixelOf {
            camera,
            exposure: &support::EXPOSURE,
            pixel: DVec2::new((i % SIZE[0]) as f64, (i / SIZE[0]) as f64),
        };
        let code = [0, 1, 2].map(|c| codes[3 * i + c]);
        let radiance = reference::real_radiance::pixel(&of, code, [Vec3::ONE, Vec3::ZERO]);
        PI * radiance.y / irradiance as f32 - 0.4
    });
    let own = Errors::of("albedo of single pixels", own);
    let smooth = Errors::of("albedo", albedo.iter().map(|a| a.y - 0.4));
    assert!(smooth.mean < 0.5 * own.mean, "{smooth:?} of {own:?}");
}

#[test]
fn lamps_move_with_what_carries_them() {
    let rig = support::rig();
    let placements = [Affine3A::from_rotation_x(PI / 2.0) * Affine3A::from_translation(Vec3::new(0.0, 0.0, 2.0))];
    let at = |carrier| Lamp {
        carrier,
        ..lamp(LampKind::Rectangle { half_m: [0.2, 0.1] }, Vec3::new(0.1, 0.0, 0.0))
    };
    let lamps = [at(Carrier::World), at(Carrier::Marker(1)), at(Carrier::Object(0))];
    let gpu = GpuLamps::new(&lamps, |lamp| lamp.world_from_carrier(&rig, &placements));
    assert_eq!(gpu.counts[..2], [3, 0b111], "rectangles are soft");
    let is = |found: Vec4, expected: Vec3| assert!(found.xyz().distance(expected) < 1e-5, "{found}, not {expected}");
    is(gpu.all[0].position_m, Vec3::new(0.1, 0.0, 0.0));
    is(gpu.all[1].position_m, Vec3::new(0.21, -0.05, 0.0));
    // A quarter turn about x after 2 m upwards.
    is(gpu.all[2].position_m, Vec3::new(0.1, -2.0, 0.0));
    is(gpu.all[2].direction, Vec3::Y);
    is(gpu.all[2].across, 0.2 * Vec3::X);
    is(gpu.all[2].along, 0.1 * Vec3::NEG_Z);
}

#[test]
fn a_lamp_whose_carrier_is_gone_does_not_shine() {
    let at = |carrier, kind| Lamp {
        carrier,
        ..lamp(kind, Vec3::new(0.1, 0.0, 0.0))
    };
    let lamps = [
        at(Carrier::Object(0), LampKind::Rectangle { half_m: [0.2, 0.1] }),
        at(Carrier::World, LampKind::Point { radius_m: 0.0 }),
    ];
    let gpu = GpuLamps::new(&lamps, |lamp| lamp.world_from_carrier(&support::rig(), &[GONE]));
    assert_eq!(gpu.counts[..2], [1, 0], "the hard one alone");
    assert_eq!(gpu.all[0].position_m, Vec4::new(0.1, 0.0, 0.0, 0.0));
}
