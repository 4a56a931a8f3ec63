//! What the passes share that follow rays through real and virtual things (`shared/ray_light.wgsl`).

use bytemuck::{Pod, Zeroable};
use glam::Vec4;

use crate::camera_view::CameraView;
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::scene_gpu::SceneBuffers;
use crate::scene_rays::SceneRays;

/// Where the light was measured, and the mirror ball (`LightProbe` in `shared/ray_light.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuLightProbe {
    /// xyz: the probe's place, world, metres; w: distance of the room from it, metres.
    pub position_m: Vec4,
    /// xyz: the mirror ball's centre, world, metres; w: its radius, 0 where there is none.
    pub ball_m: Vec4,
    /// xyz: its linear reflectance; w: 1 where rays that meet no thing may be looked up in the camera's picture, else 0.
    pub ball_reflectance: Vec4,
}

/// What bindings 0 to 12 and group 1 need.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// Camera, picture and real things.
    pub view: &'a CameraView,
    /// All objects, for rays.
    pub rays: &'a SceneRays,
    /// Materials.
    pub scene: &'a SceneBuffers,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Real things as radiance, with mips.
    pub real: &'a wgpu::TextureView,
    /// Radiance of real things per vertex of the scene, for what the camera does not see.
    pub memory: &'a wgpu::Buffer,
    /// [`GpuLightProbe`], uniform.
    pub probe: &'a wgpu::Buffer,
}

/// A pass that follows rays, with its bindings.
#[derive(Debug)]
pub struct RayPass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    materials: wgpu::BindGroup,
}

impl RayPass {
    /// Pipeline and bindings for what is recorded next.
    pub fn set(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_bind_group(1, &self.materials, &[]);
    }
}

/// The pass `name`, whose bindings 0 to 12 are `inputs` and whose further ones are `others`.
#[must_use]
pub fn pass(
    gpu: &Gpu,
    (name, constants): (&'static str, &[(&str, f64)]),
    inputs: Inputs<'_>,
    others: &[wgpu::BindingResource<'_>],
) -> RayPass {
    let pipeline = gpu.compute_pipeline_variant(name, constants);
    let linear = gpu.linear_sampler();
    let mut resources = inputs.rays.resources().to_vec();
    resources.extend([
        inputs.view.camera.as_entire_binding(),
        inputs.environments.all.as_entire_binding(),
        inputs.environments.harmonics.as_entire_binding(),
        inputs.probe.as_entire_binding(),
        wgpu::BindingResource::Sampler(&linear),
        wgpu::BindingResource::TextureView(&inputs.environments.room_view),
        wgpu::BindingResource::TextureView(inputs.real),
        wgpu::BindingResource::TextureView(inputs.view.phantoms.views().place),
        inputs.memory.as_entire_binding(),
    ]);
    resources.extend_from_slice(others);
    RayPass {
        bindings: gpu.bind(name, &pipeline.get_bind_group_layout(0), &resources),
        materials: inputs
            .scene
            .materials
            .bind_shape(gpu, &pipeline.get_bind_group_layout(1)),
        pipeline,
    }
}
