//! The nearest depths of a shadow map, level by level.
//!
//! The levels lie in a buffer instead of a texture's mips: every thread reads another level, and software drivers read
//! one level for several threads at a time.

use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// The pass with its result.
#[derive(Debug)]
pub struct NearestPass {
    pipeline: wgpu::ComputePipeline,
    /// Edge of the map that the levels are made for, texels; 0 at first.
    map_size_px: u32,
    levels: Vec<Level>,
    nearest: wgpu::Buffer,
}

#[derive(Debug)]
struct Level {
    edge: u32,
    place: wgpu::Buffer,
}

impl NearestPass {
    /// The pass for a map of any size.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            pipeline: gpu.compute_pipeline("shadow_nearest"),
            map_size_px: 0,
            levels: Vec::new(),
            nearest: gpu.buffer("shadow_nearest", &[0.0f32]),
        }
    }

    /// All levels one after the other, each row by row: texel (x, y) of level n holds the nearest depth of the
    /// 2ⁿ⁺¹ × 2ⁿ⁺¹ texels from 2ⁿ⁺¹ (x, y) on. The finest is half as wide as the map, rounded up to a power of two.
    #[must_use]
    pub fn levels(&self) -> &wgpu::Buffer {
        &self.nearest
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
            self.resize(gpu, map_size_px);
        }
        let span = timer.span("shadow_nearest");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow_nearest"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for level in &self.levels {
            let bindings = gpu.bind(
                "shadow_nearest",
                &self.pipeline.get_bind_group_layout(0),
                &[
                    level.place.as_entire_binding(),
                    wgpu::BindingResource::TextureView(depth),
                    self.nearest.as_entire_binding(),
                ],
            );
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(level.edge.div_ceil(8), level.edge.div_ceil(8), 1);
        }
    }

    fn resize(&mut self, gpu: &Gpu, map_size_px: u32) {
        self.map_size_px = map_size_px;
        self.levels.clear();
        let (mut edge, mut start, mut finer) = (map_size_px.div_ceil(2).next_power_of_two(), 0u32, 0u32);
        while edge > 0 {
            let place = [edge, start, finer, u32::from(start == 0)];
            self.levels.push(Level {
                edge,
                place: gpu.buffer("shadow_nearest: level", &[place]),
            });
            (finer, start, edge) = (start, start + edge * edge, edge / 2);
        }
        self.nearest = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("shadow_nearest"),
            size: 4 * u64::from(start),
            usage: wgpu::BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
    }
}
