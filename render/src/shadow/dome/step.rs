//! A compute pass with its bindings.

use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// A compute pass that is bound once and recorded every frame.
#[derive(Debug)]
pub(crate) struct Step {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
}

impl Step {
    /// The pass `name`, its resources bound in order.
    pub(crate) fn new(gpu: &Gpu, name: &'static str, resources: &[wgpu::BindingResource<'_>]) -> Self {
        let pipeline = gpu.compute_pipeline(name);
        let bindings = gpu.bind(name, &pipeline.get_bind_group_layout(0), resources);
        Self {
            name,
            pipeline,
            bindings,
        }
    }

    /// Runs the pass over so many workgroups.
    pub(crate) fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, [x, y, z]: [u32; 3]) {
        let span = timer.span(self.name);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.name),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(x, y, z);
    }
}
