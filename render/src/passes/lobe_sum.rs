//! What the passes share that filter a cube with a lobe: lists of nodes and one dispatch per mip
//! (`shaders/shared/lobe_sum.wgsl`).

use crate::environments::{Environments, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuLobe;
use crate::light_tree::{Lobe, NodeLists};

/// Tiles of a workgroup; sixteen threads share the nodes of each.
const GROUP_TILES: u32 = 4;

/// What is written.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Output<'a> {
    /// Cubes, six layers per slot.
    pub(crate) texture: &'a wgpu::Texture,
    /// Mips and their lobes.
    pub(crate) lobes: &'a [(u32, Lobe)],
    /// Factor of the lobe's mean.
    pub(crate) factor: f32,
}

/// A pipeline with a dispatch per slot and mip.
#[derive(Debug)]
pub(crate) struct LobeSum {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    dispatches: Vec<(u32, wgpu::BindGroup)>,
}

impl LobeSum {
    /// The shader `name` for the light trees of `slots`.
    pub(crate) fn new(
        gpu: &Gpu,
        name: &'static str,
        (environments, slots): (&Environments, &[u32]),
        output: Output<'_>,
    ) -> Self {
        let pipeline = gpu.compute_pipeline(name);
        let mut dispatches = Vec::new();
        for &(mip, lobe) in output.lobes {
            let size = output.texture.width() >> mip;
            let lists = NodeLists::new(size, lobe);
            let label = |what: &str| format!("{name}: {what}");
            let parameters = gpu.buffer(&label("lobe"), &[GpuLobe::new(lobe, size, output.factor)]);
            let tiles = gpu.buffer(&label("tiles"), &lists.tiles);
            let entries = gpu.buffer(&label("entries"), &lists.entries);
            let scale = gpu.buffer(&label("scale"), &lists.scale);
            let groups = (lists.tiles.len() as u32).div_ceil(GROUP_TILES);
            for &slot in slots {
                let out = output.texture.create_view(&faces_view(slot, mip));
                let bindings = gpu.bind(
                    name,
                    &pipeline.get_bind_group_layout(0),
                    &[
                        parameters.as_entire_binding(),
                        environments.nodes_of(slot),
                        tiles.as_entire_binding(),
                        entries.as_entire_binding(),
                        scale.as_entire_binding(),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                );
                dispatches.push((groups, bindings));
            }
        }
        Self {
            name,
            pipeline,
            dispatches,
        }
    }

    /// Filters all mips of all slots.
    pub(crate) fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.dispatches.is_empty() {
            return;
        }
        let span = timer.span(self.name);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.name),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for (groups, bindings) in &self.dispatches {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(*groups, 1, 1);
        }
    }
}
