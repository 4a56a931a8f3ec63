//! Real things as radiance: the camera's picture times the ratios on phantoms, with mips, for reflections to be looked up in.

use super::groups;
use crate::camera_view::CameraView;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};

/// Mips of the picture.
pub const REAL_MIPS: u32 = 6;

/// The pass with its target.
#[derive(Debug)]
pub struct RealRadiance {
    first: wgpu::ComputePipeline,
    halve: wgpu::ComputePipeline,
    /// For the picture itself, then for every mip below it.
    bindings: Vec<wgpu::BindGroup>,
    view: wgpu::TextureView,
    size_px: [u32; 2],
}

impl RealRadiance {
    /// A pass for the pictures of `view`, times `ratio` where its alpha is 1, plus the radiance `added` (both as
    /// [`crate::passes::receive`] has them).
    #[must_use]
    pub fn new(gpu: &Gpu, view: &CameraView, [ratio, added]: [&wgpu::TextureView; 2]) -> Self {
        let size_px = view.size_px();
        let shape = TextureShape {
            mips: REAL_MIPS.min(size_px[0].min(size_px[1]).max(1).ilog2() + 1),
            ..TextureShape::plain(size_px)
        };
        let texture = gpu.texture("real_radiance", shape, RADIANCE_FORMAT);
        let mip = |level| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                base_mip_level: level,
                mip_level_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            })
        };
        let first = gpu.compute_pipeline("real_radiance");
        let halve = gpu.compute_pipeline("halve");
        let mut bindings = vec![gpu.bind(
            "real_radiance",
            &first.get_bind_group_layout(0),
            &[
                view.camera.as_entire_binding(),
                view.picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&view.picture.view),
                wgpu::BindingResource::TextureView(ratio),
                wgpu::BindingResource::TextureView(added),
                wgpu::BindingResource::TextureView(&mip(0)),
            ],
        )];
        bindings.extend((1..shape.mips).map(|level| {
            gpu.bind(
                "halve",
                &halve.get_bind_group_layout(0),
                &[
                    wgpu::BindingResource::TextureView(&mip(level - 1)),
                    wgpu::BindingResource::TextureView(&mip(level)),
                ],
            )
        }));
        Self {
            first,
            halve,
            bindings,
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
            size_px,
        }
    }

    /// A pass for the pictures of `view` as they are.
    #[must_use]
    pub fn unshadowed(gpu: &Gpu, view: &CameraView) -> Self {
        let black = gpu
            .texture(
                "real_radiance: no change",
                TextureShape::plain(view.size_px()),
                RADIANCE_FORMAT,
            )
            .create_view(&wgpu::TextureViewDescriptor::default());
        Self::new(gpu, view, [&black, &black])
    }

    /// Radiance per pixel, in the rig's common RGB, with mips.
    #[must_use]
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.view
    }

    /// Fills the picture and its mips.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("real_radiance");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("real_radiance"),
            timestamp_writes: span.compute(Ends::Both),
        });
        let [mut width, mut height] = self.size_px;
        for (level, bindings) in self.bindings.iter().enumerate() {
            pass.set_pipeline(if level == 0 { &self.first } else { &self.halve });
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(groups(width), groups(height), 1);
            (width, height) = ((width / 2).max(1), (height / 2).max(1));
        }
    }
}
