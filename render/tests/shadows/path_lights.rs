//! Lights on matt surfaces: the path tracer against closed forms and rays on the CPU.

use glam::{Vec3, Vec4};
use mirrorball_calib::probe::cube::{Cube, face_direction};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::lab::{Lab, LabFrame, MAP_SIZE};
use mirrorball_render::scene::Mesh;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::path::environment::{Environment, EnvironmentBuffers};
use mirrorball_render::shadow::path::irradiance::{IrradianceJob, IrradiancePass, OccluderSets};
use mirrorball_render::shadow::path::{PathSettings, PixelRays, Sampling};
use mirrorball_render::shadow::view::View;

use crate::blocks;
use crate::path::{job, lamp, made_of, mean, studio};

const PI: f32 = std::f32::consts::PI;

fn lab(meshes: &[(&str, Mesh)], view: &View) -> Lab {
    let (scene, placements) = blocks::scene_of(meshes);
    Lab::new(Gpu::open().unwrap(), scene, placements, view).unwrap()
}

fn frame(light: &ShadowLight) -> LabFrame<'_> {
    LabFrame {
        method: ShadowMethod::None,
        map_size: MAP_SIZE,
        light,
        ambient: Vec3::splat(0.1),
        refreshes_max: usize::MAX,
    }
}

fn from_above(size: u32) -> View {
    View::looking_at(Vec3::new(0.3, -1.2, 2.0), Vec3::ZERO, 1.0, [size; 2])
}

#[test]
fn an_open_floor_gets_what_the_formulas_say_of_every_light() {
    let view = from_above(16);
    let mut lab = lab(&[("floor", blocks::floor(4.0))], &view);
    let lights = [
        ShadowLight::Point {
            position_m: Vec3::new(0.5, 0.1, 0.8),
            intensity: Vec3::new(2.0, 1.0, 0.5),
        },
        ShadowLight::Spot {
            position_m: Vec3::new(0.5, 0.1, 1.0),
            axis: Vec3::new(-0.6, 0.0, -0.8),
            cone_rad: [0.3, 0.6],
            intensity: Vec3::new(2.0, 1.0, 0.5),
        },
        ShadowLight::Directional {
            towards: Vec3::new(0.6, 0.0, 0.8),
            irradiance: Vec3::new(2.0, 1.0, 0.5),
        },
        lamp(),
    ];
    for light in &lights {
        let expected = lab.picture(&frame(light)).unwrap();
        let traced = lab.path_traced(&frame(light), &PathSettings::direct(64)).unwrap();
        for i in 0..expected.radiance.len() {
            let (e, t) = (expected.radiance[i], traced.radiance[i]);
            let allowed = 2e-3 + 4e-3 * e.truncate() + 3.0 * traced.standard_error[i];
            assert!(
                (e - t).truncate().abs().cmple(allowed).all(),
                "{light:?} pixel {i}: {t}, not {e}"
            );
            assert_eq!(e.w, t.w);
        }
    }
}

/// Irradiance of a rectangle on the floor, past what `occluders` hold.
fn rectangle_past(light: &ShadowLight, occluders: &Occluders, place: Vec3) -> f32 {
    const N: i32 = 24;
    let ShadowLight::Rect { half_u_m, half_v_m, .. } = light else {
        panic!("no rectangle")
    };
    let across = half_u_m.cross(*half_v_m);
    let mut sum = 0.0;
    for i in 0..N * N {
        let at = |k: i32| (k as f32 + 0.5) / N as f32 * 2.0 - 1.0;
        let there = light.place_m([at(i % N), at(i / N)], place, 0.0);
        let to_light = there - place;
        let r2 = to_light.length_squared();
        if !occluders.blocks(place, there) {
            sum += to_light.z.max(0.0) * (-to_light.dot(across)).max(0.0) / (r2 * r2) * 4.0 / (N * N) as f32;
        }
    }
    sum
}

