//! Light from near things on each virtual object, as spherical harmonics.

use crate::environments::{Environments, SH_STRIDE_BYTES, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct Irradiance {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl Irradiance {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments) -> Self {
        let pipeline = gpu.compute_pipeline("irradiance");
        let bindings = environments
            .slots
            .iter()
            .enumerate()
            .map(|(slot, environment)| {
                let faces = environments.radiance.create_view(&faces_view(slot as u32, 0));
                let coefficients = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: &environments.near_sh,
                    offset: slot as u64 * SH_STRIDE_BYTES,
                    size: std::num::NonZeroU64::new(SH_STRIDE_BYTES),
                });
                gpu.bind(
                    "irradiance",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        wgpu::BindingResource::TextureView(&faces),
                        environment.hit_m.as_entire_binding(),
                        coefficients,
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Projects every environment.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("irradiance");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("irradiance"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(1, 1, 1);
        }
    }
}
