//! Shadow map with one comparison (Williams 1978, "Casting curved shadows on curved surfaces") or percentage-closer filtered
//! (Reeves, Salesin, Cook 1987, "Rendering antialiased shadows with depth maps").

use super::atlas::MapAtlas;
use super::key::{Job, KeyShadow};
use super::map_view::map_views;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// Comparisons per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taps {
    /// One.
    One,
    /// 3 × 3.
    Nine,
    /// 5 × 5.
    TwentyFive,
    /// 7 × 7.
    FortyNine,
}

/// The passes.
#[derive(Debug)]
pub struct PcfShadow {
    atlas: MapAtlas,
    pipeline: wgpu::ComputePipeline,
}

impl Taps {
    /// Comparisons along each axis, a texel apart.
    #[must_use]
    pub fn per_side(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Nine => 3,
            Self::TwentyFive => 5,
            Self::FortyNine => 7,
        }
    }
}

impl PcfShadow {
    /// Passes with maps of `map_size` texels a side, six of them for a light in the middle of things.
    #[must_use]
    pub fn new(gpu: &Gpu, map_size: u32, taps: Taps) -> Self {
        Self {
            atlas: MapAtlas::new(gpu, "map", map_size),
            pipeline: gpu.compute_pipeline_variant("shadow_pcf", &[("TAPS", f64::from(taps.per_side()))]),
        }
    }
}

impl KeyShadow for PcfShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let mut size_px = self.atlas.size_for(gpu, 1);
        let mut views = map_views(job.light, job.casters, size_px);
        let mut columns_rows = [1, 1];
        if views.len() > 1 {
            columns_rows = [3, 2];
            size_px = self.atlas.size_for(gpu, 3);
            views = map_views(job.light, job.casters, size_px);
        }
        self.atlas.set_views(gpu, &views, (columns_rows, size_px));
        let timestamps = timer.span("shadow_depth");
        self.atlas.record(gpu, encoder, timestamps.render(Ends::Both), (job, 0));
        let [shape, views] = self.atlas.bindings();
        let bindings = gpu.bind(
            "shadow_pcf",
            &self.pipeline.get_bind_group_layout(0),
            &[
                shape,
                views,
                wgpu::BindingResource::TextureView(self.atlas.depth()),
                wgpu::BindingResource::TextureView(&job.surface.place),
                wgpu::BindingResource::TextureView(&job.surface.normal),
                wgpu::BindingResource::TextureView(job.visibility),
            ],
        );
        let span = timer.span("shadow_pcf");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow_pcf"),
            timestamp_writes: span.compute(Ends::Both),
        });
        let [width, height] = job.surface.view.size_px;
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        Ok(())
    }
}
