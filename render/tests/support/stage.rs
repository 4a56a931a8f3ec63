//! The buffers and passes around one scene, without tracker and probe, so that a pass can be fed by hand.

use glam::{Affine3A, Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use mirrorball_render::config::{LightConfig, ShadowConfig};
use mirrorball_render::environments::Environments;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::{GpuCamera, GpuFrame};
use mirrorball_render::passes::camera_depth::CameraDepth;
use mirrorball_render::passes::direct::Inputs;
use mirrorball_render::passes::direct::ShadowedLight;
use mirrorball_render::passes::lens_surface::LensSurface;
use mirrorball_render::passes::protect::BrightLight;
use mirrorball_render::passes::receive::Receive;
use mirrorball_render::passes::shade::{SAMPLES, Shade, ShadeTarget};
use mirrorball_render::probe::Light;
use mirrorball_render::probe::meter::MeterFit;
use mirrorball_render::scene::{Kind, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;
use mirrorball_render::scene_shadows::{EyeShadows, EyeSurfaces, SceneShadows, ShadowFrame};

use super::{EXPOSURE, occluders};
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::probe::cube::Cube;

/// Everything between a scene and its shaded pixels.
pub(crate) struct Stage {
    pub(crate) gpu: Gpu,
    pub(crate) timer: Timer,
    pub(crate) buffers: SceneBuffers,
    pub(crate) environments: Environments,
    pub(crate) camera: wgpu::Buffer,
    pub(crate) depth: CameraDepth,
    shadows: SceneShadows,
    eye_shadows: EyeShadows,
    surfaces: [LensSurface; 2],
    pub(crate) light_on: [ShadowedLight; 2],
    pub(crate) receive: Receive,
    pub(crate) shade: Shade,
}

impl Stage {
    /// A stage for at most `n_lights` lights with shadow maps of `map_size` texels.
    pub(crate) fn new(gpu: Gpu, rig: &Rig, scene: &Scene, [map_size, n_lights]: [u32; 2]) -> Self {
        let buffers = SceneBuffers::new(&gpu, scene, rig).expect("the test scene fits");
        let environments = Environments::new(&gpu, scene, rig, &occluders(scene, Kind::Phantom));
        let size_px = rig.scene_camera().intrinsics.size_px;
        let camera = gpu.buffer("test: camera", &[<GpuCamera as bytemuck::Zeroable>::zeroed()]);
        let depth = CameraDepth::new(&gpu, &camera, &buffers, (size_px, SAMPLES));
        let config = ShadowConfig {
            map_size,
            dome_lights: n_lights,
            bright_lights: 0,
            ..ShadowConfig::default()
        };
        let shadows = SceneShadows::new(&gpu, (scene, &buffers), rig, config).expect("the test scene fits");
        let surfaces =
            ["phantoms", "virtual objects"].map(|label| LensSurface::new(&gpu, label, (&camera, &buffers), size_px));
        let light_on = [0, 1].map(|i: usize| ShadowedLight::new(&gpu, surfaces[i].views()));
        let eye_shadows = shadows
            .eye(
                &gpu,
                (&buffers, rig.scene_camera()),
                EyeSurfaces {
                    surfaces: [&surfaces[0], &surfaces[1]],
                    targets: &light_on,
                    bright: None,
                },
            )
            .expect("the test scene fits");
        let inputs = |light| Inputs {
            camera: &camera,
            scene: &buffers,
            environments: &environments,
            light,
        };
        let receive = Receive::new(&gpu, inputs(&light_on[0]), &BrightLight::new(&gpu, size_px), size_px);
        let nothing = nothing(&gpu);
        let target = ShadeTarget {
            size_px,
            light: LightConfig::default(),
            traced: [&nothing; 2],
        };
        let shade = Shade::new(&gpu, inputs(&light_on[1]), (&gpu.linear_sampler(), target));
        Self {
            timer: Timer::new(&gpu),
            gpu,
            buffers,
            environments,
            camera,
            depth,
            shadows,
            eye_shadows,
            surfaces,
            light_on,
            receive,
            shade,
        }
    }

    /// Radiance of the virtual objects and their coverage as `camera_from_world` sees them, lit by the environments' maps
    /// and by no other light.
    pub(crate) fn shaded(&mut self, rig: &Rig, camera_from_world: &Pose, light: LightConfig) -> Vec<Vec4> {
        let nothing = nothing(&self.gpu);
        let target = ShadeTarget {
            size_px: rig.scene_camera().intrinsics.size_px,
            light,
            traced: [&nothing; 2],
        };
        let inputs = Inputs {
            camera: &self.camera,
            scene: &self.buffers,
            environments: &self.environments,
            light: &self.light_on[1],
        };
        self.shade = Shade::new(&self.gpu, inputs, (&self.gpu.linear_sampler(), target));
        let placements = vec![Affine3A::IDENTITY; self.buffers.objects_of_rays().len()];
        let eye_m = camera_from_world.inverse().translation.as_vec3();
        self.shade.sort(&self.buffers, &placements, eye_m);
        self.ratios(rig, camera_from_world, &[]);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.depth.record(&mut encoder, &mut self.timer, &self.buffers);
        self.shade
            .record(&mut encoder, &mut self.timer, &self.buffers, self.depth.view());
        self.gpu.queue.submit([encoder.finish()]);
        super::read_layer::<[half::f16; 4]>(&self.gpu, self.shade.radiance().texture(), 0, 0)
            .into_iter()
            .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
            .collect()
    }

    /// The phantoms' ratios as `camera_from_world` sees them, lit by lights around the origin.
    pub(crate) fn ratios(&mut self, rig: &Rig, camera_from_world: &Pose, lights: &[KeyLight]) -> Vec<Vec4> {
        let camera = GpuCamera::new(rig.scene_camera(), camera_from_world, &EXPOSURE, [0.02, 20.0]);
        self.gpu.write(&self.camera, &[camera]);
        let frame = GpuFrame {
            counts: [self.environments.slots.len() as u32, 0, 0, 0],
            ball_m: Vec4::ZERO,
        };
        self.receive.write(&self.gpu, &frame);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let light = light_of(lights);
        let shadow_frame = ShadowFrame {
            scene: &self.buffers,
            light: &light,
            probe_m: Vec3::ZERO,
            is_moved: false,
        };
        let (timer, buffers) = (&mut self.timer, &self.buffers);
        self.surfaces[0].record(&mut encoder, timer, (buffers, &buffers.phantoms));
        self.surfaces[1].record(&mut encoder, timer, (buffers, &buffers.virtuals));
        self.shadows.record(&self.gpu, &mut encoder, timer, &shadow_frame);
        let job = (&mut self.eye_shadows, &shadow_frame, camera_from_world);
        self.shadows
            .record_eye(&self.gpu, &mut encoder, timer, job)
            .expect("the default method takes all lights");
        self.receive.record(&mut encoder, timer);
        self.gpu.queue.submit([encoder.finish()]);
        super::read_layer::<[half::f16; 4]>(&self.gpu, self.receive.ratio().texture(), 0, 0)
            .into_iter()
            .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
            .collect()
    }
}

/// Black, in place of what rays would find.
fn nothing(gpu: &Gpu) -> wgpu::TextureView {
    gpu.texture("test: nothing", TextureShape::plain([1; 2]), RADIANCE_FORMAT)
        .create_view(&wgpu::TextureViewDescriptor::default())
}

/// Lights and nothing else.
pub(crate) fn light_of(lights: &[KeyLight]) -> Light {
    let black = Cube::filled(16, Vec3::ZERO);
    Light {
        radiance: black.clone(),
        far: black.clone(),
        behind: black.clone(),
        strong: black.map(|_| 0),
        lights: lights.to_vec(),
        distance_m: black.map(|_| 2.0),
        room_m: 2.0,
        meter: MeterFit {
            missing: Vec::new(),
            lights: Vec::new(),
            residual: 0.0,
            papers: 0,
            patches: 0,
        },
    }
}

/// A point light at `position_m` that gives white `irradiance` at the origin.
pub(crate) fn light(position_m: Vec3, irradiance: f32) -> KeyLight {
    KeyLight {
        id: 0,
        direction: position_m.normalize(),
        distance_m: position_m.length(),
        irradiance: Vec3::splat(irradiance),
        angular_radius_rad: 0.0,
    }
}

/// A stage around one glossy sphere on which environments can be tried.
pub(crate) fn environment_stage(gpu: Gpu) -> Stage {
    let sphere = super::sphere(Vec3::Z * 0.1, 0.05, 8, super::mirror());
    Stage::new(
        gpu,
        &super::rig(),
        &super::scene([("sphere", Kind::Virtual, sphere)]),
        [64, 1],
    )
}
