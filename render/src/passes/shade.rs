//! Virtual objects as radiance, with smooth edges.

use super::direct::{DirectLight, Inputs};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::SceneBuffers;

/// Samples per pixel at edges.
pub const SAMPLES: u32 = 4;

/// The pass with its targets.
#[derive(Debug)]
pub struct Shade {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    samples: wgpu::TextureView,
    resolved: wgpu::TextureView,
}

impl Shade {
    /// A pass for pictures of `size_px`; `sampler` is linear and clamped.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        direct: &DirectLight,
        inputs: Inputs<'_>,
        (sampler, size_px): (&wgpu::Sampler, [u32; 2]),
    ) -> Self {
        let state = RasterState {
            targets: &[RADIANCE_FORMAT],
            samples: SAMPLES,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("shade", &state);
        let repeating = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("shade: base colours"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let mut resources = direct.resources(inputs);
        resources.extend([
            inputs.scene.materials.as_entire_binding(),
            wgpu::BindingResource::TextureView(&inputs.environments.specular_view),
            wgpu::BindingResource::Sampler(sampler),
            wgpu::BindingResource::TextureView(&inputs.scene.base_colors),
            wgpu::BindingResource::Sampler(&repeating),
        ]);
        let bindings = gpu.bind("shade", &pipeline.get_bind_group_layout(0), &resources);
        let target = |samples| {
            let shape = TextureShape {
                samples,
                ..TextureShape::plain(size_px)
            };
            let texture = gpu.texture("shade: radiance", shape, RADIANCE_FORMAT);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            samples: target(SAMPLES),
            resolved: target(1),
            pipeline,
            bindings,
        }
    }

    /// Radiance of virtual objects times their coverage, alpha the coverage.
    #[must_use]
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.resolved
    }

    /// Draws the virtual objects before the phantoms' `depth`, which has as many samples.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        scene: &SceneBuffers,
        depth: &wgpu::TextureView,
    ) {
        let span = timer.span("shade");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.samples,
                depth_slice: None,
                resolve_target: Some(&self.resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Load,
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        scene.virtuals.draw(&mut pass, &scene.vertices);
    }
}
