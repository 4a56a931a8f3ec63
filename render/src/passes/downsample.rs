//! Mips of the environments, weighted by solid angle, and the nodes of their light trees.

use super::ENVIRONMENT_MIPS;
use crate::environments::{Environments, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::light_tree::{LEAF_SIZE, LEVELS};
use mirrorball_calib::probe::cube::FACES;

/// Nodes of the finest level that a workgroup makes, along one edge.
const GROUP_SIZE: u32 = 16;

/// The pass, bound to cubes.
#[derive(Debug)]
pub struct Downsample {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl Downsample {
    /// Binds the pass to the cubes of `slots` in `cubes`, a texture of the environments' size; their light trees go to the
    /// slots' nodes.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, (cubes, slots): (&wgpu::Texture, &[u32])) -> Self {
        // Every level of the tree is one mip.
        const { assert!(ENVIRONMENT_MIPS == LEVELS + 1) };
        let pipeline = gpu.compute_pipeline("downsample");
        let bindings = slots
            .iter()
            .map(|&slot| {
                let mips: Vec<_> = (0..ENVIRONMENT_MIPS)
                    .map(|mip| cubes.create_view(&faces_view(slot, mip)))
                    .collect();
                let mut resources = vec![
                    wgpu::BindingResource::TextureView(&mips[0]),
                    environments.nodes_of(slot),
                ];
                resources.extend(mips[1..].iter().map(wgpu::BindingResource::TextureView));
                gpu.bind("downsample", &pipeline.get_bind_group_layout(0), &resources)
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Fills all mips but the first, and the nodes.
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
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(LEAF_SIZE / GROUP_SIZE, LEAF_SIZE / GROUP_SIZE, FACES as u32);
        }
    }
}
