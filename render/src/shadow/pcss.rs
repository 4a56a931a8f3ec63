//! Percentage-closer soft shadows (Fernando 2005): a filter as wide as the penumbra of what blocks the light.

use super::atlas::MapAtlas;
use super::key::{Job, KeyShadow};
use super::light::ShadowLight;
use super::map_view::map_views;
use super::nearest::NearestPass;
use super::pcf::{PcfShadow, Taps};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// The passes.
#[derive(Debug)]
pub struct PcssShadow {
    map_size: u32,
    atlas: MapAtlas,
    nearest: NearestPass,
    pipeline: wgpu::ComputePipeline,
    /// For lights without extent, which have no penumbra; made with the first of them.
    sharp: Option<PcfShadow>,
}

impl PcssShadow {
    /// Passes with maps of `map_size` texels a side.
    #[must_use]
    pub fn new(gpu: &Gpu, map_size: u32) -> Self {
        Self {
            map_size,
            atlas: MapAtlas::new(gpu, "pcss", map_size),
            nearest: NearestPass::new(gpu),
            pipeline: gpu.compute_pipeline("shadow_pcss"),
            sharp: None,
        }
    }
}

impl KeyShadow for PcssShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        if !matches!(job.light, ShadowLight::Rect { .. }) {
            let sharp = self
                .sharp
                .get_or_insert_with(|| PcfShadow::new(gpu, self.map_size, Taps::Nine));
            return sharp.record(gpu, encoder, timer, job);
        }
        let size_px = self.atlas.size_for(gpu, 1);
        let views = map_views(job.light, job.casters, size_px);
        self.atlas.set_views(gpu, &views, ([1, 1], size_px));
        let span = timer.span("shadow_depth");
        self.atlas.record(gpu, encoder, span.render(Ends::Both), (job, 0));
        self.nearest.record(gpu, encoder, timer, (self.atlas.depth(), size_px));
        let [shape, views] = self.atlas.bindings();
        let bindings = gpu.bind(
            "shadow_pcss",
            &self.pipeline.get_bind_group_layout(0),
            &[
                shape,
                views,
                job.light_buffer.as_entire_binding(),
                wgpu::BindingResource::TextureView(self.atlas.depth()),
                self.nearest.levels().as_entire_binding(),
                wgpu::BindingResource::TextureView(&job.surface.place),
                wgpu::BindingResource::TextureView(&job.surface.normal),
                wgpu::BindingResource::TextureView(job.visibility),
            ],
        );
        let span = timer.span("shadow_pcss");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow_pcss"),
            timestamp_writes: span.compute(Ends::Both),
        });
        let [width, height] = job.surface.view.size_px;
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        Ok(())
    }
}
