//! All the light of each environment, near and far, as spherical harmonics.

use crate::environments::{Environments, harmonics_binding};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::light_tree::{level_size, level_start};
use mirrorball_calib::probe::cube::FACES;

/// Level of the light tree that is summed: 32 × 32 nodes a face. Harmonics of order 2 change little over 2.8°.
const LEVEL: u32 = 1;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct Harmonics {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl Harmonics {
    /// Binds the pass to the light trees of `slots`.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, slots: &[u32]) -> Self {
        let pipeline = gpu.compute_pipeline("harmonics");
        let n_nodes = FACES as u32 * level_size(LEVEL).pow(2);
        let level = gpu.buffer("harmonics: level", &[[level_start(LEVEL), n_nodes, 0, 0]]);
        let bindings = slots
            .iter()
            .map(|&slot| {
                gpu.bind(
                    "harmonics",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        level.as_entire_binding(),
                        environments.nodes_of(slot),
                        harmonics_binding(&environments.harmonics, slot),
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Projects the light.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("harmonics");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("harmonics"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(1, 1, 1);
        }
    }
}
