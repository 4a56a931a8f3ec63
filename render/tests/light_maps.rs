//! Maps of light against their CPU twins, against brute force, or against light whose answer is known; those for
//! comparison are in `comparison_maps.rs`.

mod support;

use std::f32::consts::PI;

use glam::{Vec3, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::sh::IrradianceSh;
use mirrorball_render::config::{DiffuseMethod, LightConfig, SpecularMethod};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::types::GpuNode;
use mirrorball_render::light_tree::{LightTree, Node, node_count};
use mirrorball_render::passes::irradiance::Irradiance;
use mirrorball_render::passes::prefilter_phong::{exponent_of_mip, exponent_of_roughness};
use mirrorball_render::passes::prefilter_specular::alpha_of_mip;
use mirrorball_render::passes::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE};
use mirrorball_render::probe::surroundings::NOTHING_M;
use mirrorball_render::reference;
use mirrorball_render::reference::lobe_sum::Texels;
use support::maps::{LAMP, Maps, harmonics_in, lamp_room, read_buffer, smooth_room};
use support::stage::environment_stage;
use support::{Errors, cube_of, halves, read_cube};

/// Lamps in the middle of a face, at an edge, at a corner, and anywhere.
const LAMPS: [Vec3; 4] = [Vec3::new(0.0, 0.01, 1.0), Vec3::new(0.1, -1.0, 1.0), Vec3::ONE, LAMP];

/// A GGX map and no other.
fn ggx(gpu: Gpu) -> Maps {
    Maps::new(gpu, DiffuseMethod::Lights, SpecularMethod::Ggx)
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
        if !index.is_multiple_of(step) {
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
    let power = |(a, b): (&GpuNode, &Node)| -> f32 {
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
#[expect(clippy::print_stdout, reason = "figures, kept by the test runner unless asked for")]
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
