//! What is seen through virtual glass.

use super::groups;
use super::ray_light::{self, Inputs, RayPass};
use super::virtual_surface::VirtualSurface;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::surface::SurfaceViews;

/// The pass with its target.
#[derive(Debug)]
pub struct Refract {
    rays: RayPass,
    target: wgpu::TextureView,
    size_px: [u32; 2],
}

impl Refract {
    /// A pass for the virtual objects in `surfaces` (places) and `substances`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, (surfaces, substances): (SurfaceViews<'_>, &VirtualSurface)) -> Self {
        let target = gpu
            .texture(
                "refract: radiance",
                TextureShape::plain(surfaces.size_px),
                RADIANCE_FORMAT,
            )
            .create_view(&wgpu::TextureViewDescriptor::default());
        let others = [
            wgpu::BindingResource::TextureView(surfaces.place),
            wgpu::BindingResource::TextureView(substances.gloss()),
            wgpu::BindingResource::TextureView(substances.shape()),
            wgpu::BindingResource::TextureView(substances.glass()),
            wgpu::BindingResource::TextureView(&target),
        ];
        let rays = ray_light::pass(gpu, ("refract", &[]), inputs, &others);
        Self {
            rays,
            target,
            size_px: surfaces.size_px,
        }
    }

    /// Radiance through the first surface of glass, as if it let all light in; linear RGB, black elsewhere.
    #[must_use]
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.target
    }

    /// Follows the rays.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("refract");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("refract"),
            timestamp_writes: span.compute(Ends::Both),
        });
        self.rays.set(&mut pass);
        pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
    }
}