#[test]
fn a_blocks_soft_shadow_is_that_of_rays_on_the_cpu() {
    let view = from_above(20);
    let block = blocks::block(Vec3::new(-0.3, -0.3, 0.02), Vec3::new(0.3, 0.2, 0.45));
    let mut lab = lab(&[("floor", blocks::floor(4.0)), ("block", block)], &view);
    let light = lamp();
    let dark = LabFrame {
        ambient: Vec3::ZERO,
        ..frame(&light)
    };
    let traced = lab.path_traced(&dark, &PathSettings::direct(256)).unwrap();
    lab.draw(&dark).unwrap();
    let places = lab.places().unwrap();
    let occluders = Occluders::new(lab.casters().triangles());
    let mut n_penumbra = 0;
    for (i, place) in places.iter().enumerate() {
        if place.w == 0.0 || place.z.abs() > 1e-4 {
            continue;
        }
        let place = place.truncate() * Vec3::new(1.0, 1.0, 0.0);
        let open = rectangle_past(&light, &Occluders::default(), place);
        let expected = rectangle_past(&light, &occluders, place);
        n_penumbra += i32::from(expected > 0.1 * open && expected < 0.9 * open);
        let found = traced.radiance[i].z / (7.0 * 0.5 / PI);
        assert!(
            (found - expected).abs() < 0.03 * open,
            "{place}: {found}, not {expected} of {open}"
        );
    }
    assert!(n_penumbra > 10, "{n_penumbra}");
}

/// A map with one lamp of one texel, and the irradiance it gives a floor.
fn one_lamp() -> (Cube<Vec3>, f32) {
    const N: i32 = 32;
    let mut map = Cube::filled(16, Vec3::ZERO);
    let index = map.index_of(Vec3::new(0.5, 0.3, 0.6));
    map.texels_mut()[index] = Vec3::splat(500.0);
    let (face, texel) = (index / 256, index % 256);
    let mut irradiance = 0.0;
    for i in 0..N * N {
        let uv = |texel: usize, k: i32| (texel as f32 + (k as f32 + 0.5) / N as f32) / 8.0 - 1.0;
        let towards = face_direction(face, uv(texel % 16, i % N), uv(texel / 16, i / N));
        // Solid angle du dv / r³, cosine z / r.
        irradiance += 500.0 * towards.z.max(0.0) / towards.length().powi(4) / (64 * N * N) as f32;
    }
    (map, irradiance)
}

#[test]
fn a_lamp_of_one_texel_gives_its_irradiance() {
    let view = from_above(8);
    let (map, irradiance) = one_lamp();
    let settings = PathSettings::direct(64);
    let picture = studio().picture(
        &[("floor", blocks::floor(40.0))],
        &job(&view, Environment::Cube(&map), settings),
    );
    for found in &picture.radiance {
        let found = found.x / (0.5 / PI);
        assert!((found / irradiance - 1.0).abs() < 5e-3, "{found}, not {irradiance}");
    }
}

#[test]
fn every_way_to_find_light_has_the_same_mean() {
    let view = from_above(16);
    let mut map = Cube::filled(8, Vec3::splat(0.2));
    let bright = map.index_of(Vec3::new(-0.3, 0.4, 0.8));
    map.texels_mut()[bright] = Vec3::splat(20.0);
    let light = lamp();
    let floor = made_of(blocks::floor(4.0), |m| {
        m.roughness = 0.5;
        m.dielectric_f0 = [0.3; 3];
        m.dielectric_f90 = 1.0;
    });
    let means = [Sampling::Both, Sampling::Lights, Sampling::Surfaces].map(|sampling| {
        let settings = PathSettings {
            samples: 256,
            max_bounces: 1,
            sampling,
            pixel: PixelRays::Center,
            ..PathSettings::default()
        };
        let mut with_light = job(&view, Environment::Cube(&map), settings);
        with_light.light = Some(&light);
        mean(&studio().picture(&[("floor", floor.clone())], &with_light))
    });
    let [(both, both_error), others @ ..] = means;
    assert!(both_error < 0.006 * both, "{both} ± {both_error}");
    for (other, other_error) in others {
        assert!(
            (both - other).abs() < 3.0 * (both_error + other_error),
            "{both} ± {both_error}, {other} ± {other_error}"
        );
    }
}

