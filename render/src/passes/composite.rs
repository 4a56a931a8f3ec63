//! Camera picture, ratios and virtual objects into the final picture.

use super::groups;
use crate::codes::Codes;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuNoise;
use crate::passes::receive::Receive;
use crate::passes::shade::Shade;
use crate::scene_gpu::PictureBuffers;

/// The pass with its result.
#[derive(Debug)]
pub struct Composite {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    codes: Codes,
    noise: wgpu::Buffer,
}

impl Composite {
    /// A pass for pictures of `size_px`, with the scene camera in the uniform buffer `camera`; noise is none until
    /// [`Composite::set_noise`].
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        camera: &wgpu::Buffer,
        picture: &PictureBuffers,
        (shade, receive): (&Shade, &Receive),
        size_px: [u32; 2],
    ) -> Self {
        let pipeline = gpu.compute_pipeline("composite");
        let codes = Codes::new(gpu, "composite: codes", size_px);
        let noise = gpu.buffer("composite: noise", &[<GpuNoise as bytemuck::Zeroable>::zeroed()]);
        let bindings = gpu.bind(
            "composite",
            &pipeline.get_bind_group_layout(0),
            &[
                camera.as_entire_binding(),
                picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&picture.view),
                wgpu::BindingResource::TextureView(shade.radiance()),
                wgpu::BindingResource::TextureView(receive.ratio()),
                codes.buffer().as_entire_binding(),
                wgpu::BindingResource::TextureView(receive.added()),
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
