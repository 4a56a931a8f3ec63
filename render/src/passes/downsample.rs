//! Mips of the environments: means of 2 × 2 texels.

use super::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE, groups};
use crate::environments::{Environments, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use mirrorball_calib::probe::cube::FACES;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct Downsample {
    pipeline: wgpu::ComputePipeline,
    /// Per environment that reflects and per mip but the first.
    bindings: Vec<(u32, wgpu::BindGroup)>,
}

impl Downsample {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments) -> Self {
        let pipeline = gpu.compute_pipeline("downsample");
        let mut bindings = Vec::new();
        for (slot, _) in environments.slots.iter().enumerate().filter(|(_, slot)| slot.is_glossy) {
            for mip in 1..ENVIRONMENT_MIPS {
                let view = |mip| environments.radiance.create_view(&faces_view(slot as u32, mip));
                let (source, out) = (view(mip - 1), view(mip));
                let group = gpu.bind(
                    "downsample",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        wgpu::BindingResource::TextureView(&source),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                );
                bindings.push((mip, group));
            }
        }
        Self { pipeline, bindings }
    }

    /// Fills all mips but the first.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("downsample");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("downsample"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for (mip, bindings) in &self.bindings {
            let n = groups(ENVIRONMENT_SIZE >> mip);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(n, n, FACES as u32);
        }
    }
}