/// Light along the floor meets a wall; what the wall gives the floor is what a rectangle as bright gives it.
#[test]
fn a_lit_wall_lights_the_floor_as_a_rectangle_would() {
    let view = View::looking_at(Vec3::new(1.2, 0.0, 1.5), Vec3::new(0.6, 0.0, 0.0), 0.4, [12; 2]);
    let mut wall = Mesh {
        materials: blocks::floor(1.0).materials,
        ..Mesh::default()
    };
    blocks::push_quad(
        &mut wall,
        [[-0.5, 0.1], [0.5, 0.1], [0.5, 0.8], [-0.5, 0.8]].map(|[y, z]| Vec3::new(0.0, y, z)),
    );
    let sun = ShadowLight::Directional {
        towards: Vec3::X,
        irradiance: Vec3::splat(4.0),
    };
    let settings = PathSettings {
        samples: 256,
        max_bounces: 2,
        pixel: PixelRays::Center,
        ..PathSettings::default()
    };
    let mut with_sun = job(&view, Environment::Uniform(Vec3::ZERO), settings);
    with_sun.light = Some(&sun);
    let traced = studio().picture(&[("floor", blocks::floor(4.0)), ("wall", wall)], &with_sun);
    let as_bright = ShadowLight::Rect {
        center_m: Vec3::new(0.0, 0.0, 0.45),
        half_u_m: Vec3::new(0.0, 0.5, 0.0),
        half_v_m: Vec3::new(0.0, 0.0, 0.35),
        radiance: Vec3::splat(4.0 * 0.5 / PI),
    };
    let mut lab = lab(&[("floor", blocks::floor(4.0))], &view);
    let expected = lab
        .picture(&LabFrame {
            ambient: Vec3::ZERO,
            ..frame(&as_bright)
        })
        .unwrap();
    let (mut sum, mut sum_expected) = (0.0, 0.0);
    for i in 0..traced.radiance.len() {
        let (e, t) = (expected.radiance[i].x, traced.radiance[i].x);
        assert!(
            (t - e).abs() < 1e-3 + 4.0 * traced.standard_error[i].x,
            "pixel {i}: {t}, not {e}"
        );
        sum += t;
        sum_expected += e;
    }
    assert!((sum / sum_expected - 1.0).abs() < 0.01, "{sum} {sum_expected}");
}

/// A real block and a virtual one under a sky that is brighter on one side.
#[test]
fn irradiance_past_two_sets_of_things_is_that_of_rays_on_the_cpu() {
    let view = from_above(12);
    let real = blocks::block(Vec3::new(-0.5, -0.3, 0.02), Vec3::new(-0.2, 0.3, 0.5));
    let added = blocks::block(Vec3::new(0.1, -0.2, 0.02), Vec3::new(0.4, 0.2, 0.4));
    let meshes = [
        ("floor", blocks::floor(4.0)),
        ("real", real.clone()),
        ("added", added.clone()),
    ];
    // Only the surface is drawn; the map's rays are traced against the two sets.
    let mut map = Cube::filled(16, Vec3::ZERO);
    for i in 0..map.texels().len() {
        let direction = map.direction(i);
        map.texels_mut()[i] = Vec3::new(1.0, 0.5 + 0.4 * direction.x, if direction.y > 0.7 { 30.0 } else { 0.1 });
    }
    let gpu = Gpu::open().unwrap();
    let corners = |mesh: &Mesh| -> Vec<[Vec3; 3]> {
        let at = |i: u32| Vec3::from(mesh.vertices[i as usize].position);
        mesh.indices
            .chunks_exact(3)
            .map(|t| [at(t[0]), at(t[1]), at(t[2])])
            .collect()
    };
    let (real, added) = (corners(&real), corners(&added));
    let (scene, placements) = blocks::scene_of(&meshes);
    let (places, without, with_all) = traced_irradiance(&gpu, (scene, placements), &view, (&map, &real, &added));
    let (only_real, all) = (
        Occluders::new(real.iter().copied()),
        Occluders::new(real.iter().chain(&added).copied()),
    );
    let (mut n_darker, mut n, mut sum) = (0, 0.0, Vec3::ZERO);
    for i in (0..places.len()).step_by(3) {
        let place = places[i].truncate();
        if places[i].w == 0.0 || place.z.abs() > 1e-4 {
            continue;
        }
        let open = irradiance_on_floor(&map, &Occluders::default(), place);
        for (found, occluders) in [(without[i], &only_real), (with_all[i], &all)] {
            let expected = irradiance_on_floor(&map, occluders, place);
            let difference = (found.truncate() - expected) / open;
            assert!(
                difference.abs().max_element() < 0.025,
                "{place}: {found}, not {expected} of {open}"
            );
            sum += difference;
            n += 1.0;
        }
        n_darker += i32::from(with_all[i].z < 0.8 * without[i].z);
    }
    assert!(n_darker > 1, "{n_darker}");
    assert!((sum / n).abs().max_element() < 4e-3, "{}", sum / n);
}

