//! Depth of the phantoms as a camera sees them, several samples per pixel: hides virtual objects behind them with smooth
//! edges.

use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::SceneBuffers;

/// The pass with its target.
#[derive(Debug)]
pub struct CameraDepth {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    view: wgpu::TextureView,
}

impl CameraDepth {
    /// A pass for pictures of `size_px` with `samples` per pixel, with the camera in the uniform buffer `camera`.
    #[must_use]
    pub fn new(gpu: &Gpu, camera: &wgpu::Buffer, scene: &SceneBuffers, (size_px, samples): ([u32; 2], u32)) -> Self {
        let state = RasterState {
            targets: &[],
            samples,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let pipeline = gpu.render_pipeline("camera_depth", &state);
        let bindings = gpu.bind(
            "camera_depth",
            &pipeline.get_bind_group_layout(0),
            &[camera.as_entire_binding(), scene.objects.as_entire_binding()],
        );
        let shape = TextureShape {
            samples,
            ..TextureShape::plain(size_px)
        };
        let texture = gpu.texture("camera_depth: depth", shape, DEPTH_FORMAT);
        Self {
            pipeline,
            bindings,
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
        }
    }

    /// The depths.
    #[must_use]
    pub fn view(&self) -> &wgpu::TextureView {
        &self.view
    }

    /// Draws the phantoms.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: &SceneBuffers) {
        self.record_range(encoder, timer, Some(scene));
    }

    /// Draws nothing: nothing hides virtual objects.
    pub fn record_empty(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        self.record_range(encoder, timer, None);
    }

    fn record_range(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: Option<&SceneBuffers>) {
        let span = timer.span("camera_depth");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("camera_depth"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        if let Some(scene) = scene {
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            scene.phantoms.draw(&mut pass, &scene.vertices);
        }
    }
}
