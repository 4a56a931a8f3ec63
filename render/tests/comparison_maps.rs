//! Methods that light is mapped with for comparison against their CPU twins; seams; every method in the picture.

mod support;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_render::config::{DiffuseMethod, Facets, LightConfig, SpecularMethod};
use mirrorball_render::environments::cube_view;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::light_maps::LightMaps;
use mirrorball_render::passes::ENVIRONMENT_SIZE;
use mirrorball_render::passes::sphere_map::SPHERE_MAP_SIZE;
use mirrorball_render::reference;
use mirrorball_render::scene::Kind;
use support::maps::{LAMP, Maps, lamp_room, smooth_room};
use support::stage::Stage;
use support::{EXPOSURE, Errors, cube_of, read_layer};

// ---- separable_blur, cylindrical, sphere_map -------------------------------------------------------------------------

/// The environment as the comparison methods see it: 32 × 32 texels a face.
fn small(environment: &Cube<Vec3>) -> Cube<Vec3> {
    reference::downsample::halved(&reference::downsample::halved(environment))
}

#[test]
fn the_comparison_filters_equal_their_twins() {
    let Some(gpu) = support::gpu() else { return };
    let environment = lamp_room(LAMP, 0.1);
    let source = small(&environment);
    let assert_same = |maps: &mut Maps, name: &str, twin: &Cube<Vec3>| {
        maps.make(&environment);
        let peak = twin.texels().iter().map(|t| t.max_element()).fold(0.0, f32::max);
        let found = maps.irradiance();
        let pairs = found.texels().iter().zip(twin.texels());
        let errors = Errors::of(name, pairs.map(|(a, b)| (*a - *b).abs().max_element() / peak));
        // Half floats between the steps, and a sampler's weights of 8 bits.
        assert!(errors.mean < 1e-3 && errors.worst < 0.01, "{name}: {errors:?}");
    };
    let mut blur = Maps::new(gpu, DiffuseMethod::SeparableBlur, SpecularMethod::SphereMap);
    assert_same(
        &mut blur,
        "separable blur",
        &reference::separable_blur::irradiance(&source),
    );
    let mut turned = Maps::new(blur.stage.gpu, DiffuseMethod::Cylindrical, SpecularMethod::SphereMap);
    assert_same(&mut turned, "cylindrical", &reference::cylindrical::irradiance(&source));
}

#[test]
fn sphere_maps_show_what_their_twin_says() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::SphereMap, SpecularMethod::SphereMap);
    let rig = support::rig();
    let pose = support::looking_at(DVec3::new(0.0, 0.0, 0.1), DVec3::new(0.2, -0.4, 0.3));
    let camera = GpuCamera::new(rig.scene_camera(), &pose, &EXPOSURE, [0.02, 20.0]);
    maps.stage.gpu.write(&maps.stage.camera, &[camera]);
    let environment = smooth_room();
    maps.make(&environment);
    let irradiance = maps.irradiance();
    for (layer, cube) in [(0, &environment), (1, &irradiance)] {
        let found: Vec<[half::f16; 4]> = read_layer(&maps.stage.gpu, &maps.stage.environments.sphere_maps, 0, layer);
        let errors = found.iter().enumerate().map(|(index, texel)| {
            let (x, y) = (index as u32 % SPHERE_MAP_SIZE, index as u32 / SPHERE_MAP_SIZE);
            let expected = cube.bilinear(reference::sphere_map::direction(&pose, x, y));
            (texel[0].to_f32() - expected.x) / expected.x.max(1.0)
        });
        let errors = Errors::of(&format!("sphere map, layer {layer}"), errors);
        assert!(errors.mean < 2e-3 && errors.worst < 0.02, "layer {layer}: {errors:?}");
    }
}

// ---- seams -----------------------------------------------------------------------------------------------------------

/// Reads a cube along both sides of each of the twelve edges, the whole edge, in every mip and between; the jumps relative
/// to the larger value.
fn jumps_at_edges(stage: &Stage, texture: &wgpu::Texture) -> Vec<f32> {
    const SAMPLE: &str = "
        @group(0) @binding(0) var cube: texture_cube<f32>;
        @group(0) @binding(1) var linear_sampler: sampler;
        @group(0) @binding(2) var<storage, read> queries: array<vec4f>;
        @group(0) @binding(3) var<storage, read_write> out: array<vec4f>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3u) {
            if id.x < arrayLength(&queries) {
                out[id.x] = textureSampleLevel(cube, linear_sampler, queries[id.x].xyz, queries[id.x].w);
            }
        }";
    let n_mips = texture.mip_level_count();
    let mut queries = Vec::new();
    for (axis_a, axis_b) in [(0, 1), (0, 2), (1, 2)] {
        for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
            for step in -9..=9 {
                for half_level in 0..2 * n_mips - 1 {
                    let mut on_edge = Vec3::splat(step as f32 / 10.0);
                    (on_edge[axis_a], on_edge[axis_b]) = (signs[0], signs[1]);
                    for axis in [axis_a, axis_b] {
                        let mut side = on_edge;
                        side[axis] *= 1.0 + 1e-5;
                        queries.push(side.extend(half_level as f32 / 2.0));
                    }
                }
            }
        }
    }
    let view = texture.create_view(&cube_view(0, n_mips));
    let query_buffer = stage.gpu.buffer("test: queries", &queries);
    let sampled: Vec<Vec4> = support::compute(
        &stage.gpu,
        SAMPLE,
        &[
            wgpu::BindingResource::TextureView(&view),
            wgpu::BindingResource::Sampler(&stage.gpu.linear_sampler()),
            query_buffer.as_entire_binding(),
        ],
        queries.len(),
    );
    let jump = |pair: &[Vec4]| (pair[0].x - pair[1].x) / pair[0].x.max(pair[1].x);
    sampled.chunks_exact(2).map(jump).collect()
}

