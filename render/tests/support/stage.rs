//! The buffers and passes around one scene, without tracker and probe, so that a pass can be fed by hand.

use glam::{Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use mirrorball_render::config::LightConfig;
use mirrorball_render::environments::Environments;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::{GpuAim, GpuCamera, GpuFrame, GpuLight};
use mirrorball_render::passes::camera_depth::CameraDepth;
use mirrorball_render::passes::direct::{DirectLight, Inputs};
use mirrorball_render::passes::receive::Receive;
use mirrorball_render::passes::shade::{SAMPLES, Shade, ShadeTarget};
use mirrorball_render::passes::shadow_map::{ShadowMapPass, ShadowMaps, ShadowWork, Sphere, enclosing};
use mirrorball_render::scene::{Kind, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;

use super::{EXPOSURE, occluders};

/// Everything between a scene and its shaded pixels.
pub(crate) struct Stage {
    pub(crate) gpu: Gpu,
    pub(crate) timer: Timer,
    pub(crate) buffers: SceneBuffers,
    pub(crate) environments: Environments,
    pub(crate) camera: wgpu::Buffer,
    pub(crate) depth: CameraDepth,
    pub(crate) direct: DirectLight,
    pub(crate) shadow_map: ShadowMapPass,
    pub(crate) phantom_maps: ShadowMaps,
    pub(crate) virtual_maps: ShadowMaps,
    pub(crate) receive: Receive,
    pub(crate) shade: Shade,
    pub(crate) virtuals: Sphere,
    pub(crate) everything: Sphere,
    map_size: u32,
}

impl Stage {
    /// A stage for at most `n_lights` lights with shadow maps of `map_size` texels.
    pub(crate) fn new(gpu: Gpu, rig: &Rig, scene: &Scene, [map_size, n_lights]: [u32; 2]) -> Self {
        let buffers = SceneBuffers::new(&gpu, scene, rig).expect("the test scene fits");
        let environments = Environments::new(&gpu, scene, rig, &occluders(scene, Kind::Phantom));
        let size_px = rig.scene_camera().intrinsics.size_px;
        let camera = gpu.buffer("test: camera", &[<GpuCamera as bytemuck::Zeroable>::zeroed()]);
        let depth = CameraDepth::new(&gpu, &camera, &buffers, (size_px, SAMPLES));
        let direct = DirectLight::new(&gpu);
        let shadow_map = ShadowMapPass::new(&gpu);
        let phantom_maps = shadow_map.maps(&gpu, "test: phantoms", &buffers, [map_size, n_lights]);
        let virtual_maps = shadow_map.maps(&gpu, "test: virtuals", &buffers, [map_size, n_lights]);
        let inputs = Inputs {
            camera: &camera,
            scene: &buffers,
            environments: &environments,
            phantom_maps: &phantom_maps.view,
            virtual_maps: &virtual_maps.view,
        };
        let receive = Receive::new(&gpu, &direct, inputs, size_px);
        let target = ShadeTarget {
            size_px,
            light: LightConfig::default(),
        };
        let shade = Shade::new(&gpu, &direct, inputs, (&gpu.linear_sampler(), target));
        let spheres = |kind: Option<Kind>| {
            let sphere = |object: &mirrorball_render::scene::Object| {
                let (center_m, radius_m) = object.bounding_sphere(rig);
                Sphere { center_m, radius_m }
            };
            let all: Vec<Sphere> = scene
                .objects
                .iter()
                .filter(|o| kind.is_none_or(|k| o.kind == k))
                .map(sphere)
                .collect();
            enclosing(&all).expect("the scene is not empty")
        };
        let (virtuals, everything) = (spheres(Some(Kind::Virtual)), spheres(None));
        Self {
            timer: Timer::new(&gpu),
            gpu,
            buffers,
            environments,
            camera,
            depth,
            direct,
            shadow_map,
            phantom_maps,
            virtual_maps,
            receive,
            shade,
            virtuals,
            everything,
            map_size,
        }
    }

    /// Radiance of the virtual objects and their coverage as `camera_from_world` sees them, lit by the environments' maps
    /// and by no other light.
    pub(crate) fn shaded(&mut self, rig: &Rig, camera_from_world: &Pose, light: LightConfig) -> Vec<Vec4> {
        let target = ShadeTarget {
            size_px: rig.scene_camera().intrinsics.size_px,
            light,
        };
        let inputs = Inputs {
            camera: &self.camera,
            scene: &self.buffers,
            environments: &self.environments,
            phantom_maps: &self.phantom_maps.view,
            virtual_maps: &self.virtual_maps.view,
        };
        self.shade = Shade::new(&self.gpu, &self.direct, inputs, (&self.gpu.linear_sampler(), target));
        self.ratios(rig, camera_from_world, &[], self.everything);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.depth.record(&mut encoder, &mut self.timer, &self.buffers);
        self.shade
            .record(&mut encoder, &mut self.timer, &self.buffers, self.depth.multisampled());
        self.gpu.queue.submit([encoder.finish()]);
        super::read_layer::<[half::f16; 4]>(&self.gpu, self.shade.radiance().texture(), 0, 0)
            .into_iter()
            .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
            .collect()
    }

    /// Aims of shadow maps that cover `receivers`.
    pub(crate) fn aims(&self, lights: &[GpuLight], receivers: Sphere) -> Vec<Option<GpuAim>> {
        let aim = |light: &GpuLight| {
            Some(GpuAim {
                position_m: light.position_m.truncate().extend(self.map_size as f32),
                receivers_m: receivers.to_vec4(),
                casters_m: self.everything.to_vec4(),
            })
        };
        lights.iter().map(aim).collect()
    }

    /// The phantoms' ratios as `camera_from_world` sees them, drawn through shadow maps, depth and receive pass.
    pub(crate) fn ratios(
        &mut self,
        rig: &Rig,
        camera_from_world: &Pose,
        lights: &[GpuLight],
        receivers: Sphere,
    ) -> Vec<Vec4> {
        let camera = GpuCamera::new(rig.scene_camera(), camera_from_world, &EXPOSURE, [0.02, 20.0]);
        self.gpu.write(&self.camera, &[camera]);
        let mut casters_m = [Vec4::new(0.0, 0.0, 0.0, -1.0); 4];
        casters_m[0] = self.virtuals.to_vec4() + Vec4::W * 0.01;
        let frame = GpuFrame {
            counts: [
                lights.len() as u32,
                3,
                self.environments.slots.len() as u32,
                self.map_size,
            ],
            ball_m: Vec4::ZERO,
            receivers_m: receivers.to_vec4(),
            virtuals_m: self.virtuals.to_vec4(),
            everything_m: self.everything.to_vec4(),
            casters_m,
        };
        self.direct.write(&self.gpu, &frame, lights);
        let (phantom_aims, virtual_aims) = (self.aims(lights, receivers), self.aims(lights, self.virtuals));
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let work = ShadowWork {
            maps: &mut self.phantom_maps,
            scene: &self.buffers,
            casters: &self.buffers.phantoms,
            aims: &phantom_aims,
        };
        self.shadow_map.record(&self.gpu, &mut encoder, &mut self.timer, work);
        let work = ShadowWork {
            maps: &mut self.virtual_maps,
            scene: &self.buffers,
            casters: &self.buffers.virtuals,
            aims: &virtual_aims,
        };
        self.shadow_map.record(&self.gpu, &mut encoder, &mut self.timer, work);
        self.depth.record(&mut encoder, &mut self.timer, &self.buffers);
        self.receive
            .record(&mut encoder, &mut self.timer, &self.buffers, self.depth.single());
        self.gpu.queue.submit([encoder.finish()]);
        super::read_layer::<[half::f16; 4]>(&self.gpu, self.receive.ratio().texture(), 0, 0)
            .into_iter()
            .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
            .collect()
    }
}

/// A light at `position_m` that gives white `irradiance` at the origin, shadows compared with one tap.
pub(crate) fn light(position_m: Vec3, irradiance: f32) -> GpuLight {
    GpuLight {
        position_m: position_m.extend(0.0),
        intensity: Vec3::splat(irradiance * position_m.length_squared()).extend(0.0),
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
