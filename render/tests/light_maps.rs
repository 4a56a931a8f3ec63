//! Every map of light against its CPU twin, against brute force, or against light whose answer is known.

mod support;

use std::f32::consts::PI;

use glam::{DVec3, Vec3, Vec4, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::sh::IrradianceSh;
use mirrorball_render::config::{DiffuseMethod, LightConfig, SpecularMethod};
use mirrorball_render::environments::{SH_STRIDE_BYTES, cube_view};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::gpu::types::{GpuCamera, GpuNode, MAX_ENVIRONMENTS};
use mirrorball_render::light_maps::LightMaps;
use mirrorball_render::light_tree::{LightTree, node_count};
use mirrorball_render::passes::irradiance::Irradiance;
use mirrorball_render::passes::prefilter_phong::{exponent_of_mip, exponent_of_roughness};
use mirrorball_render::passes::prefilter_specular::alpha_of_mip;
use mirrorball_render::passes::sphere_map::SPHERE_MAP_SIZE;
use mirrorball_render::passes::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE};
use mirrorball_render::probe::surroundings::NOTHING_M;
use mirrorball_render::reference;
use mirrorball_render::reference::lobe_sum::Texels;
use support::stage::{Stage, environment_stage};
use support::{EXPOSURE, Errors, cube_of, halves, read_cube, read_layer};

/// Towards a lamp, not along any axis.
const LAMP: Vec3 = Vec3::new(0.48, -0.36, 0.8);
/// Lamps in the middle of a face, at an edge, at a corner, and anywhere.
const LAMPS: [Vec3; 4] = [Vec3::new(0.0, 0.01, 1.0), Vec3::new(0.1, -1.0, 1.0), Vec3::ONE, LAMP];

/// A stage with a method's maps.
struct Maps {
    stage: Stage,
    maps: LightMaps,
}

impl Maps {
    fn new(gpu: Gpu, diffuse: DiffuseMethod, specular: SpecularMethod) -> Self {
        let stage = environment_stage(gpu);
        let config = LightConfig {
            diffuse,
            specular,
            ..LightConfig::default()
        };
        let sampler = stage.gpu.linear_sampler();
        let maps = LightMaps::new(&stage.gpu, &stage.environments, &config, (&stage.camera, &sampler));
        Self { stage, maps }
    }

    /// Makes the maps of an environment; they are left on the GPU.
    fn make(&mut self, environment: &Cube<Vec3>) {
        let stage = &mut self.stage;
        support::write_texture(
            &stage.gpu,
            &stage.environments.radiance,
            &halves(environment.texels().iter().map(|t| t.extend(1.0))),
        );
        let mut encoder = stage
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.maps.record(&mut encoder, &mut stage.timer, &stage.environments);
        stage.gpu.queue.submit([encoder.finish()]);
        stage.gpu.wait("making maps").expect("the device works");
    }

    fn specular(&self, mip: u32) -> Cube<Vec3> {
        read_cube(&self.stage.gpu, &self.stage.environments.specular, mip).map(|t| t.xyz())
    }

    fn irradiance(&self) -> Cube<Vec3> {
        read_cube(&self.stage.gpu, &self.stage.environments.irradiance, 0).map(|t| t.xyz())
    }

    fn harmonics(&self) -> IrradianceSh {
        harmonics_in(&self.stage, &self.stage.environments.harmonics)
    }
}

/// A GGX map and no other.
fn ggx(gpu: Gpu) -> Maps {
    Maps::new(gpu, DiffuseMethod::Lights, SpecularMethod::Ggx)
}

/// The first environment's harmonics.
fn harmonics_in(stage: &Stage, buffer: &wgpu::Buffer) -> IrradianceSh {
    let coefficients: Vec<Vec4> = read_buffer(stage, buffer, MAX_ENVIRONMENTS as u64 * SH_STRIDE_BYTES);
    IrradianceSh {
        coefficients: std::array::from_fn(|i| coefficients[i].xyz()),
    }
}

/// The first bytes of a buffer.
fn read_buffer<T: bytemuck::Pod>(stage: &Stage, buffer: &wgpu::Buffer, bytes: u64) -> Vec<T> {
    let readback = Readback::new(&stage.gpu, "test: buffer", bytes);
    let mut encoder = stage
        .gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, readback.buffer(), 0, bytes);
    readback.record(&mut encoder);
    stage.gpu.queue.submit([encoder.finish()]);
    let mut out = vec![T::zeroed(); bytes as usize / size_of::<T>()];
    readback.read(&stage.gpu, &mut out).expect("the device works");
    out
}

