//! What the scene camera sees through its own lens, per pixel: place and normal of the first surface of a set of objects.

use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::{IndexRange, SceneBuffers};
use crate::shadow::surface::{PLACE_FORMAT, SurfaceViews};

/// The pass with its targets.
#[derive(Debug)]
pub struct LensSurface {
    label: &'static str,
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    materials: wgpu::BindGroup,
    place: wgpu::TextureView,
    normal: wgpu::TextureView,
    depth: wgpu::TextureView,
    size_px: [u32; 2],
}

impl LensSurface {
    /// A pass for pictures of `size_px`, with the camera in the uniform buffer `camera`.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        label: &'static str,
        (camera, scene): (&wgpu::Buffer, &SceneBuffers),
        size_px: [u32; 2],
    ) -> Self {
        let state = RasterState {
            targets: &[PLACE_FORMAT, RADIANCE_FORMAT],
            samples: 1,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("lens_surface", &state);
        let bindings = gpu.bind(
            label,
            &pipeline.get_bind_group_layout(0),
            &[camera.as_entire_binding(), scene.objects.as_entire_binding()],
        );
        let target = |format| {
            let texture = gpu.target(label, TextureShape::plain(size_px), format);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            label,
            materials: scene.materials.bind_shape(gpu, &pipeline.get_bind_group_layout(1)),
            pipeline,
            bindings,
            place: target(PLACE_FORMAT),
            normal: target(RADIANCE_FORMAT),
            depth: target(DEPTH_FORMAT),
            size_px,
        }
    }

    /// Places and normals.
    #[must_use]
    pub fn views(&self) -> SurfaceViews<'_> {
        SurfaceViews {
            place: &self.place,
            normal: &self.normal,
            size_px: self.size_px,
        }
    }

    /// Draws `objects`.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (scene, objects): (&SceneBuffers, &IndexRange),
    ) {
        let span = timer.span(self.label);
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
            label: Some(self.label),
            color_attachments: &[clear(&self.place), clear(&self.normal)],
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
        objects.draw(&mut pass, &scene.vertices);
    }
}
