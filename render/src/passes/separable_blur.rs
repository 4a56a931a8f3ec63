//! Irradiance by blurring each face as a picture, for comparison: Supan 2006, 3.4.1.
//!
//! His four taps are one texel apart and begin 1.5 texels before the texel, so that each lies between two texels; his
//! listing then adds one texel too many, which moves the picture along with every pass, and is left out. He blurs the
//! picture of the ball once; here each face of a cube is blurred so often that the result is about as wide as a cosine.

use super::ENVIRONMENT_SIZE;
use super::irradiance_cube::IRRADIANCE_SIZE;
use crate::environments::{Environments, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use mirrorball_calib::probe::cube::FACES;

/// How often the blur goes over rows and columns. Each time adds 1.5 texels² to the variance: 6 texels of 1/16 in the end,
/// 21° in the middle of a face.
pub const ITERATIONS: u32 = 24;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct SeparableBlur {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl SeparableBlur {
    /// Binds the pass to the environments of `slots`, whose mips are up to date when it runs.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, slots: &[u32]) -> Self {
        let pipeline = gpu.compute_pipeline("separable_blur");
        let mip = (ENVIRONMENT_SIZE / IRRADIANCE_SIZE).ilog2();
        let bindings = slots
            .iter()
            .map(|&slot| {
                let source = environments.radiance.create_view(&faces_view(slot, mip));
                let out = environments.irradiance.create_view(&faces_view(slot, 0));
                gpu.bind(
                    "separable_blur",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        wgpu::BindingResource::TextureView(&source),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Fills the irradiance cubes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("separable_blur");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("separable_blur"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(FACES as u32, 1, 1);
        }
    }
}
