//! Shadow maps, compared once or filtered, against rays.

use glam::{Affine3A, Vec3};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::scene::Mesh;
use mirrorball_render::scene_gpu::SceneBuffers;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::casters::Casters;
use mirrorball_render::shadow::key::Job;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::surface::SurfacePass;
use mirrorball_render::shadow::view::View;

use crate::blocks::{block, floor, scene_of};
use crate::truth::{self, Seen};

const EYE_M: Vec3 = Vec3::new(1.0, -1.6, 1.2);
const FILTERED: [ShadowMethod; 4] = [
    ShadowMethod::Map,
    ShadowMethod::Pcf9,
    ShadowMethod::Pcf25,
    ShadowMethod::Pcf49,
];

/// A cube, a thin pole and a low slab on a floor of 2 m before a wall.
fn things() -> Vec<(&'static str, Mesh)> {
    vec![
        ("floor", floor(2.0)),
        ("wall", block(Vec3::new(-0.9, 0.7, 0.0), Vec3::new(0.9, 0.75, 0.8))),
        ("cube", block(Vec3::new(-0.3, -0.2, 0.0), Vec3::new(0.0, 0.1, 0.3))),
        ("pole", block(Vec3::new(0.3, -0.1, 0.0), Vec3::new(0.34, -0.06, 0.6))),
        ("slab", block(Vec3::new(0.1, -0.7, 0.02), Vec3::new(0.4, -0.4, 0.06))),
    ]
}