#[test]
fn no_map_has_a_seam_at_any_edge_in_any_mip() {
    let Some(mut gpu) = support::gpu() else { return };
    let environment = lamp_room(Vec3::new(1.0, 0.4, 1.0).normalize(), 0.6);
    // A seam of one texel would be as large as what the lobe changes over it; the sampler's weights have 8 bits, and
    // neighbouring texels of the first mips differ by the lamp's contrast at its outline.
    for specular in [SpecularMethod::Ggx, SpecularMethod::Phong] {
        let mut maps = Maps::new(gpu, DiffuseMethod::CosineCube, specular);
        maps.make(&environment.map(|t| t.min(Vec3::splat(50.0))));
        let environments = &maps.stage.environments;
        for (name, texture) in [
            ("radiance", &environments.radiance),
            ("specular", &environments.specular),
            ("irradiance", &environments.irradiance),
        ] {
            let errors = Errors::of(
                &format!("seams of {name}, {specular:?}"),
                jumps_at_edges(&maps.stage, texture),
            );
            assert!(
                errors.mean < 1e-3 && errors.worst < 0.05,
                "{name}, {specular:?}: {errors:?}"
            );
        }
        gpu = maps.stage.gpu;
    }
}

#[test]
fn the_blur_on_faces_has_the_seams_that_the_others_lack() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::SeparableBlur, SpecularMethod::SphereMap);
    maps.make(&cube_of(ENVIRONMENT_SIZE, |d| {
        Vec3::splat(if d.x > 0.8 { 50.0 } else { 1.0 })
    }));
    // Neighbouring texels across an edge, as the sampler hides a jump by mixing them.
    let found = maps.irradiance();
    let across = |at: [f32; 2]| {
        let [one, other] = [Vec3::new(1.0, at[0], 0.97), Vec3::new(0.97, at[0], 1.0)].map(|d| found.nearest(d).x);
        (one - other).abs() / one.max(other)
    };
    let jumps = Errors::of("steps across an edge", (-9..=9).map(|i| across([i as f32 / 10.0, 0.0])));
    assert!(jumps.mean > 0.1, "{jumps:?}");
}

// ---- shade -----------------------------------------------------------------------------------------------------------

#[test]
fn every_method_shades_alike_in_uniform_light() {
    let Some(mut gpu) = support::gpu() else { return };
    let rig = support::rig();
    let pose = support::looking_at(DVec3::new(0.0, 0.0, 0.1), DVec3::new(0.1, -0.3, 0.25));
    let methods = [
        (DiffuseMethod::CosineCube, SpecularMethod::Ggx),
        (DiffuseMethod::Sh9, SpecularMethod::Phong),
        (DiffuseMethod::SeparableBlur, SpecularMethod::SphereMap),
        (DiffuseMethod::Cylindrical, SpecularMethod::Ggx),
        (DiffuseMethod::SphereMap, SpecularMethod::SphereMap),
    ];
    for (diffuse, specular) in methods {
        // Half mirror, half matt: both methods give half of the light.
        let mut material = support::mirror();
        material.metallic = 0.5;
        material.roughness = 0.5;
        let sphere = support::sphere(Vec3::Z * 0.1, 0.05, 24, material);
        let scene = support::scene([("sphere", Kind::Virtual, sphere)]);
        let stage = Stage::new(gpu, &rig, &scene, [64, 1]);
        let config = LightConfig {
            diffuse,
            specular,
            facets: Facets::Multiple,
            ..LightConfig::default()
        };
        let sampler = stage.gpu.linear_sampler();
        let maps = LightMaps::new(&stage.gpu, &stage.environments, &config, (&stage.camera, &sampler));
        let mut lit = Maps { stage, maps };
        lit.make(&Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE));
        let pixels = lit.stage.shaded(&rig, &pose, config);
        let inside: Vec<Vec4> = pixels.into_iter().filter(|p| p.w == 1.0).collect();
        assert!(
            inside.len() > 1000,
            "{diffuse:?}: the sphere covers {} pixels",
            inside.len()
        );
        // A white surface sends all of the light on, whatever its metal.
        let expected = 1.0;
        let brightness = inside.iter().map(|p| p.x).sum::<f32>() / inside.len() as f32;
        assert!(
            (brightness - expected).abs() < 0.01,
            "{diffuse:?}, {specular:?}: {brightness}, not {expected}"
        );
        gpu = lit.stage.gpu;
    }
}
