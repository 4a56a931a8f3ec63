//! What virtual objects mirror: rays from every pixel that shows one, and the filter that puts neighbours' rays together.

use super::groups;
use super::ray_light::{self, Inputs, RayPass};
use super::virtual_surface::VirtualSurface;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::surface::SurfaceViews;

/// Below this perceptual roughness a surface is a perfect mirror: a lobe of alpha 0.0025 is narrower than a pixel's ray.
pub const MIRROR_ROUGHNESS: f64 = 0.05;

/// Both passes with their targets.
#[derive(Debug)]
pub struct Reflect {
    trace: RayPass,
    filter: (wgpu::ComputePipeline, wgpu::BindGroup),
    filtered: wgpu::TextureView,
    size_px: [u32; 2],
}

impl Reflect {
    /// Passes for the virtual objects in `surfaces` (places) and `substances`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, (surfaces, substances): (SurfaceViews<'_>, &VirtualSurface)) -> Self {
        let constants = [("MIRROR_ROUGHNESS", MIRROR_ROUGHNESS)];
        let target = |label| {
            gpu.texture(label, TextureShape::plain(surfaces.size_px), RADIANCE_FORMAT)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let (traced, filtered) = (target("reflect: radiance"), target("reflect: filtered"));
        let surface = [surfaces.place, substances.gloss(), substances.shape()].map(wgpu::BindingResource::TextureView);
        let mut others = surface.to_vec();
        others.push(inputs.scene.objects.as_entire_binding());
        others.push(wgpu::BindingResource::TextureView(&traced));
        let trace = ray_light::pass(gpu, ("reflect", &constants), inputs, &others);
        let filter = gpu.compute_pipeline_variant("reflect_filter", &constants);
        let mut resources = surface.to_vec();
        resources.extend([&traced, &filtered].map(wgpu::BindingResource::TextureView));
        let filter_bindings = gpu.bind("reflect_filter", &filter.get_bind_group_layout(0), &resources);
        Self {
            trace,
            filter: (filter, filter_bindings),
            filtered,
            size_px: surfaces.size_px,
        }
    }

    /// Mean radiance over the lobes of the virtual surfaces around their mirrored directions, linear RGB.
    #[must_use]
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.filtered
    }

    /// Follows the rays and filters what they found.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let mut over_picture = |label, set: &dyn Fn(&mut wgpu::ComputePass<'_>)| {
            let span = timer.span(label);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(label),
                timestamp_writes: span.compute(Ends::Both),
            });
            set(&mut pass);
            pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
        };
        over_picture("reflect", &|pass| self.trace.set(pass));
        over_picture("reflect_filter", &|pass| {
            pass.set_pipeline(&self.filter.0);
            pass.set_bind_group(0, &self.filter.1, &[]);
        });
    }
}
