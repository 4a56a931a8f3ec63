//! Camera picture, ratios and virtual objects into the final picture.

use super::groups;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;
use crate::gpu::timer::{Ends, Timer};
use crate::passes::receive::Receive;
use crate::passes::shade::Shade;
use crate::scene_gpu::PictureBuffers;

/// The pass with its result.
#[derive(Debug)]
pub struct Composite {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    out: Readback,
    size_px: [u32; 2],
}

impl Composite {
    /// A pass for pictures of `size_px`, with the scene camera in the uniform buffer `camera`.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        camera: &wgpu::Buffer,
        picture: &PictureBuffers,
        (shade, receive): (&Shade, &Receive),
        size_px: [u32; 2],
    ) -> Self {
        let pipeline = gpu.compute_pipeline("composite");
        let out = Readback::new(
            gpu,
            "composite: codes",
            4 * u64::from(size_px[0]) * u64::from(size_px[1]),
        );
        let bindings = gpu.bind(
            "composite",
            &pipeline.get_bind_group_layout(0),
            &[
                camera.as_entire_binding(),
                picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&picture.view),
                wgpu::BindingResource::TextureView(shade.radiance()),
                wgpu::BindingResource::TextureView(receive.ratio()),
                out.buffer().as_entire_binding(),
                wgpu::BindingResource::TextureView(receive.added()),
            ],
        );
        Self {
            pipeline,
            bindings,
            out,
            size_px,
        }
    }

    /// Mixes, and copies the result to memory.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        {
            let span = timer.span("composite");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("composite"),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
        }
        self.out.record(encoder);
    }

    /// The finished picture as 8-bit RGBA, once submitted.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<u8>, RenderError> {
        let mut rgba = vec![0; 4 * (self.size_px[0] * self.size_px[1]) as usize];
        self.out.read(gpu, &mut rgba)?;
        Ok(rgba)
    }
}
