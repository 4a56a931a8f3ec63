//! Mips of the rooms around the virtual objects, for rays that stand for more than a line.

use super::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE, groups};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct RoomMips {
    pipeline: wgpu::ComputePipeline,
    /// One per mip below the first.
    bindings: Vec<wgpu::BindGroup>,
    n_layers: u32,
}

impl RoomMips {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments) -> Self {
        let pipeline = gpu.compute_pipeline("room_mips");
        let mip = |level| {
            environments.room.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                base_mip_level: level,
                mip_level_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            })
        };
        let bindings = (1..ENVIRONMENT_MIPS)
            .map(|level| {
                gpu.bind(
                    "room_mips",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        wgpu::BindingResource::TextureView(&mip(level - 1)),
                        wgpu::BindingResource::TextureView(&mip(level)),
                    ],
                )
            })
            .collect();
        Self {
            pipeline,
            bindings,
            n_layers: environments.room.depth_or_array_layers(),
        }
    }

    /// Fills the mips below the first.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("room_mips");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("room_mips"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for (level, bindings) in (1..).zip(&self.bindings) {
            let size = groups(ENVIRONMENT_SIZE >> level);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(size, size, self.n_layers);
        }
    }
}
