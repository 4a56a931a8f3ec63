//! The real mirror ball shows virtual objects.

use super::groups;
use super::ray_light::{self, Inputs, RayPass};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};

/// The pass with its target.
#[derive(Debug)]
pub struct BallMirror {
    rays: RayPass,
    target: wgpu::Texture,
    ratio: wgpu::Texture,
    size_px: [u32; 2],
}

impl BallMirror {
    /// A pass that changes `ratio`, that of [`crate::passes::receive`].
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, ratio: &wgpu::TextureView) -> Self {
        let size_px = inputs.view.size_px();
        let target = gpu.texture("ball_mirror: ratio", TextureShape::plain(size_px), RADIANCE_FORMAT);
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let others = [ratio, &view].map(wgpu::BindingResource::TextureView);
        let rays = ray_light::pass(gpu, ("ball_mirror", &[]), inputs, &others);
        Self {
            rays,
            target,
            ratio: ratio.texture().clone(),
            size_px,
        }
    }

    /// Writes the ball's pixels of the ratio.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        {
            let span = timer.span("ball_mirror");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("ball_mirror"),
                timestamp_writes: span.compute(Ends::Both),
            });
            self.rays.set(&mut pass);
            pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
        }
        encoder.copy_texture_to_texture(
            self.target.as_image_copy(),
            self.ratio.as_image_copy(),
            self.target.size(),
        );
    }
}
