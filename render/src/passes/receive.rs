//! Phantoms receive the shadows of virtual objects: a ratio per pixel.

use super::direct::{self, Inputs};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuFrame;
use crate::scene_gpu::SceneBuffers;

/// The pass with its target.
#[derive(Debug)]
pub struct Receive {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    frame: wgpu::Buffer,
    target: wgpu::TextureView,
}

impl Receive {
    /// A pass for pictures of `size_px`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, size_px: [u32; 2]) -> Self {
        let state = RasterState {
            targets: &[RADIANCE_FORMAT],
            samples: 1,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("receive", &state);
        let frame = gpu.buffer("receive: frame", &[<GpuFrame as bytemuck::Zeroable>::zeroed()]);
        let mut resources = direct::resources(inputs);
        resources.push(frame.as_entire_binding());
        let bindings = gpu.bind("receive", &pipeline.get_bind_group_layout(0), &resources);
        let target = gpu.texture("receive: ratio", TextureShape::plain(size_px), RADIANCE_FORMAT);
        Self {
            pipeline,
            bindings,
            frame,
            target: target.create_view(&wgpu::TextureViewDescriptor::default()),
        }
    }

    /// Uploads what a frame's pixels share.
    pub fn write(&self, gpu: &Gpu, frame: &GpuFrame) {
        gpu.write(&self.frame, &[*frame]);
    }

    /// Ratio on phantoms, alpha 1 where there is one.
    #[must_use]
    pub fn ratio(&self) -> &wgpu::TextureView {
        &self.target
    }

    /// Draws the phantoms that `depth`, already filled, leaves in sight.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        scene: &SceneBuffers,
        depth: &wgpu::TextureView,
    ) {
        let span = timer.span("receive");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("receive"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Load,
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        scene.phantoms.draw(&mut pass, &scene.vertices);
    }
}