type Placed = (mirrorball_render::scene::Scene, Vec<glam::Affine3A>);
type Lit<'a> = (&'a Cube<Vec3>, &'a [[Vec3; 3]], &'a [[Vec3; 3]]);

fn traced_irradiance(
    gpu: &Gpu,
    (scene, placements): Placed,
    view: &View,
    (map, real, added): Lit<'_>,
) -> (Vec<Vec4>, Vec<Vec4>, Vec<Vec4>) {
    use mirrorball_render::scene_gpu::SceneBuffers;
    use mirrorball_render::shadow::surface::SurfacePass;
    let buffers = SceneBuffers::placed(gpu, &scene, &placements, f32::INFINITY).unwrap();
    let pass = SurfacePass::new(gpu);
    let surface = pass.surface(gpu, view, &buffers);
    let mut timer = Timer::new(gpu);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let everything = buffers.range(gpu, "everything", &[0, 1, 2]);
    pass.record(&mut encoder, &mut timer, (&surface, &buffers, &everything));
    gpu.queue.submit([encoder.finish()]);
    let irradiance = IrradiancePass::new(gpu);
    let maps = irradiance.maps(gpu, view.size_px).unwrap();
    let environment = EnvironmentBuffers::new(gpu, &Environment::Cube(map)).unwrap();
    let occluders = OccluderSets::new(gpu, real, added).unwrap();
    let irradiance_job = IrradianceJob {
        places: &surface.place,
        normals: &surface.normal,
        environment: &environment,
        occluders: &occluders,
        rays: 4096,
        seed: 3,
    };
    irradiance.render(gpu, &mut timer, &maps, &irradiance_job).unwrap();
    (
        gpu.read_float(&surface.place_texture).unwrap(),
        gpu.read_float(&maps.without).unwrap(),
        gpu.read_float(&maps.with_all).unwrap(),
    )
}

/// Sum over all texels, each of many directions.
fn irradiance_on_floor(map: &Cube<Vec3>, occluders: &Occluders, place: Vec3) -> Vec3 {
    const N: usize = 96;
    let mut sum = Vec3::ZERO;
    for i in 0..6 * N * N {
        let uv = |k: usize| (k as f32 + 0.5) / N as f32 * 2.0 - 1.0;
        let towards = face_direction(i / (N * N), uv(i % N), uv(i / N % N));
        if towards.z <= 0.0 || occluders.blocks(place, place + 10.0 * towards) {
            continue;
        }
        let solid_angle = 4.0 / (N * N) as f32 / towards.length().powi(3);
        sum += map.nearest(towards) * (towards.normalize().z * solid_angle);
    }
    sum
}
