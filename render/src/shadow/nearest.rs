//! The nearest depths of a shadow map, level by level.

use crate::gpu::Gpu;
use crate::gpu::pass::TextureShape;
use crate::gpu::timer::{Ends, Timer};

/// Format of the levels.
const NEAREST_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// The pass with its result.
#[derive(Debug)]
pub struct NearestPass {
    first: wgpu::ComputePipeline,
    further: wgpu::ComputePipeline,
    /// Edge of the map that the levels are made for, texels; 0 at first.
    map_size_px: u32,
    /// Views of the levels, finest first.
    levels: Vec<wgpu::TextureView>,
    all: wgpu::TextureView,
}

impl NearestPass {
    /// The pass for a map of any size.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let variant = |is_first: f64| gpu.compute_pipeline_variant("shadow_nearest", &[("IS_FIRST", is_first)]);
        let (levels, all) = levels_of(gpu, 1);
        Self {
            first: variant(1.0),
            further: variant(0.0),
            map_size_px: 0,
            levels,
            all,
        }
    }

    /// All levels: texel (x, y) of level n holds the nearest depth of the 2ⁿ⁺¹ × 2ⁿ⁺¹ texels from 2ⁿ⁺¹ (x, y) on.
    #[must_use]
    pub fn levels(&self) -> &wgpu::TextureView {
        &self.all
    }

    /// Reduces a square depth map.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (depth, map_size_px): (&wgpu::TextureView, u32),
    ) {
        if self.map_size_px != map_size_px {
            self.map_size_px = map_size_px;
            (self.levels, self.all) = levels_of(gpu, map_size_px.div_ceil(2).next_power_of_two());
        }
        let span = timer.span("shadow_nearest");
        let n_levels = self.levels.len();
        for (index, level) in self.levels.iter().enumerate() {
            let pipeline = if index == 0 { &self.first } else { &self.further };
            // The first level's shader does not read a finer one, but is bound to one that is not being written.
            let finer = &self.levels[if index == 0 { n_levels - 1 } else { index - 1 }];
            let bindings = gpu.bind(
                "shadow_nearest",
                &pipeline.get_bind_group_layout(0),
                &[
                    wgpu::BindingResource::TextureView(depth),
                    wgpu::BindingResource::TextureView(finer),
                    wgpu::BindingResource::TextureView(level),
                ],
            );
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("shadow_nearest"),
                timestamp_writes: span.compute(Ends::of(index, n_levels)),
            });
            let edge = 1u32 << (n_levels - 1 - index);
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(edge.div_ceil(8), edge.div_ceil(8), 1);
        }
    }
}

/// Levels from `finest_px` (a power of two) down to one texel, each alone and all together; two at least.
fn levels_of(gpu: &Gpu, finest_px: u32) -> (Vec<wgpu::TextureView>, wgpu::TextureView) {
    let finest_px = finest_px.max(2);
    let mips = finest_px.ilog2() + 1;
    let shape = TextureShape {
        mips,
        ..TextureShape::plain([finest_px; 2])
    };
    let texture = gpu.target("shadow_nearest", shape, NEAREST_FORMAT);
    let view = |base_mip_level, mip_level_count| {
        texture.create_view(&wgpu::TextureViewDescriptor {
            base_mip_level,
            mip_level_count: Some(mip_level_count),
            ..wgpu::TextureViewDescriptor::default()
        })
    };
    ((0..mips).map(|level| view(level, 1)).collect(), view(0, mips))
}