/// Smooth light in three colours.
fn smooth_room() -> Cube<Vec3> {
    cube_of(ENVIRONMENT_SIZE, |d| {
        let wave = (3.0 * d.x).sin() + (4.0 * d.y + d.z).cos();
        Vec3::new(2.0 + wave, 2.2 - wave, 1.5 + 0.5 * (5.0 * d.z).sin())
    })
}

/// A room of about 1 with a lamp `radius_rad` wide, 10,000 times as bright.
fn lamp_room(lamp: Vec3, radius_rad: f32) -> Cube<Vec3> {
    cube_of(ENVIRONMENT_SIZE, |d| {
        if d.angle_between(lamp) < radius_rad {
            Vec3::new(10_000.0, 9_000.0, 7_000.0)
        } else {
            Vec3::splat(1.0 + 0.3 * (3.0 * d.x).sin())
        }
    })
}

/// What the sphere gets of all texels.
fn energy(cube: &Cube<Vec3>) -> f32 {
    let texels = cube.texels().iter().enumerate();
    texels.map(|(i, t)| t.x * cube.solid_angle(i)).sum::<f32>()
}

/// Root of the mean square error over the sphere relative to that of the exact map, and the largest error relative to the
/// peak. Texels away from the lamp are looked at here and there.
fn against_exact(found: &Cube<Vec3>, lamp: Vec3, exact: impl Fn(Vec3) -> Vec3) -> (f32, f32) {
    let n = found.texels().len();
    let rest = n / 150 + 1;
    let (mut squares, mut all, mut worst, mut peak) = (0.0, 0.0, 0.0f32, 0.0f32);
    for index in 0..n {
        let direction = found.direction(index);
        let step = match direction.angle_between(lamp) {
            near if near < 0.15 => n / 3000 + 1,
            near if near < 0.5 => n / 600 + 1,
            _ => rest,
        };
        if index % step != 0 {
            continue;
        }
        let exact = exact(direction);
        let error = found.texels()[index] - exact;
        let share = step as f32 * found.solid_angle(index);
        squares += share * error.length_squared();
        all += share * exact.length_squared();
        worst = worst.max(error.abs().max_element());
        peak = peak.max(exact.max_element());
    }
    ((squares / all).sqrt(), worst / peak)
}

// ---- downsample ------------------------------------------------------------------------------------------------------

#[test]
fn mips_hold_all_the_light_and_equal_their_twins() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = ggx(gpu);
    for lamp in LAMPS {
        let environment = lamp_room(lamp.normalize(), 0.026);
        maps.make(&environment);
        let mut twin = environment.clone();
        let all = energy(&environment);
        for mip in 1..ENVIRONMENT_MIPS {
            twin = reference::downsample::halved(&twin);
            let found = read_cube(&maps.stage.gpu, &maps.stage.environments.radiance, mip).map(|t| t.xyz());
            let ratio = energy(&found) / all;
            // Half floats: 2^-11; solid angles at the centre of a texel instead of over it: as much.
            assert!(
                (ratio - 1.0).abs() < 5e-4,
                "mip {mip}, lamp {lamp}: {ratio} of the light"
            );
            let differences = found.texels().iter().zip(twin.texels());
            let errors = Errors::of(
                &format!("mip {mip}, lamp {lamp}"),
                differences.map(|(a, b)| ((*a - *b) / *b).abs().max_element()),
            );
            assert!(errors.worst < 1.5e-3, "mip {mip}, lamp {lamp}: {errors:?}");
        }
    }
}

#[test]
fn the_light_tree_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = ggx(gpu);
    let mut environment = lamp_room(LAMP, 0.026);
    // A black face: its nodes have a direction all the same.
    for texel in environment.texels_mut().iter_mut().take(128 * 128) {
        *texel = Vec3::ZERO;
    }
    maps.make(&environment);
    let bytes = u64::from(node_count()) * size_of::<GpuNode>() as u64;
    let found: Vec<GpuNode> = read_buffer(&maps.stage, &maps.stage.environments.nodes, bytes);
    let twin = LightTree::new(&environment);
    let pairs = || found.iter().zip(&twin.nodes);
    let power = |(a, b): (&GpuNode, &_)| -> f32 {
        let b: &mirrorball_render::light_tree::Node = b;
        (a.power.xyz() - b.power).abs().max_element() / b.power.max_element().max(1e-9)
    };
    let errors = Errors::of("power", pairs().map(power));
    assert!(errors.worst < 1e-3, "{errors:?}");
    let errors = Errors::of(
        "direction, rad",
        pairs().map(|(a, b)| a.direction.xyz().distance(b.direction)),
    );
    assert!(errors.worst < 1e-4, "{errors:?}");
    let errors = Errors::of(
        "deviation, rad",
        pairs().map(|(a, b)| a.power.w.sqrt() - b.variance.sqrt()),
    );
    // The mean direction's length has 24 bits: variances of leaves to 6e-8 of 8e-5.
    assert!(errors.worst < 2e-4, "{errors:?}");
}

