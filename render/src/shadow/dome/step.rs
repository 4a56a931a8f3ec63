//! A compute pass with its bindings.

use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::scene_materials::SceneMaterials;

/// A compute pass that is bound once and recorded every frame.
#[derive(Debug)]
pub(crate) struct Step {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    /// Group 1, of passes that ask for what objects are made of.
    materials: Option<wgpu::BindGroup>,
}

impl Step {
    /// The pass `name`, its resources bound in order.
    pub(crate) fn new(gpu: &Gpu, name: &'static str, resources: &[wgpu::BindingResource<'_>]) -> Self {
        let entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding,
                resource: resource.clone(),
            })
            .collect();
        Self::with_entries(gpu, name, &entries)
    }

    /// The pass `name`, which leaves some bindings out.
    pub(crate) fn with_entries(gpu: &Gpu, name: &'static str, entries: &[wgpu::BindGroupEntry<'_>]) -> Self {
        let pipeline = gpu.compute_pipeline(name);
        let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(name),
            layout: &pipeline.get_bind_group_layout(0),
            entries,
        });
        Self {
            name,
            pipeline,
            bindings,
            materials: None,
        }
    }

    /// The pass, which asks for what objects are made of.
    pub(crate) fn with_materials(self, gpu: &Gpu, materials: &SceneMaterials) -> Self {
        let layout = self.pipeline.get_bind_group_layout(1);
        Self {
            materials: Some(materials.bind_shape(gpu, &layout)),
            ..self
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
        if let Some(materials) = &self.materials {
            pass.set_bind_group(1, materials, &[]);
        }
        pass.dispatch_workgroups(x, y, z);
    }
}
