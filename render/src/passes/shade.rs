//! Virtual objects as radiance, phantoms as ratios of light with and without the virtual objects.

use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::{GpuFrame, GpuLight};
use crate::scene_gpu::SceneBuffers;

/// Samples per pixel at edges.
pub const SAMPLES: u32 = 4;

/// What the pass reads.
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
    /// Linear, clamped.
    pub sampler: &'a wgpu::Sampler,
}

/// The pass with its targets.
#[derive(Debug)]
pub struct Shade {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    frame: wgpu::Buffer,
    lights: wgpu::Buffer,
    targets: [Target; 2],
    depth: wgpu::TextureView,
}

#[derive(Debug)]
struct Target {
    samples: wgpu::TextureView,
    resolved: wgpu::TextureView,
}

impl Shade {
    /// A pass for pictures of `size_px` and at most `n_lights` lights.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, size_px: [u32; 2], n_lights: usize) -> Self {
        let state = RasterState {
            targets: &[RADIANCE_FORMAT, RADIANCE_FORMAT],
            samples: SAMPLES,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("shade", &state);
        let zeroed_light = <GpuLight as bytemuck::Zeroable>::zeroed();
        let frame = gpu.buffer("shade: frame", &[<GpuFrame as bytemuck::Zeroable>::zeroed()]);
        let lights = gpu.buffer("shade: lights", &vec![zeroed_light; n_lights.max(1)]);
        let bindings = bind(gpu, &pipeline, inputs, [&frame, &lights]);
        let many = TextureShape { samples: SAMPLES, ..TextureShape::plain(size_px) };
        let view = |t: wgpu::Texture| t.create_view(&wgpu::TextureViewDescriptor::default());
        let target = |label| Target {
            samples: view(gpu.texture(label, many, RADIANCE_FORMAT)),
            resolved: view(gpu.texture(label, TextureShape::plain(size_px), RADIANCE_FORMAT)),
        };
        Self {
            pipeline,
            bindings,
            frame,
            lights,
            targets: [target("shade: virtual radiance"), target("shade: phantom ratio")],
            depth: view(gpu.texture("shade: depth", many, DEPTH_FORMAT)),
        }
    }

    /// Radiance of virtual objects, alpha their coverage.
    #[must_use]
    pub fn virtual_radiance(&self) -> &wgpu::TextureView {
        &self.targets[0].resolved
    }

    /// Ratio on phantoms times their coverage, alpha the coverage.
    #[must_use]
    pub fn phantom_ratio(&self) -> &wgpu::TextureView {
        &self.targets[1].resolved
    }

    /// Draws the scene under `lights`.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        scene: &SceneBuffers,
        (frame, lights): (&GpuFrame, &[GpuLight]),
    ) {
        gpu.write(&self.frame, &[*frame]);
        gpu.write(&self.lights, lights);
        let colors = self.targets.each_ref().map(|target| {
            Some(wgpu::RenderPassColorAttachment {
                view: &target.samples,
                depth_slice: None,
                resolve_target: Some(&target.resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Discard,
                },
            })
        });
        let span = timer.span("shade");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            color_attachments: &colors,
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        scene.virtuals.draw(&mut pass, &scene.vertices);
        scene.phantoms.draw(&mut pass, &scene.vertices);
    }
}

fn bind(
    gpu: &Gpu,
    pipeline: &wgpu::RenderPipeline,
    inputs: Inputs<'_>,
    [frame, lights]: [&wgpu::Buffer; 2],
) -> wgpu::BindGroup {
    let compare = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("shade: depth comparison"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        compare: Some(wgpu::CompareFunction::LessEqual),
        ..wgpu::SamplerDescriptor::default()
    });
    let repeating = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("shade: base colours"),
        address_mode_u: wgpu::AddressMode::Repeat,
        address_mode_v: wgpu::AddressMode::Repeat,
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..wgpu::SamplerDescriptor::default()
    });
    let scene = inputs.scene;
    gpu.bind(
        "shade",
        &pipeline.get_bind_group_layout(0),
        &[
            inputs.camera.as_entire_binding(),
            frame.as_entire_binding(),
            lights.as_entire_binding(),
            scene.objects.as_entire_binding(),
            scene.materials.as_entire_binding(),
            inputs.environments.all.as_entire_binding(),
            inputs.environments.near_sh.as_entire_binding(),
            wgpu::BindingResource::TextureView(inputs.phantom_maps),
            wgpu::BindingResource::TextureView(inputs.virtual_maps),
            wgpu::BindingResource::Sampler(&compare),
            wgpu::BindingResource::TextureView(&inputs.environments.specular_view),
            wgpu::BindingResource::Sampler(inputs.sampler),
            wgpu::BindingResource::TextureView(&scene.base_colors),
            wgpu::BindingResource::Sampler(&repeating),
        ],
    )
}
