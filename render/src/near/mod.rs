//! Light that near things throw on each other: real ones on virtual ones, virtual ones on each other and on themselves, and
//! what virtual ones change on real ones.
//!
//! [`NearThings`] is what eyes share, [`NearEye`] what each has of its own. Light from afar is a matter of shadows
//! ([`crate::scene_shadows`]) and enters here where it meets a virtual surface that sends it on.

pub mod far_lights;
pub mod parts;

use glam::Vec3;

use crate::camera_view::CameraView;
use crate::config::DiffuseMethod;
use crate::environments::Environments;
use crate::eye::EyeInputs;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::gpu::types::GpuFrame;
use crate::passes::direct::{self, ShadowedLight};
use crate::passes::memory::{self, Memory};
use crate::passes::near_light::{Inputs, NearLight};
use crate::passes::protect::BrightLight;
use crate::passes::real_radiance::RealRadiance;
use crate::passes::receive::Receive;
use crate::probe::Light;
use crate::scene_gpu::SceneBuffers;
use far_lights::FarLights;
use parts::Parts;

/// What eyes share.
#[derive(Debug)]
pub struct NearThings {
    /// Light from afar, for rays.
    pub far_lights: FarLights,
    /// Real things as the scene camera has them, without virtual shadows.
    pub unshadowed: RealRadiance,
    /// Real surfaces that the camera does not see now.
    pub memory: Memory,
}

/// What [`NearThings`] is made of.
#[derive(Debug, Clone, Copy)]
pub struct NearInputs<'a> {
    /// The scene camera, its picture, and the phantoms in it.
    pub view: &'a CameraView,
    /// All objects.
    pub scene: &'a SceneBuffers,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Radiance at the probe.
    pub probe_radiance: &'a wgpu::TextureView,
}

impl NearThings {
    /// Prepares for the camera's pictures of real things that hang together as `parts`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: NearInputs<'_>, parts: &Parts) -> Self {
        let NearInputs { view, scene, .. } = inputs;
        let far_lights = FarLights::new(gpu);
        let unshadowed = RealRadiance::unshadowed(gpu, view);
        let inputs = memory::Inputs {
            view,
            scene,
            environments: inputs.environments,
            unshadowed: unshadowed.radiance(),
            probe_radiance: inputs.probe_radiance,
            probe: far_lights.buffer(),
        };
        Self {
            memory: Memory::new(gpu, inputs, parts),
            far_lights,
            unshadowed,
        }
    }

    /// Hands the light of a frame, measured at `probe_m` (world, metres), to the GPU.
    pub fn upload(&self, gpu: &Gpu, light: &Light, probe_m: Vec3) {
        self.far_lights.upload(gpu, light, probe_m);
    }

    /// Makes what eyes share of a frame's picture.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        self.unshadowed.record(encoder, timer);
        self.memory.record(encoder, timer);
    }
}

/// The passes of one eye.
#[derive(Debug)]
pub struct NearEye {
    /// Shadows on real things before near light, which is not known yet.
    receive: Receive,
    shadowed: RealRadiance,
    change: NearLight,
    /// Unless the settings light virtual objects from maps.
    light: Option<NearLight>,
}

impl NearEye {
    /// Passes that fill [`ShadowedLight::near`] of both surfaces; `real` is the finished radiance of real things,
    /// `unshadowed` theirs without virtual shadows, both in the eye's picture.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        inputs: EyeInputs<'_>,
        (light_on, bright): (&[ShadowedLight; 2], &BrightLight),
        [real, unshadowed]: [&RealRadiance; 2],
    ) -> Self {
        let view = inputs.view;
        let size_px = view.size_px();
        let [on_phantoms, on_virtuals] = light_on;
        let from_afar = on_phantoms.with_near(&black(gpu, size_px));
        let direct = direct::Inputs {
            camera: &view.camera,
            scene: inputs.scene,
            environments: inputs.environments,
            light: &from_afar,
        };
        let receive = Receive::new(gpu, direct, bright, size_px);
        let shadowed = RealRadiance::new(gpu, view, [receive.ratio(), receive.added()]);
        let on = |light, real| Inputs {
            eye: inputs,
            light,
            real,
        };
        Self {
            change: NearLight::change(gpu, on(on_phantoms, shadowed.radiance()), unshadowed.radiance()),
            light: (inputs.light.diffuse == DiffuseMethod::Lights)
                .then(|| NearLight::light(gpu, on(on_virtuals, real.radiance()))),
            receive,
            shadowed,
        }
    }

    /// Uploads what a frame's pixels share.
    pub fn write(&self, gpu: &Gpu, frame: &GpuFrame) {
        self.receive.write(gpu, frame);
    }

    /// What virtual objects change on real ones; the light from afar on both is known.
    pub fn record_change(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        self.receive.record(encoder, timer);
        self.shadowed.record(encoder, timer);
        self.change.record(encoder, timer);
    }

    /// Light on virtual objects; the radiance of real ones is known.
    pub fn record_light(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if let Some(light) = &self.light {
            light.record(encoder, timer);
        }
    }
}

fn black(gpu: &Gpu, size_px: [u32; 2]) -> wgpu::TextureView {
    gpu.texture("near: no light", TextureShape::plain(size_px), RADIANCE_FORMAT)
        .create_view(&wgpu::TextureViewDescriptor::default())
}
