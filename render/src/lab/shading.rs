//! Surfaces as radiance: one light past its shadow, and ambient light. Matt surfaces only, so that methods are compared by
//! their shadows.

use glam::{Vec3, Vec4};

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::surface::Surface;

/// The pass with its result.
#[derive(Debug)]
pub struct Shading {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    ambient: wgpu::Buffer,
    radiance: wgpu::Texture,
    size_px: [u32; 2],
}

impl Shading {
    /// A pass that reads a surface, the light ([`crate::shadow::light::GpuShadowLight`]) and its visibility.
    #[must_use]
    pub fn new(gpu: &Gpu, surface: &Surface, (light, visibility): (&wgpu::Buffer, &wgpu::TextureView)) -> Self {
        let size_px = surface.view.size_px;
        let pipeline = gpu.compute_pipeline("lab_shade");
        let ambient = gpu.buffer("lab: ambient", &[Vec4::ZERO]);
        let radiance = gpu.target("lab: radiance", TextureShape::plain(size_px), RADIANCE_FORMAT);
        let bindings = gpu.bind(
            "lab_shade",
            &pipeline.get_bind_group_layout(0),
            &[
                light.as_entire_binding(),
                ambient.as_entire_binding(),
                wgpu::BindingResource::TextureView(&surface.place),
                wgpu::BindingResource::TextureView(&surface.normal),
                wgpu::BindingResource::TextureView(&surface.color),
                wgpu::BindingResource::TextureView(visibility),
                wgpu::BindingResource::TextureView(&radiance.create_view(&wgpu::TextureViewDescriptor::default())),
            ],
        );
        Self {
            pipeline,
            bindings,
            ambient,
            radiance,
            size_px,
        }
    }

    /// Uploads the radiance that comes from everywhere; `is_irradiance`: the visibility holds the irradiance of all light
    /// instead.
    pub fn write(&self, gpu: &Gpu, ambient: Vec3, is_irradiance: bool) {
        gpu.write(&self.ambient, &[ambient.extend(f32::from(is_irradiance))]);
    }

    /// Fills a visibility with 1.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder, visibility: &wgpu::TextureView) {
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("lab: no shadow"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: visibility,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::WHITE),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..wgpu::RenderPassDescriptor::default()
        });
    }

    /// Shades.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("lab_shade");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("lab_shade"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(self.size_px[0].div_ceil(8), self.size_px[1].div_ceil(8), 1);
    }

    /// Where the radiance goes.
    #[must_use]
    pub fn radiance_view(&self) -> wgpu::TextureView {
        self.radiance.create_view(&wgpu::TextureViewDescriptor::default())
    }

    /// The radiance, once submitted; rows from the top, w 1 where there is a surface.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<Vec4>, RenderError> {
        gpu.read_half(&self.radiance)
    }
}
