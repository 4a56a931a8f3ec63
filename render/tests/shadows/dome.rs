//! Domes against rays.

use glam::Vec3;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::lab::{Lab, LabFrame, MAP_SIZE};
use mirrorball_render::reference::dome_maps::stored_depth;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::scene_gpu::SceneBuffers;
use mirrorball_render::shadow::casters::Casters;
use mirrorball_render::shadow::dome::{DomeCasters, DomeLight, DomeMaps, MapsJob, hemisphere};
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::shadow_view::ShadowView;
use mirrorball_render::shadow::view::View;
use mirrorball_render::shadow::{Family, ShadowMethod};

use crate::blocks;

const SIZE_PX: [u32; 2] = [96, 72];

fn block_on_floor() -> Lab {
    let block = blocks::block(Vec3::new(-0.1, -0.1, 0.0), Vec3::new(0.1, 0.1, 0.2));
    let bar = blocks::block(Vec3::new(-0.3, 0.25, 0.15), Vec3::new(0.3, 0.3, 0.2));
    let (scene, placements) = blocks::scene_of(&[("floor", blocks::floor(1.2)), ("block", block), ("bar", bar)]);
    let view = View::looking_at(Vec3::new(0.5, -0.8, 0.7), Vec3::new(0.0, 0.0, 0.05), 0.8, SIZE_PX);
    Lab::new(Gpu::open().unwrap(), scene, placements, &view).unwrap()
}

fn frame(method: ShadowMethod, light: &ShadowLight, ambient: f32) -> LabFrame<'_> {
    LabFrame {
        method,
        map_size: MAP_SIZE,
        light,
        ambient: Vec3::splat(ambient),
        refreshes_max: usize::MAX,
    }
}

const NO_LIGHT: ShadowLight = ShadowLight::Directional {
    towards: Vec3::Z,
    irradiance: Vec3::ZERO,
};

/// Irradiance of a uniform sky of radiance 1 by many rays over the upper hemisphere.
fn sky_by_rays(occluders: &Occluders, point: Vec3, normal: Vec3, n: u32) -> f32 {
    let from = point + 1e-4 * normal;
    let share = 2.0 * std::f32::consts::PI / n as f32;
    let of = |d: Vec3| {
        if d.dot(normal) > 0.0 && !occluders.blocks(from, from + 10.0 * d) {
            d.dot(normal) * share
        } else {
            0.0
        }
    };
    hemisphere(n).into_iter().map(of).sum()
}

/// Peak signal-to-noise ratio of the irradiance on the floor, dB, peak π; and the worst error.
fn error_on_floor(lab: &mut Lab, method: ShadowMethod) -> (f64, f32) {
    lab.draw(&frame(method, &NO_LIGHT, 1.0)).unwrap();
    let occluders = Occluders::new(lab.casters().triangles());
    let (found, places) = (lab.visibility().unwrap(), lab.places().unwrap());
    let (mut sum, mut n, mut worst) = (0.0f64, 0u32, 0.0f32);
    for (index, place) in places.iter().enumerate() {
        if place.w > 0.0 && place.z.abs() < 1e-4 && index % 3 == 0 {
            let expected = sky_by_rays(&occluders, place.truncate(), Vec3::Z, 1024);
            let error = (found[index] - expected) / std::f32::consts::PI;
            sum += f64::from(error * error);
            worst = worst.max(error.abs());
            n += 1;
        }
    }
    assert!(n > 500);
    (-10.0 * (sum / f64::from(n)).log10(), worst)
}

#[test]
fn under_a_uniform_sky_the_floor_gets_what_rays_say() {
    let mut lab = block_on_floor();
    for (method, least_db) in [
        (ShadowMethod::Dome16, 24.0),
        (ShadowMethod::Dome64, 32.0),
        (ShadowMethod::Dome256, 36.0),
        (ShadowMethod::AmbientOcclusion, 34.0),
        (ShadowMethod::Stable, 34.0),
    ] {
        let (db, worst) = error_on_floor(&mut lab, method);
        println!("{}: {db:.1} dB, worst {worst:.3}", method.name());
        assert!(db > least_db, "{}: {db:.1} dB, worst {worst:.3}", method.name());
    }
}

#[test]
fn nothing_in_the_way_means_the_whole_light() {
    let (scene, placements) = blocks::scene_of(&[("floor", blocks::floor(1.0))]);
    let view = View::looking_at(Vec3::new(0.0, -0.6, 0.6), Vec3::ZERO, 0.8, SIZE_PX);
    let mut lab = Lab::new(Gpu::open().unwrap(), scene, placements, &view).unwrap();
    for method in ShadowMethod::ALL.into_iter().filter(|m| m.family() == Family::Dome) {
        lab.draw(&frame(method, &NO_LIGHT, 0.5)).unwrap();
        let (found, places) = (lab.visibility().unwrap(), lab.places().unwrap());
        for (irradiance, place) in found.iter().zip(&places).filter(|(_, place)| place.w > 0.0) {
            let expected = 0.5 * std::f32::consts::PI;
            assert!(
                (irradiance / expected - 1.0).abs() < 0.04,
                "{}: {irradiance} at {place}",
                method.name()
            );
        }
    }
}

