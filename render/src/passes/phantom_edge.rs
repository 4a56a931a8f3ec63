//! Edges of phantoms before virtual objects, where the picture has them.
//!
//! A phantom hides what is behind it as far as its mesh reaches, and meshes, poses and lenses are off by a pixel or two. So a
//! rim of the background stays between thing and object, or the object runs over the thing's rim. Within two pixels of such an
//! edge the picture decides: pixels farther off are certain to be thing or background; the two colours that they show nearby
//! tell how much of a pixel between is thing (a matte of two colours: Ruzon and Tomasi 2000, without their clusters). Where
//! the two sides look alike, or a pixel looks like neither, the mesh's edge stays.
//!
//! Radiance of the object where the mesh hid it comes from its pixels beside.

use super::groups;
use crate::camera_view::CameraView;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};

/// The pass with its target.
#[derive(Debug)]
pub struct PhantomEdge {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    refined: wgpu::Texture,
    shaded: wgpu::Texture,
    size_px: [u32; 2],
}

impl PhantomEdge {
    /// A pass that changes `shaded`, the virtual objects as radiance times coverage in the picture of `view`; they are at
    /// `virtual_places` if no phantom hides them.
    #[must_use]
    pub fn new(gpu: &Gpu, view: &CameraView, virtual_places: &wgpu::TextureView, shaded: &wgpu::TextureView) -> Self {
        let size_px = view.size_px();
        let pipeline = gpu.compute_pipeline("phantom_edge");
        let refined = gpu.texture("phantom_edge: radiance", TextureShape::plain(size_px), RADIANCE_FORMAT);
        let bindings = gpu.bind(
            "phantom_edge",
            &pipeline.get_bind_group_layout(0),
            &[
                view.camera.as_entire_binding(),
                view.picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&view.picture.view),
                wgpu::BindingResource::TextureView(view.phantoms.views().place),
                wgpu::BindingResource::TextureView(virtual_places),
                wgpu::BindingResource::TextureView(shaded),
                wgpu::BindingResource::TextureView(&refined.create_view(&wgpu::TextureViewDescriptor::default())),
            ],
        );
        Self {
            pipeline,
            bindings,
            refined,
            shaded: shaded.texture().clone(),
            size_px,
        }
    }

    /// Moves the edges.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        {
            let span = timer.span("phantom_edge");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("phantom_edge"),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
        }
        encoder.copy_texture_to_texture(
            self.refined.as_image_copy(),
            self.shaded.as_image_copy(),
            self.shaded.size(),
        );
    }
}
