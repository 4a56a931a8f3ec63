//! What rays that leave virtual objects need to know of them, per pixel.

use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::SceneBuffers;

/// The pass with its targets.
#[derive(Debug)]
pub struct VirtualSurface {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    materials: wgpu::BindGroup,
    gloss: wgpu::TextureView,
    shape: wgpu::TextureView,
    glass: wgpu::TextureView,
    depth: wgpu::TextureView,
}

impl VirtualSurface {
    /// A pass for pictures of `size_px`, with the camera in the uniform buffer `camera`.
    #[must_use]
    pub fn new(gpu: &Gpu, (camera, scene): (&wgpu::Buffer, &SceneBuffers), size_px: [u32; 2]) -> Self {
        let state = RasterState {
            targets: &[RADIANCE_FORMAT; 3],
            samples: 1,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("virtual_surface", &state);
        let bindings = gpu.bind(
            "virtual_surface",
            &pipeline.get_bind_group_layout(0),
            &[camera.as_entire_binding(), scene.objects.as_entire_binding()],
        );
        let target = |label, format| {
            let texture = gpu.target(label, TextureShape::plain(size_px), format);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            materials: scene.materials.bind_shape(gpu, &pipeline.get_bind_group_layout(1)),
            pipeline,
            bindings,
            gloss: target("virtual_surface: gloss", RADIANCE_FORMAT),
            shape: target("virtual_surface: shape", RADIANCE_FORMAT),
            glass: target("virtual_surface: glass", RADIANCE_FORMAT),
            depth: target("virtual_surface: depth", DEPTH_FORMAT),
        }
    }

    /// xyz: unit normal, normal map included, on the eye's side, world; w: perceptual roughness.
    #[must_use]
    pub fn gloss(&self) -> &wgpu::TextureView {
        &self.gloss
    }

    /// xyz: unit normal of the mesh, on the eye's side, world; w: index of the object, from 1, 0 where there is none.
    #[must_use]
    pub fn shape(&self) -> &wgpu::TextureView {
        &self.shape
    }

    /// x: share of the light that enters and goes through; y: index of refraction.
    #[must_use]
    pub fn glass(&self) -> &wgpu::TextureView {
        &self.glass
    }

    /// Draws the virtual objects.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: &SceneBuffers) {
        let span = timer.span("virtual_surface");
        let clear = |view| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("virtual_surface"),
            color_attachments: &[&self.gloss, &self.shape, &self.glass].map(clear),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_bind_group(1, &self.materials, &[]);
        scene.virtuals.draw(&mut pass, &scene.vertices);
    }
}