#[test]
fn one_map_a_frame_comes_to_the_same_in_the_end() {
    let lamp = |x: f32| ShadowLight::Point {
        position_m: Vec3::new(x, 0.2, 1.0),
        intensity: Vec3::splat(3.0),
    };
    let (first, second) = (lamp(0.3), lamp(-0.4));
    let mut lab = block_on_floor();
    lab.draw(&frame(ShadowMethod::Stable, &first, 0.1)).unwrap();
    for _ in 0..200 {
        let slow = LabFrame {
            refreshes_max: 1,
            ..frame(ShadowMethod::Stable, &second, 0.1)
        };
        lab.draw(&slow).unwrap();
    }
    let slow = lab.visibility().unwrap();
    let mut lab = block_on_floor();
    lab.draw(&frame(ShadowMethod::Stable, &second, 0.1)).unwrap();
    let at_once = lab.visibility().unwrap();
    let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
    let differences: Vec<f32> = slow.iter().zip(&at_once).map(|(a, b)| (a - b).abs()).collect();
    assert!(
        mean(&differences) < 0.02 * mean(&at_once),
        "{} of {}",
        mean(&differences),
        mean(&at_once)
    );
}

#[test]
fn maps_hold_the_depths_that_rays_find() {
    const SIZE: u32 = 128;
    let gpu = Gpu::open().unwrap();
    let block = blocks::block(Vec3::new(-0.1, -0.1, 0.0), Vec3::new(0.1, 0.1, 0.2));
    let (scene, placements) = blocks::scene_of(&[("floor", blocks::floor(1.0)), ("block", block)]);
    let buffers = SceneBuffers::placed(&gpu, &scene, &placements, f32::INFINITY).unwrap();
    let casters = Casters::new(&gpu, &buffers, (&scene, &placements), |_| true);
    let bounds = casters.bounds();
    // Of ten, those at least 14 degrees over the floor: its depth rises by 4 texels per texel there.
    let lights: Vec<DomeLight> = hemisphere(10)
        .into_iter()
        .filter(|direction| direction.z > 0.25)
        .map(|direction| DomeLight {
            position_m: 3.0 * direction,
            intensity: Vec3::ONE,
            angular_radius_rad: 0.1,
        })
        .collect();
    let n = lights.len() as u32;
    let small = DomeCasters::new(&gpu, &casters, 2.0 * bounds.radius_m / SIZE as f32).unwrap();
    let mut maps = DomeMaps::new(&gpu, &buffers, small, [n, SIZE]).unwrap();
    let job = MapsJob {
        lights: &lights,
        receivers: bounds,
        everything: bounds,
        is_moved: false,
        refreshes_max: usize::MAX,
    };
    let readback = Readback::new(&gpu, "maps", u64::from(n * SIZE * SIZE * 4));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let mut timer = Timer::new(&gpu);
    assert_eq!(maps.record(&gpu, &mut encoder, &mut timer, &job), 0..n as usize);
    encoder.copy_buffer_to_buffer(maps.maps(), 0, readback.buffer(), 0, None);
    readback.record(&mut encoder);
    assert_eq!(
        maps.record(&gpu, &mut encoder, &mut timer, &job),
        0..0,
        "maps that show what they should are kept"
    );
    gpu.queue.submit([encoder.finish()]);
    let mut drawn = vec![0.0f32; (n * SIZE * SIZE) as usize];
    readback.read(&gpu, &mut drawn).unwrap();
    let occluders = Occluders::new(casters.triangles());
    for (light, drawn) in lights.iter().zip(drawn.chunks_exact((SIZE * SIZE) as usize)) {
        let view = ShadowView::new(light.position_m, (bounds, bounds), SIZE);
        let cast = stored_depth(&view, &occluders, SIZE);
        let [near_m, far_m] = view.depth_m;
        let metres = |stored: f32| near_m * far_m / (far_m - (1.0 - stored) * (far_m - near_m));
        let differ = drawn
            .iter()
            .zip(&cast)
            .filter(|(a, b)| (**a > 0.0) != (**b > 0.0))
            .count();
        assert!(
            differ < drawn.len() / 100,
            "{differ} texels differ in whether anything is there"
        );
        let both: Vec<f32> = drawn
            .iter()
            .zip(&cast)
            .filter(|(a, b)| **a > 0.0 && **b > 0.0)
            .map(|(a, b)| (metres(*a) - metres(*b)) / view.texel_m)
            .collect();
        // The drawn map lies deeper by half a texel's slope.
        let off = both.iter().filter(|e| **e < -0.1 || **e > 8.0).count();
        assert!(off < both.len() / 100, "{off} of {} texels are off", both.len());
    }
}