// ---- prefilter_specular, prefilter_phong -----------------------------------------------------------------------------

#[test]
fn a_white_furnace_stays_white_in_every_lobe() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = ggx(gpu);
    let white = Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE);
    maps.make(&white);
    let assert_white = |maps: &Maps, name: &str| {
        for mip in 0..ENVIRONMENT_MIPS {
            let cube = maps.specular(mip);
            let errors = Errors::of(
                &format!("furnace, {name}, mip {mip}"),
                cube.texels().iter().map(|t| (*t - 1.0).abs().max_element()),
            );
            // Half floats near 1 are 2^-10 apart.
            assert!(errors.worst <= 0.001, "{name}, mip {mip}: {errors:?}");
        }
    };
    assert_white(&maps, "GGX");
    let mut phong = Maps::new(maps.stage.gpu, DiffuseMethod::Lights, SpecularMethod::Phong);
    phong.make(&white);
    assert_white(&phong, "Phong");
}

/// Asserts the figures of a chain of mips against brute force: energy and root mean square, both as shares.
fn assert_mips(maps: &Maps, environment: &Cube<Vec3>, lamp: Vec3, exact: impl Fn(&Texels, u32, Vec3) -> Vec3) {
    let texels = Texels::new(environment);
    for mip in 1..ENVIRONMENT_MIPS {
        let found = maps.specular(mip);
        // Few texels sum the sphere coarsely, a cosine over 4 × 4 a face by a per cent: there the same sum of the exact map.
        let all = if found.size() > 16 {
            energy(environment)
        } else {
            energy(&cube_of(found.size(), |d| exact(&texels, mip, d)))
        };
        // The lobe depends on the angle alone, so over the sphere it moves light and loses none.
        let ratio = energy(&found) / all;
        let (rms, worst) = against_exact(&found, lamp, |d| exact(&texels, mip, d));
        println!("mip {mip}, lamp {lamp}: energy {ratio}, rms {rms}, worst {worst}");
        assert!(
            (ratio - 1.0).abs() < 0.003,
            "mip {mip}, lamp {lamp}: {ratio} of the energy"
        );
        assert!(
            rms < 0.005 && worst < 0.008,
            "mip {mip}, lamp {lamp}: rms {rms}, worst {worst}"
        );
    }
}

#[test]
fn ggx_lobes_equal_brute_force_with_a_lamp_anywhere() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = ggx(gpu);
    let exact = |texels: &Texels, mip, d| reference::prefilter_specular::radiance(texels, alpha_of_mip(mip), d);
    for (lamp, radius_rad) in LAMPS.into_iter().zip([0.026, 0.052, 0.026, 0.026]) {
        let lamp = lamp.normalize();
        let environment = lamp_room(lamp, radius_rad);
        maps.make(&environment);
        assert_mips(&maps, &environment, lamp, exact);
    }
    let environment = smooth_room();
    maps.make(&environment);
    assert_mips(&maps, &environment, LAMP, exact);
}

#[test]
fn phong_lobes_equal_brute_force() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::Lights, SpecularMethod::Phong);
    let exact = |texels: &Texels, mip, d| reference::prefilter_phong::radiance(texels, exponent_of_mip(mip), d);
    for environment in [lamp_room(LAMP, 0.026), smooth_room()] {
        maps.make(&environment);
        assert_mips(&maps, &environment, LAMP, exact);
    }
}

