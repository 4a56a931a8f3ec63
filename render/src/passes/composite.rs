//! Camera picture, ratios and virtual objects into the final picture.

use super::groups;
use crate::camera_view::CameraView;
use crate::codes::Codes;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuNoise;
use crate::passes::lamp_receive::LampReceive;
use crate::passes::receive::Receive;
use crate::passes::shade::Shade;

/// The pass with its result.
#[derive(Debug)]
pub struct Composite {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    codes: Codes,
    noise: wgpu::Buffer,
}

impl Composite {
    /// A pass for the pictures of `view`; noise is none until [`Composite::set_noise`].
    #[must_use]
    pub fn new(gpu: &Gpu, view: &CameraView, (shade, receive, lamps): (&Shade, &Receive, &LampReceive)) -> Self {
        let size_px = view.size_px();
        let pipeline = gpu.compute_pipeline("composite");
        let codes = Codes::new(gpu, "composite: codes", size_px);
        let noise = gpu.buffer("composite: noise", &[<GpuNoise as bytemuck::Zeroable>::zeroed()]);
        let bindings = gpu.bind(
            "composite",
            &pipeline.get_bind_group_layout(0),
            &[
                view.camera.as_entire_binding(),
                view.picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&view.picture.view),
                wgpu::BindingResource::TextureView(shade.radiance()),
                wgpu::BindingResource::TextureView(receive.ratio()),
                codes.buffer().as_entire_binding(),
                wgpu::BindingResource::TextureView(lamps.radiance()),
                noise.as_entire_binding(),
            ],
        );
        Self {
            pipeline,
            bindings,
            codes,
            noise,
        }
    }

    /// The noise that the pixels of the next picture get where they are not the camera's own.
    pub fn set_noise(&self, gpu: &Gpu, noise: &GpuNoise) {
        gpu.write(&self.noise, &[*noise]);
    }

    /// The finished picture.
    #[must_use]
    pub fn codes(&self) -> &Codes {
        &self.codes
    }

    /// Mixes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("composite");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("composite"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        let [width, height] = self.codes.size_px();
        pass.dispatch_workgroups(groups(width), groups(height), 1);
    }
}
