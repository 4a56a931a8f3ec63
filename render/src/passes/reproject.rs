//! The scene camera's picture as an eye beside it sees it, by the phantoms' places.
//!
//! What no phantom shows is taken to stand on the room's sphere. What the eye sees and the camera does not, because
//! something stands before it, takes the colour of the nearest pixel that does not show what stands before it. What is out
//! of the camera's picture is black.

use glam::Vec4;

use super::groups;
use crate::camera_view::CameraView;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// The pass, bound to two views.
#[derive(Debug)]
pub struct Reproject {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    size_px: [u32; 2],
}

/// The uniform buffer of the room: its centre in the world and its radius, metres.
#[must_use]
pub fn room_buffer(gpu: &Gpu, room_m: f32) -> wgpu::Buffer {
    gpu.buffer("reproject: room", &[Vec4::new(0.0, 0.0, 0.0, room_m)])
}

impl Reproject {
    /// A pass from the picture of `seen` to that of `eye`; `room` is a [`room_buffer`].
    #[must_use]
    pub fn new(gpu: &Gpu, (seen, eye): (&CameraView, &CameraView), room: &wgpu::Buffer) -> Self {
        let pipeline = gpu.compute_pipeline("reproject");
        let bindings = gpu.bind(
            "reproject",
            &pipeline.get_bind_group_layout(0),
            &[
                seen.camera.as_entire_binding(),
                eye.camera.as_entire_binding(),
                room.as_entire_binding(),
                seen.picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&seen.picture.view),
                wgpu::BindingResource::TextureView(seen.phantoms.views().place),
                wgpu::BindingResource::TextureView(eye.phantoms.views().place),
                wgpu::BindingResource::TextureView(&eye.picture.view),
            ],
        );
        Self {
            pipeline,
            bindings,
            size_px: eye.size_px(),
        }
    }

    /// Draws the eye's picture, after the places of both views.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("reproject");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("reproject"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
    }
}