#[test]
fn exponents_follow_mips_and_roughness() {
    assert_eq!([1, 2, 3, 4, 5].map(exponent_of_mip), [256.0, 64.0, 16.0, 4.0, 1.0]);
    // A Phong lobe and Beckmann's of small alpha fall off alike: cosⁿ θ against D(θ / 2).
    for roughness in [0.2f32, 0.3] {
        let (n, alpha) = (exponent_of_roughness(roughness), roughness * roughness);
        let angle_rad = alpha;
        let phong = angle_rad.cos().powf(n);
        let half = (0.5 * angle_rad).tan() / alpha;
        let beckmann = (-half * half).exp();
        assert!(
            (phong - beckmann).abs() < 0.003,
            "roughness {roughness}: {phong}, {beckmann}"
        );
    }
}

#[test]
fn highlights_are_what_is_brighter_than_the_threshold() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::Lights, SpecularMethod::Highlight);
    let environment = lamp_room(LAMP, 0.026);
    maps.make(&environment);
    let threshold = LightConfig::default().highlight_threshold;
    let twin = reference::highlight::darkened(&environment, threshold);
    assert!(
        twin.texels().iter().filter(|t| **t == Vec3::ZERO).count() > 98_000,
        "the room is not dark"
    );
    let errors = Errors::of(
        "highlight",
        maps.specular(0)
            .texels()
            .iter()
            .zip(twin.texels())
            .map(|(a, b)| (*a - *b).abs().max_element() / b.max_element().max(1.0)),
    );
    assert!(errors.worst < 1e-3, "{errors:?}");
    let exact = |texels: &Texels, mip, d| reference::prefilter_phong::radiance(texels, exponent_of_mip(mip), d);
    assert_mips(&maps, &twin, LAMP, exact);
    // Nothing of a room without lamps.
    maps.make(&smooth_room());
    for mip in 0..ENVIRONMENT_MIPS {
        assert!(
            maps.specular(mip).texels().iter().all(|t| t.max_element() < 1e-6),
            "mip {mip}"
        );
    }
}

// ---- irradiance_cube, harmonics --------------------------------------------------------------------------------------

/// Light whose irradiance is known: name, radiance, irradiance.
type KnownLight = (&'static str, fn(Vec3) -> f32, fn(Vec3) -> f32);
const GRADIENT: Vec3 = Vec3::new(0.2, -0.4, 0.3);
const KNOWN: [KnownLight; 3] = [
    ("uniform", |_| 1.0, |_| PI),
    (
        "gradient",
        |d| 1.0 + GRADIENT.dot(d),
        |n| PI + 2.0 * PI / 3.0 * GRADIENT.dot(n),
    ),
    (
        "hemisphere",
        |d| if d.y > 0.0 { 1.0 } else { 0.0 },
        |n| PI / 2.0 * (1.0 + n.y),
    ),
];

#[test]
fn the_irradiance_cube_of_known_light_is_exact() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::CosineCube, SpecularMethod::SphereMap);
    for (name, radiance, irradiance) in KNOWN {
        maps.make(&cube_of(ENVIRONMENT_SIZE, |d| Vec3::splat(radiance(d))));
        let found = maps.irradiance();
        let errors = (0..found.texels().len()).map(|i| (found.texels()[i].x - irradiance(found.direction(i))) / PI);
        let errors = Errors::of(name, errors);
        assert!(errors.mean < 1e-3 && errors.worst < 3e-3, "{name}: {errors:?}");
    }
    // One texel of irradiance 1: the cosine itself.
    let grid = Cube::filled(ENVIRONMENT_SIZE, 0u8);
    let lit = grid.index_of(LAMP);
    let (at, area_sr) = (grid.direction(lit), grid.solid_angle(lit));
    maps.make(&cube_of(ENVIRONMENT_SIZE, |d| {
        Vec3::splat(if d == at { 1.0 / area_sr } else { 0.0 })
    }));
    let found = maps.irradiance();
    let cosine = |i: usize| found.direction(i).dot(at).max(0.0);
    let errors = Errors::of(
        "delta light",
        (0..found.texels().len()).map(|i| found.texels()[i].x - cosine(i)),
    );
    assert!(errors.mean < 1e-3 && errors.worst < 2e-3, "{errors:?}");
}

#[test]
fn the_irradiance_cube_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::CosineCube, SpecularMethod::SphereMap);
    for (name, environment) in [("lamp", lamp_room(LAMP, 0.052)), ("room", smooth_room())] {
        maps.make(&environment);
        let texels = Texels::new(&environment);
        let exact = |d| reference::irradiance_cube::irradiance(&texels, d);
        let (rms, worst) = against_exact(&maps.irradiance(), LAMP, exact);
        println!("irradiance, {name}: rms {rms}, worst {worst}");
        assert!(rms < 0.002 && worst < 0.004, "{name}: rms {rms}, worst {worst}");
    }
}

