//! Distances from a virtual object's middle to the phantoms around it, found anew when one of them has moved.
//!
//! The CPU finds the first ones ([`crate::probe::surroundings`], which this pass equals).

use super::{ENVIRONMENT_SIZE, groups};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::scene_rays::SceneRays;
use mirrorball_calib::probe::cube::FACES;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct Surroundings {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl Surroundings {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, rays: &SceneRays) -> Self {
        let pipeline = gpu.compute_pipeline("surroundings");
        let [nodes, triangles, instances, _] = rays.resources();
        let bindings = environments
            .slots
            .iter()
            .map(|slot| {
                gpu.bind(
                    "surroundings",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        nodes.clone(),
                        triangles.clone(),
                        instances.clone(),
                        slot.parameters.as_entire_binding(),
                        slot.hit_m.as_entire_binding(),
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Refills the distances around the environments that have moved, or around which phantoms have.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, environments: &Environments) {
        let mut stale = environments.stale_slots().peekable();
        if stale.peek().is_none() {
            return;
        }
        let span = timer.span("surroundings");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("surroundings"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for slot in stale {
            pass.set_bind_group(0, &self.bindings[slot], &[]);
            pass.dispatch_workgroups(groups(ENVIRONMENT_SIZE), groups(ENVIRONMENT_SIZE), FACES as u32);
        }
    }
}