fn seen(meshes: &[(&'static str, Mesh)], light: &ShadowLight, method: ShadowMethod) -> Seen {
    let view = View::looking_at(EYE_M, Vec3::new(0.0, 0.0, 0.15), 0.9, [96, 72]);
    truth::draw(&mut truth::lab(meshes, &view), light, (method, 1024), EYE_M)
}

fn point(position_m: Vec3) -> ShadowLight {
    ShadowLight::Point {
        position_m,
        intensity: Vec3::ONE,
    }
}

fn sun(towards: Vec3) -> ShadowLight {
    ShadowLight::Directional {
        towards: towards.normalize(),
        irradiance: Vec3::ONE,
    }
}

fn spot(position_m: Vec3, outer_rad: f32) -> ShadowLight {
    ShadowLight::Spot {
        position_m,
        axis: (Vec3::new(0.0, 0.0, 0.1) - position_m).normalize(),
        cone_rad: [0.8 * outer_rad, outer_rad],
        intensity: Vec3::ONE,
    }
}

fn rect(center_m: Vec3) -> ShadowLight {
    ShadowLight::Rect {
        center_m,
        half_u_m: Vec3::new(0.1, 0.0, 0.0),
        half_v_m: Vec3::new(0.0, -0.1, 0.0),
        radiance: Vec3::ONE,
    }
}

#[test]
fn a_hard_map_agrees_with_rays() {
    // Far away, near, and inside what casts; cones narrow and wide.
    let near = Vec3::new(-0.6, -0.5, 1.1);
    let lights = [
        (sun(Vec3::new(-0.5, -0.3, 0.8)), 0.008),
        (point(Vec3::new(-2.0, -1.5, 3.0)), 0.008),
        (point(near), 0.012),
        (point(Vec3::new(0.15, -0.3, 0.4)), 0.008),
        (spot(Vec3::new(-0.6, -0.5, 1.5), 0.7), 0.008),
        (spot(near, 1.3), 0.012),
    ];
    for (light, rim_m) in lights {
        let mut inside = seen(&things(), &light, ShadowMethod::Map);
        let is_in_cone = |place: Vec3| match light {
            ShadowLight::Spot {
                position_m,
                axis,
                cone_rad,
                ..
            } => (place - position_m).normalize().dot(axis) > cone_rad[1].cos(),
            _ => true,
        };
        for surface in &mut inside.surfaces {
            *surface = surface.filter(|(place, _)| is_in_cone(*place));
        }
        let (n, n_right) = inside.agreement(&light, rim_m, 0.0);
        assert!(
            n > 2000 && n_right as f64 >= 0.998 * n as f64,
            "{light:?}: {n_right} of {n}"
        );
    }
}

#[test]
fn a_rectangles_hard_shadow_is_that_of_its_middle() {
    let center_m = Vec3::new(-0.4, -0.3, 1.3);
    let seen = seen(&things(), &rect(center_m), ShadowMethod::Map);
    let (n, n_right) = seen.agreement(&point(center_m), 0.01, 0.0);
    assert!(n > 2000 && n_right as f64 >= 0.998 * n as f64, "{n_right} of {n}");
}

#[test]
fn grazing_light_leaves_no_acne() {
    let things = [
        ("floor", floor(2.0)),
        ("wall", block(Vec3::new(-1.0, 0.9, 0.0), Vec3::new(1.0, 0.95, 0.8))),
    ];
    for light in [
        sun(Vec3::new(0.6, -0.8, 0.09)),
        sun(Vec3::new(0.99, -0.09, 0.09)),
        point(Vec3::new(-1.5, -0.9, 0.12)),
        point(Vec3::new(0.4, 0.8, 0.1)),
    ] {
        for (method, taps) in FILTERED.into_iter().zip([1.0, 3.0, 5.0, 7.0]) {
            let mut seen = seen(&things, &light, method);
            // Texels of 3 mm: a filter that reaches beyond a corner darkens a line.
            let is_corner = |place: Vec3| (place.y - 0.9).hypot(place.z) < 0.005 * taps;
            for surface in &mut seen.surfaces {
                *surface = surface.filter(|(place, _)| taps == 1.0 || !is_corner(*place));
            }
            // They are eleven times as long where the light grazes.
            let (n, n_right) = seen.agreement(&light, 0.015 * (taps + 1.0), 1e-3);
            assert!(n > 1000 && n_right == n, "{method:?} {light:?}: {n_right} of {n}");
        }
    }
}

#[test]
fn a_shadow_begins_at_the_foot_of_what_stands() {
    // The sun from -x: shadow from the cube's face at x = 0 on. Texels of 2.3 mm, pixels of 0.7 mm.
    let light = sun(Vec3::new(-1.0, 0.0, 0.8));
    let things = [
        ("floor", floor(1.6)),
        ("cube", block(Vec3::new(-0.3, -0.3, 0.0), Vec3::new(0.0, 0.3, 0.3))),
    ];
    let eye_m = Vec3::new(0.5, 0.0, 0.5);
    let view = View::looking_at(eye_m, Vec3::new(0.02, 0.0, 0.0), 0.06, [64, 64]);
    let mut lab = truth::lab(&things, &view);
    for method in FILTERED {
        let seen = truth::draw(&mut lab, &light, (method, 1024), eye_m);
        let mut n = 0;
        for (visibility, surface) in seen.visibility.iter().zip(&seen.surfaces) {
            if let Some((place, normal)) = surface
                && normal.z > 0.5
                && place.x > 0.0
            {
                n += 1;
                assert!(*visibility == 0.0, "{method:?}: {visibility} at {place}");
            }
        }
        assert!(n > 1000, "{n}");
    }
}

#[test]
fn a_filter_is_as_wide_as_its_taps() {
    // Overhead sun, a plate's edge at x = 0, seen from beside it.
    let light = sun(Vec3::new(-0.5, 0.0, 1.0));
    let things = [
        ("floor", floor(2.0)),
        ("plate", block(Vec3::new(-0.8, -0.8, 0.2), Vec3::new(0.0, 0.8, 0.22))),
    ];
    let eye_m = Vec3::new(0.1, 0.0, 1.0);
    let view = View::looking_at(eye_m, Vec3::new(0.1, 0.0, 0.0), 0.08, [128, 128]);
    let mut lab = truth::lab(&things, &view);
    // Texels are square to the light; on the floor they are longer.
    let texel_m = 2.0 * lab.casters().bounds().radius_m / 1024.0 * 1.25f32.sqrt();
    for (method, taps) in FILTERED.into_iter().zip([1.0f32, 3.0, 5.0, 7.0]).skip(1) {
        let seen = truth::draw(&mut lab, &light, (method, 1024), eye_m);
        let (positions, ramp): (Vec<f32>, Vec<f32>) = profile(&seen).into_iter().unzip();
        let width_m = crossing(&positions, &ramp, 0.9) - crossing(&positions, &ramp, 0.1);
        // From 10 % to 90 % of the ramp.
        let expected_m = 0.8 * taps * texel_m;
        assert!(
            (width_m / expected_m - 1.0).abs() < 0.05,
            "{method:?}: {width_m} {expected_m}"
        );
    }
}

/// Mean visibility of the floor by x, in order.
pub(crate) fn profile(seen: &Seen) -> Vec<(f32, f32)> {
    let mut by_x: Vec<(f32, f32)> = Vec::new();
    let mut points: Vec<(f32, f32)> = seen
        .surfaces
        .iter()
        .zip(&seen.visibility)
        .filter_map(|(surface, &share)| {
            surface
                .filter(|(place, _)| place.z.abs() < 1e-3)
                .map(|(place, _)| (place.x, share))
        })
        .collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    for chunk in points.chunks(points.len().div_ceil(100).max(1)) {
        let n = chunk.len() as f32;
        by_x.push((
            chunk.iter().map(|p| p.0).sum::<f32>() / n,
            chunk.iter().map(|p| p.1).sum::<f32>() / n,
        ));
    }
    by_x
}

/// Where a rising ramp first reaches a share.
pub(crate) fn crossing(positions: &[f32], ramp: &[f32], share: f32) -> f32 {
    let after = ramp.iter().position(|&s| s >= share).unwrap();
    assert!(after > 0, "the ramp starts above {share}");
    let (low, high) = (ramp[after - 1], ramp[after]);
    positions[after - 1] + (positions[after] - positions[after - 1]) * (share - low) / (high - low)
}

#[test]
fn a_light_inside_a_thing_lights_nothing_outside() {
    let things = [
        ("floor", floor(2.0)),
        ("cube", block(Vec3::new(-0.3, -0.3, 0.0), Vec3::new(0.3, 0.3, 0.6))),
        ("far", block(Vec3::new(0.5, 0.5, 0.0), Vec3::new(0.7, 0.7, 0.3))),
    ];
    let inside = Vec3::new(0.05, 0.02, 0.3);
    for light in [point(inside), rect(inside), spot(inside, 1.3)] {
        for method in [ShadowMethod::Map, ShadowMethod::Pcf49, ShadowMethod::Pcss] {
            let seen = seen(&things, &light, method);
            let is_told = |place: Vec3| match light {
                ShadowLight::Spot { position_m, axis, .. } => (place - position_m).normalize().dot(axis) > 1.3f32.cos(),
                // Beyond 76 degrees from its normal a rectangle's map ends.
                ShadowLight::Rect { center_m, .. } => {
                    let offset = (place - center_m).abs();
                    place.z < center_m.z && offset.x.max(offset.y) < 3.9 * offset.z
                }
                _ => true,
            };
            let (mut sum, mut n) = (0.0, 0u16);
            for (visibility, surface) in seen.visibility.iter().zip(&seen.surfaces) {
                if let Some((place, _)) = surface
                    && is_told(*place)
                    && place.truncate().abs().max_element() > 0.3 + 0.05
                {
                    // A filter as wide as the penumbra reaches to where the light's middle sees past the walls.
                    let leak = if method == ShadowMethod::Pcss { 0.25 } else { 0.01 };
                    sum += visibility;
                    n += 1;
                    assert!(*visibility < leak, "{method:?} {light:?}: {visibility} at {place}");
                }
            }
            assert!(
                n > 500 && sum < 0.005 * f32::from(n),
                "{method:?} {light:?}: {sum} of {n}"
            );
        }
    }
}

#[test]
fn a_map_too_large_for_the_adapter_is_made_smaller() {
    let light = sun(Vec3::new(-0.5, -0.3, 0.8));
    let view = View::looking_at(EYE_M, Vec3::ZERO, 0.9, [16, 12]);
    let mut lab = truth::lab(&things(), &view);
    let seen = truth::draw(&mut lab, &light, (ShadowMethod::Map, 1_000_000), EYE_M);
    let (n, n_right) = seen.agreement(&light, 0.005, 0.0);
    assert!(n > 50 && n_right == n, "{n_right} of {n}");
    let smallest = truth::draw(&mut lab, &light, (ShadowMethod::Map, 0), EYE_M);
    assert!(smallest.visibility.iter().all(|v| v.is_finite()));
}

#[test]
fn without_casters_everything_is_lit() {
    let gpu = Gpu::open().unwrap();
    let (scene, placements) = scene_of(&[("floor", floor(2.0))]);
    let buffers = SceneBuffers::placed(&gpu, &scene, &placements, f32::INFINITY).unwrap();
    let [casters, receiving] = [false, true].map(|is| Casters::new(&gpu, &buffers, (&scene, &placements), |_| is));
    let view = View::looking_at(EYE_M, Vec3::ZERO, 0.9, [16, 12]);
    let surface_pass = SurfacePass::new(&gpu);
    let surface = surface_pass.surface(&gpu, &view, &buffers);
    let texture = gpu.target("visibility", TextureShape::plain(view.size_px), RADIANCE_FORMAT);
    let visibility = texture.create_view(&wgpu::TextureViewDescriptor::default());
    for light in [
        sun(Vec3::Z),
        point(Vec3::Z),
        spot(Vec3::new(0.0, 0.1, 1.0), 0.6),
        rect(Vec3::Z),
    ] {
        for method in [ShadowMethod::Map, ShadowMethod::Pcf9, ShadowMethod::Pcss] {
            let mut passes = method.key_shadow(&gpu, 256).unwrap().unwrap();
            let light_buffer = gpu.buffer("light", &[light.to_gpu()]);
            let job = Job {
                surface: &surface,
                scene: &buffers,
                casters: &casters,
                receivers: &receiving,
                light: &light,
                light_buffer: &light_buffer,
                visibility: &visibility,
            };
            let mut timer = Timer::new(&gpu);
            let mut encoder = gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            surface_pass.record(&mut encoder, &mut timer, (&surface, &buffers, &receiving.range));
            passes.record(&gpu, &mut encoder, &mut timer, &job).unwrap();
            gpu.queue.submit([encoder.finish()]);
            gpu.wait("drawing").unwrap();
            let texels = gpu.read_half(&texture).unwrap();
            assert!(texels.iter().all(|texel| texel.x == 1.0), "{method:?} {light:?}");
        }
    }
}

#[test]
fn vertices_that_are_no_numbers_are_left_out() {
    let mut broken = things();
    let mesh = &mut broken[2].1;
    let first = mesh.vertices.len() as u32;
    let mut vertex = mesh.vertices[0];
    vertex.position = [f32::NAN, 0.0, f32::INFINITY];
    mesh.vertices.push(vertex);
    mesh.indices.extend([0, 1, first, first, first, first]);
    let light = sun(Vec3::new(-0.5, -0.3, 0.8));
    let (whole, broken) = (
        seen(&things(), &light, ShadowMethod::Pcf9),
        seen(&broken, &light, ShadowMethod::Pcf9),
    );
    assert_eq!(whole.visibility, broken.visibility);
}

#[test]
fn a_shadow_follows_what_moves() {
    let view = View::looking_at(EYE_M, Vec3::new(0.0, 0.0, 0.15), 0.9, [32, 24]);
    let light = sun(Vec3::new(-0.5, -0.3, 0.8));
    let mut lab = truth::lab(&things(), &view);
    let before = truth::draw(&mut lab, &light, (ShadowMethod::Map, 512), EYE_M);
    let mut placements = vec![Affine3A::IDENTITY; things().len()];
    placements[2] = Affine3A::from_translation(Vec3::new(0.2, -0.4, 0.0));
    lab.place(&placements);
    let after = truth::draw(&mut lab, &light, (ShadowMethod::Map, 512), EYE_M);
    assert_ne!(before.visibility, after.visibility);
    let (n, n_right) = after.agreement(&light, 0.015, 0.0);
    assert!(n > 200 && n_right as f64 >= 0.99 * n as f64, "{n_right} of {n}");
}