#[test]
fn harmonics_of_known_light_are_exact() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::Sh9, SpecularMethod::SphereMap);
    for (name, radiance, irradiance) in KNOWN {
        maps.make(&cube_of(ENVIRONMENT_SIZE, |d| Vec3::splat(radiance(d))));
        let found = maps.harmonics();
        if name == "uniform" {
            let c00 = found.coefficients[0].x;
            assert!((c00 - 3.544_908).abs() < 1e-5, "c00 is {c00}");
        }
        let errors = support::directions(50).map(|n| (found.irradiance(n).x - irradiance(n)) / PI);
        let errors = Errors::of(name, errors);
        assert!(errors.worst < 1e-3, "{name}: {errors:?}");
    }
    let grid = Cube::filled(ENVIRONMENT_SIZE, 0u8);
    let lit = grid.index_of(LAMP);
    let (at, area_sr) = (grid.direction(lit), grid.solid_angle(lit));
    maps.make(&cube_of(ENVIRONMENT_SIZE, |d| {
        Vec3::splat(if d == at { 1.0 / area_sr } else { 0.0 })
    }));
    let delta = maps.harmonics();
    // The band-limited cosine lobe.
    for (normal, exact) in [(at, 1.0625), (at.any_orthonormal_vector(), 0.09375), (-at, 0.0625)] {
        let found = delta.irradiance(normal).x;
        assert!((found - exact).abs() < 1e-3, "delta light: {found}, not {exact}");
    }
}

#[test]
fn harmonics_equal_their_twin() {
    let Some(gpu) = support::gpu() else { return };
    let mut maps = Maps::new(gpu, DiffuseMethod::Sh9, SpecularMethod::SphereMap);
    for (name, environment) in [("lamp", lamp_room(LAMP, 0.052)), ("room", smooth_room())] {
        maps.make(&environment);
        let twin = IrradianceSh::from_cube(&environment);
        let found = maps.harmonics();
        let differences = found.coefficients.iter().zip(&twin.coefficients);
        let errors = Errors::of(
            name,
            differences.map(|(a, b)| (*a - *b).abs().max_element() / twin.coefficients[0].max_element()),
        );
        assert!(errors.worst < 1e-3, "{name}: {errors:?}");
    }
}

// ---- irradiance (of near things) -------------------------------------------------------------------------------------

#[test]
fn near_light_counts_near_things_alone_and_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    let mut stage = environment_stage(gpu);
    let environment = smooth_room();
    let hit_m = cube_of(ENVIRONMENT_SIZE, |d| if d.z < 0.1 { 0.2 } else { NOTHING_M });
    support::write_texture(
        &stage.gpu,
        &stage.environments.radiance,
        &halves(environment.texels().iter().map(|t| t.extend(1.0))),
    );
    stage.gpu.write(&stage.environments.slots[0].hit_m, hit_m.texels());
    let pass = Irradiance::new(&stage.gpu, &stage.environments);
    let mut encoder = stage
        .gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut stage.timer);
    stage.gpu.queue.submit([encoder.finish()]);
    let found = harmonics_in(&stage, &stage.environments.near_sh);
    let twin = reference::irradiance::near_light(&environment, &hit_m);
    let differences = found.coefficients.iter().zip(&twin.coefficients);
    let errors = Errors::of(
        "near light",
        differences.map(|(a, b)| (*a - *b).abs().max_element() / twin.coefficients[0].x),
    );
    // Solid angles at the texel's centre instead of over it: 1 part in 6 · 128².
    assert!(errors.worst < 5e-4, "{errors:?}");
}

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
        let scene = support::scene([("sphere", mirrorball_render::scene::Kind::Virtual, sphere)]);
        let stage = Stage::new(gpu, &rig, &scene, [64, 1]);
        let config = LightConfig {
            diffuse,
            specular,
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
        // Half of the light from the matt part, and what Karis' fit of the split sum leaves of half a mirror of this
        // roughness, at any angle: 1 - 0.55 roughness (shared/brdf.wgsl).
        let expected = 0.5 + 0.5 * (1.0 - 0.55 * 0.5);
        let brightness = inside.iter().map(|p| p.x).sum::<f32>() / inside.len() as f32;
        assert!(
            (brightness - expected).abs() < 0.005,
            "{diffuse:?}, {specular:?}: {brightness}, not {expected}"
        );
        gpu = lit.stage.gpu;
    }
}
