//! Light that near things throw on each other, against form factors whose answer is known, and the memory of real surfaces.

mod support;

use std::f32::consts::PI;

use glam::{Affine3A, DVec3, Vec3, Vec4};
use half::f16;
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::ProbeOptics;
use mirrorball_calib::rig::Rig;
use mirrorball_render::camera_view::CameraView;
use mirrorball_render::config::{LightConfig, ModeConfig, PhantomEdges, Protection, ShadowConfig};
use mirrorball_render::environments::{CubeTexture, Environments};
use mirrorball_render::eye::EyeInputs;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::near::parts::{NO_PART, Parts};
use mirrorball_render::near::{NearInputs, NearThings};
use mirrorball_render::passes::direct::ShadowedLight;
use mirrorball_render::passes::lens_surface::LensSurface;
use mirrorball_render::passes::near_light::{Inputs, NearLight};
use mirrorball_render::scene::{Kind, Material, Mesh, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;
use mirrorball_render::scene_rays::SceneRays;
use mirrorball_render::scene_shadows::SceneShadows;
use mirrorball_render::shadow::dome::hemisphere;
use support::stage::light_of;
use support::{EXPOSURE, Errors, cube_of, occluders, sphere, square};

/// Radiance of the pictures: 0.6 of full scale.
const RADIANCE: f32 = 3.0;
/// The virtual sphere.
const CENTER_M: Vec3 = Vec3::new(0.03, 0.02, 0.08);
const RADIUS_M: f32 = 0.04;

/// Where the camera stands and what it looks at.
fn view_from(from: DVec3, at: DVec3) -> Pose {
    support::looking_at(at, from)
}

fn usual_view() -> Pose {
    view_from(DVec3::new(0.05, -0.30, 0.34), DVec3::new(0.03, 0.0, 0.0))
}

/// Everything that near light takes, around one scene.
struct Bench {
    gpu: Gpu,
    timer: Timer,
    rig: Rig,
    buffers: SceneBuffers,
    rays: SceneRays,
    environments: Environments,
    view: CameraView,
    virtuals: LensSurface,
    probe: CubeTexture,
    parts: Parts,
    near: NearThings,
    shadows: SceneShadows,
}

impl Bench {
    fn new(gpu: Gpu, scene: &Scene) -> Self {
        let rig = support::rig();
        let buffers = SceneBuffers::new(&gpu, scene, &rig).expect("the test scene fits");
        let placements = vec![Affine3A::IDENTITY; scene.objects.len()];
        let rays = SceneRays::new(&gpu, &buffers, &placements).expect("the test scene fits");
        let phantoms = occluders(scene, Kind::Phantom);
        let environments = Environments::new(&gpu, scene, &rig, &phantoms);
        let view = CameraView::new(&gpu, rig.scene_camera(), &buffers);
        let virtuals = LensSurface::new(&gpu, "virtual objects", (&view.camera, &buffers), view.size_px());
        let probe = CubeTexture::new(&gpu, "test: probe", 16);
        let optics = ProbeOptics::of_rig(&rig).expect("the rig has a probe");
        let parts = Parts::new(&buffers, &placements, (&phantoms, &optics));
        let inputs = NearInputs {
            view: &view,
            scene: &buffers,
            environments: &environments,
            probe_radiance: &probe.view,
        };
        let near = NearThings::new(&gpu, inputs, &parts);
        let config = ShadowConfig {
            map_size: 64,
            dome_lights: 1,
            bright_lights: 1,
            ..ShadowConfig::default()
        };
        let shadows = SceneShadows::new(&gpu, (scene, &buffers), &rig, config).expect("the test scene fits");
        Self {
            timer: Timer::new(&gpu),
            gpu,
            rig,
            buffers,
            rays,
            environments,
            view,
            virtuals,
            probe,
            parts,
            near,
            shadows,
        }
    }

    /// Shows pictures of one radiance everywhere, the camera's and the probe's, with these lights from afar, and takes them in.
    fn look(&mut self, pose: &Pose, [radiance, at_probe]: [f32; 2], lights: &[KeyLight]) {
        let camera = self.rig.scene_camera();
        let frame = support::frame(camera, 1, 1, |_| DVec3::splat(f64::from(radiance)));
        self.view.picture.upload(&self.gpu, &frame);
        self.gpu.write(
            &self.view.camera,
            &[GpuCamera::new(camera, pose, &EXPOSURE, [0.02, 20.0])],
        );
        let even = cube_of(16, |_| Vec3::splat(at_probe));
        self.probe.upload(&self.gpu, &even, &cube_of(16, |_| 0));
        self.near.upload(&self.gpu, &light_of(lights), Vec3::ZERO);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (timer, buffers) = (&mut self.timer, &self.buffers);
        self.view
            .phantoms
            .record(&mut encoder, timer, (buffers, &buffers.phantoms));
        self.virtuals.record(&mut encoder, timer, (buffers, &buffers.virtuals));
        self.near.record(&mut encoder, timer);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Light from near things on a surface: place, normal and irradiance of its pixels.
    fn near_light(&mut self, kind: Kind) -> Vec<(Vec3, Vec3, Vec3)> {
        let surface = match kind {
            Kind::Phantom => &self.view.phantoms,
            Kind::Virtual => &self.virtuals,
        };
        let light = ShadowedLight::new(&self.gpu, surface.views());
        let real = self.near.unshadowed.radiance();
        let inputs = Inputs {
            eye: EyeInputs {
                view: &self.view,
                scene: &self.buffers,
                rays: &self.rays,
                environments: &self.environments,
                probe_radiance: &self.probe.view,
                near: &self.near,
                shadows: &self.shadows,
                light: LightConfig::default(),
                protection: Protection::Off,
                phantom_edges: PhantomEdges::Mesh,
                mode: &ModeConfig::default(),
            },
            light: &light,
            real,
        };
        let pass = match kind {
            Kind::Phantom => NearLight::change(&self.gpu, inputs, real),
            Kind::Virtual => NearLight::light(&self.gpu, inputs),
        };
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        pass.record(&mut encoder, &mut self.timer);
        self.gpu.queue.submit([encoder.finish()]);
        let places = support::read_layer::<[f32; 4]>(&self.gpu, light.place.texture(), 0, 0);
        let normals = support::read_layer::<[f16; 4]>(&self.gpu, light.normal.texture(), 0, 0);
        let found = support::read_layer::<[f16; 4]>(&self.gpu, light.near.texture(), 0, 0);
        let vector = |t: [f16; 4]| Vec4::from_array(t.map(f16::to_f32)).truncate();
        places
            .iter()
            .zip(normals.into_iter().zip(found))
            .filter(|(place, _)| place[3] > 0.0)
            .map(|(place, (normal, near))| (Vec4::from_array(*place).truncate(), vector(normal), vector(near)))
            .collect()
    }

    /// Light from everywhere alike, as the harmonics of every environment hold it.
    fn set_harmonics(&self, radiance: f32) {
        let mut all = [Vec4::ZERO; 256];
        for first in all.iter_mut().step_by(16) {
            // Y00 is 0.2821: uniform radiance L has the coefficient 4 pi L Y00.
            *first = Vec4::splat(4.0 * PI * 0.282_094_8 * radiance);
        }
        self.gpu.write(&self.environments.harmonics, &all);
    }

    /// The radiance that is remembered, per vertex.
    fn remembered(&self) -> Vec<Vec4> {
        let mut items = vec![Vec4::ZERO; self.parts.facts.len()];
        let readback = Readback::new(&self.gpu, "test: memory", size_of_val(&items[..]) as u64);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bytes = size_of_val(&items[..]) as u64;
        encoder.copy_buffer_to_buffer(self.near.memory.remembered(), 0, readback.buffer(), 0, bytes);
        readback.record(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        readback.read(&self.gpu, &mut items).expect("the device works");
        items
    }
}

fn matt(base_color: [f32; 3]) -> Material {
    Material {
        base_color,
        ..support::diffuse(0.0)
    }
}

fn ground() -> Mesh {
    square(Vec3::ZERO, 0.6 * Vec3::X, 0.6 * Vec3::Y)
}

/// A closed real room around everything, its floor at z = 0.
fn room() -> Mesh {
    let mut room = Mesh {
        materials: vec![support::diffuse(0.5)],
        ..Mesh::default()
    };
    let middle = 0.6 * Vec3::Z;
    for (out, across) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
        for side in [-1.0, 1.0] {
            let wall = square(middle + 0.6 * side * out, -0.6 * side * across, 0.6 * out.cross(across));
            let first = room.vertices.len() as u32;
            room.vertices.extend(wall.vertices);
            room.indices.extend(wall.indices.iter().map(|i| first + i));
        }
    }
    room
}

fn ball_in(real: Mesh, base_color: [f32; 3]) -> Scene {
    let ball = sphere(CENTER_M, RADIUS_M, 48, matt(base_color));
    support::scene([("real", Kind::Phantom, real), ("ball", Kind::Virtual, ball)])
}

/// Form factor of the ball for a place on the floor: it is over the horizon as a whole.
fn form_factor(place: Vec3) -> f32 {
    let to_ball = CENTER_M - place;
    RADIUS_M * RADIUS_M * to_ball.z / to_ball.length().powi(3)
}

/// Pixels of the floor at which the ball matters, walls left out.
fn on_floor(found: Vec<(Vec3, Vec3, Vec3)>) -> Vec<(Vec3, Vec3)> {
    found
        .into_iter()
        .filter(|(place, normal, _)| place.z.abs() < 1e-3 && normal.z > 0.9)
        .map(|(place, _, near)| (place, near))
        .collect()
}

/// Pixels near the ball, whose sphere is seen under a large enough angle for its whole change to count.
fn is_near(place: Vec3) -> bool {
    let to_ball = CENTER_M - place;
    let sine = RADIUS_M / to_ball.length();
    sine * sine * (to_ball.normalize().z + sine).min(1.0) > 0.025
}

#[test]
fn a_black_ball_takes_the_light_of_the_walls_that_it_hides() {
    let Some(gpu) = support::gpu() else { return };
    let mut bench = Bench::new(gpu, &ball_in(room(), [0.0; 3]));
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let found = on_floor(bench.near_light(Kind::Phantom));
    let errors = Errors::of(
        "share of what a black ball takes",
        found
            .iter()
            .filter(|(place, _)| is_near(*place))
            .map(|(place, near)| near.y / (-PI * RADIANCE * form_factor(*place)) - 1.0),
    );
    assert!(errors.mean < 0.04 && errors.n > 1000, "{errors:?}");
}

#[test]
fn a_white_ball_in_light_from_everywhere_changes_nothing() {
    let Some(gpu) = support::gpu() else { return };
    let mut bench = Bench::new(gpu, &ball_in(room(), [1.0; 3]));
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let found = on_floor(bench.near_light(Kind::Phantom));
    let errors = Errors::of(
        "change by a white ball, share of the light",
        found.iter().map(|(_, near)| near.y / (PI * RADIANCE)),
    );
    assert!(errors.worst < 0.01, "{errors:?}");
}

#[test]
fn a_red_ball_under_the_sky_tints_the_ground() {
    let Some(gpu) = support::gpu() else { return };
    let albedo = Vec3::new(0.8, 0.1, 0.05);
    let mut bench = Bench::new(gpu, &ball_in(ground(), albedo.to_array()));
    let directions = hemisphere(256);
    let lights: Vec<KeyLight> = directions
        .iter()
        .map(|&direction| KeyLight {
            id: 0,
            direction,
            distance_m: 100.0,
            irradiance: Vec3::splat(2.0 * PI / directions.len() as f32),
            angular_radius_rad: 0.05,
        })
        .collect();
    // The ground sends nothing, so that all light on the ball is the sky's: half (1 + n_z) of what faces it fully.
    bench.look(&usual_view(), [0.0; 2], &lights);
    let found = on_floor(bench.near_light(Kind::Phantom));
    let near: Vec<_> = found.iter().filter(|(place, _)| is_near(*place)).step_by(97).collect();
    let expected = |place: Vec3| -> f32 {
        let n = 20_000;
        let sum: f32 = hemisphere(n)
            .into_iter()
            .filter_map(|direction| {
                let to_ball = CENTER_M - place;
                let along = to_ball.dot(direction);
                let off2 = to_ball.length_squared() - along * along;
                let hit = along - (RADIUS_M * RADIUS_M - off2).max(0.0).sqrt();
                let normal = (direction * hit - to_ball) / RADIUS_M;
                (off2 < RADIUS_M * RADIUS_M).then_some(0.5 * (1.0 + normal.z) * direction.z)
            })
            .sum();
        sum * 2.0 * PI / n as f32
    };
    let errors = Errors::of(
        "tint of the ground",
        near.iter()
            .map(|(place, near)| (near.x - albedo.x * expected(*place)) / (albedo.x * expected(*place))),
    );
    assert!(errors.mean < 0.06 && errors.n > 20, "{errors:?}");
    for (place, near) in near {
        let tint = near.y / near.x;
        assert!((tint - albedo.y / albedo.x).abs() < 0.01, "{place}: {near}");
    }
}

#[test]
fn a_place_without_virtual_things_near_keeps_every_bit() {
    let Some(gpu) = support::gpu() else { return };
    let mut bench = Bench::new(gpu, &ball_in(room(), [0.5; 3]));
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let found = bench.near_light(Kind::Phantom);
    let far: Vec<_> = found
        .iter()
        .filter(|(p, ..)| p.distance(CENTER_M) > 11.0 * RADIUS_M)
        .collect();
    let n_changed = found.iter().filter(|(.., near)| *near != Vec3::ZERO).count();
    assert!(far.len() > 100 && n_changed > 1000, "{} {n_changed}", far.len());
    for (place, _, near) in far {
        assert_eq!(*near, Vec3::ZERO, "{place}");
    }
}

#[test]
fn a_ball_over_the_ground_has_its_light_from_below() {
    let Some(gpu) = support::gpu() else { return };
    // So wide a ground is the lower half of all directions, but for two degrees.
    let wide = square(Vec3::ZERO, 2.4 * Vec3::X, 2.4 * Vec3::Y);
    let mut bench = Bench::new(gpu, &ball_in(wide, [0.5; 3]));
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let errors = Errors::of(
        "light from the ground, share of the whole",
        bench
            .near_light(Kind::Virtual)
            .iter()
            .map(|(_, normal, near)| near.y / (PI * RADIANCE) - 0.5 * (1.0 - normal.z)),
    );
    assert!(errors.mean < 0.025 && errors.n > 1000, "{errors:?}");
}

#[test]
fn a_corner_of_two_virtual_walls_lights_itself() {
    let Some(gpu) = support::gpu() else { return };
    let albedo = 0.5;
    let mut corner = square(Vec3::new(0.0, 0.1, 0.082), 0.2 * Vec3::X, 0.08 * Vec3::Z);
    let floor = square(Vec3::new(0.0, 0.02, 0.002), 0.2 * Vec3::X, 0.08 * Vec3::Y);
    let first = corner.vertices.len() as u32;
    corner.vertices.extend(floor.vertices);
    corner.indices.extend(floor.indices.iter().map(|i| first + i));
    corner.materials = vec![matt([albedo; 3])];
    let scene = support::scene([("real", Kind::Phantom, room()), ("corner", Kind::Virtual, corner)]);
    let mut bench = Bench::new(gpu, &scene);
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let found = bench.near_light(Kind::Virtual);
    // Each place of two endless walls at a right angle sees the other wall with a form factor of a half, so all are lit
    // alike: E = pi L / 2 + a E / 2.
    let deep = 0.5 / (1.0 - 0.5 * albedo);
    let errors = Errors::of(
        "light in the corner, share of the open",
        found
            .iter()
            .filter(|(p, ..)| p.x.abs() < 0.08 && p.y > 0.093 && p.z < 0.009)
            .map(|(.., near)| near.y / (PI * RADIANCE) - deep),
    );
    assert!(errors.mean < 0.03 && errors.n > 50, "{errors:?}");
}

#[test]
fn what_was_seen_is_remembered_and_follows_the_light() {
    let Some(gpu) = support::gpu() else { return };
    let mut bench = Bench::new(gpu, &ball_in(ground(), [0.5; 3]));
    bench.set_harmonics(2.0);
    bench.look(&usual_view(), [RADIANCE; 2], &[]);
    let middle = bench
        .parts
        .facts
        .iter()
        .zip(bench.remembered())
        .filter(|(facts, _)| facts[0] != NO_PART)
        .map(|(_, radiance)| radiance.y)
        .collect::<Vec<_>>();
    // The camera has seen some of the ground, and the rest is taken to be like it or is what the probe shows: all alike.
    let errors = Errors::of("first look", middle.iter().map(|r| r / RADIANCE - 1.0));
    assert!(errors.worst < 0.02, "{errors:?}");

    // The camera turns away, the light doubles, and the probe shows darkness.
    bench.set_harmonics(4.0);
    bench.look(
        &view_from(DVec3::new(0.0, 0.0, 0.3), DVec3::new(0.0, 0.1, 2.0)),
        [0.0; 2],
        &[],
    );
    let after = bench.remembered();
    let seen: Vec<f32> = bench
        .parts
        .facts
        .iter()
        .zip(&after)
        .filter(|(facts, radiance)| facts[0] != NO_PART && radiance.y > 0.0)
        .map(|(_, radiance)| radiance.y / (2.0 * RADIANCE) - 1.0)
        .collect();
    let errors = Errors::of("after the light has doubled", seen);
    assert!(errors.worst < 0.02 && errors.n > 100, "{errors:?}");
}

#[test]
fn what_was_never_seen_is_like_the_rest_of_its_part() {
    let Some(gpu) = support::gpu() else { return };
    let real = sphere(CENTER_M, RADIUS_M, 24, support::diffuse(0.5));
    let ball = sphere(Vec3::new(0.2, 0.2, 0.1), RADIUS_M, 8, matt([0.5; 3]));
    let mut bench = Bench::new(
        gpu,
        &support::scene([("real", Kind::Phantom, real), ("ball", Kind::Virtual, ball)]),
    );
    assert_eq!(bench.parts.ranges.len(), 1, "a sphere is one part");
    bench.set_harmonics(2.0);
    let at_probe = 2.0 * RADIANCE;
    bench.look(&usual_view(), [RADIANCE, at_probe], &[]);
    let mut n = [0; 2];
    for (facts, radiance) in bench.parts.facts.iter().zip(bench.remembered()) {
        if facts[0] == NO_PART {
            continue;
        }
        let is_like_the_part = (radiance.y / RADIANCE - 1.0).abs() < 0.02;
        let is_what_the_probe_shows = (radiance.y / at_probe - 1.0).abs() < 0.02;
        assert!(
            is_like_the_part || (facts[1] == 1 && is_what_the_probe_shows),
            "{facts:?} {radiance}"
        );
        n[usize::from(is_what_the_probe_shows)] += 1;
    }
    assert!(
        n[0] > 100 && n[1] > 10,
        "{n:?} vertices like their part and from the probe"
    );
}
