//! What the passes share that gather light from the key lights: lights, shadow maps, near light.

use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::types::{GpuFrame, GpuLight, MAX_LIGHTS};
use crate::scene_gpu::SceneBuffers;

/// Buffers and views behind bindings 0 to 8 of `receive` and `shade`.
#[derive(Debug)]
pub struct DirectLight {
    frame: wgpu::Buffer,
    lights: wgpu::Buffer,
    depth_sampler: wgpu::Sampler,
}

/// What else those bindings need.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene camera, uniform.
    pub camera: &'a wgpu::Buffer,
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Shadow maps of the phantoms.
    pub phantom_maps: &'a wgpu::TextureView,
    /// Shadow maps of the virtual objects.
    pub virtual_maps: &'a wgpu::TextureView,
}

impl DirectLight {
    /// Room for [`MAX_LIGHTS`] lights.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let zeroed_light = <GpuLight as bytemuck::Zeroable>::zeroed();
        Self {
            frame: gpu.buffer("direct light: frame", &[<GpuFrame as bytemuck::Zeroable>::zeroed()]),
            lights: gpu.buffer("direct light: lights", &[zeroed_light; MAX_LIGHTS]),
            depth_sampler: gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("direct light: depth comparison"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                compare: Some(wgpu::CompareFunction::LessEqual),
                ..wgpu::SamplerDescriptor::default()
            }),
        }
    }

    /// Uploads a frame's lights.
    pub fn write(&self, gpu: &Gpu, frame: &GpuFrame, lights: &[GpuLight]) {
        gpu.write(&self.frame, &[*frame]);
        gpu.write(&self.lights, lights);
    }

    /// Bindings 0 to 8, in order.
    #[must_use]
    pub fn resources<'a>(&'a self, inputs: Inputs<'a>) -> Vec<wgpu::BindingResource<'a>> {
        vec![
            inputs.camera.as_entire_binding(),
            self.frame.as_entire_binding(),
            self.lights.as_entire_binding(),
            inputs.scene.objects.as_entire_binding(),
            inputs.environments.all.as_entire_binding(),
            inputs.environments.near_sh.as_entire_binding(),
            wgpu::BindingResource::TextureView(inputs.phantom_maps),
            wgpu::BindingResource::TextureView(inputs.virtual_maps),
            wgpu::BindingResource::Sampler(&self.depth_sampler),
        ]
    }
}
