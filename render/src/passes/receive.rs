//! Phantoms receive the shadows and the light of virtual objects: a ratio per pixel.

use super::direct::{self, Inputs};
use super::groups;
use super::protect::BrightLight;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuFrame;

/// The pass with its target.
#[derive(Debug)]
pub struct Receive {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    frame: wgpu::Buffer,
    target: wgpu::TextureView,
    real_light: wgpu::TextureView,
    added: wgpu::TextureView,
    size_px: [u32; 2],
}

impl Receive {
    /// A pass for pictures of `size_px`, in which bright light may be missing.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, bright: &BrightLight, size_px: [u32; 2]) -> Self {
        let pipeline = gpu.compute_pipeline("receive");
        let frame = gpu.buffer("receive: frame", &[<GpuFrame as bytemuck::Zeroable>::zeroed()]);
        let texture = |label| {
            gpu.texture(label, TextureShape::plain(size_px), RADIANCE_FORMAT)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let (target, real_light) = (texture("receive: ratio"), texture("receive: light of the room"));
        // The camera, the objects' placements and the light of lamps are of no use here, and the shader leaves them out.
        const UNUSED: [u32; 3] = [0, 1, 6];
        let resources = direct::resources(inputs);
        let mut entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
            .zip(resources)
            .filter(|(binding, _)| !UNUSED.contains(binding))
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        entries.extend(
            (8..)
                .zip([
                    frame.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&inputs.light.place),
                    wgpu::BindingResource::TextureView(&inputs.light.normal),
                    wgpu::BindingResource::TextureView(&bright.absent),
                    wgpu::BindingResource::TextureView(&bright.returned),
                    wgpu::BindingResource::TextureView(&target),
                    wgpu::BindingResource::TextureView(&real_light),
                ])
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }),
        );
        let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("receive"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        Self {
            pipeline,
            bindings,
            frame,
            target,
            real_light,
            added: texture("receive: light of lamps"),
            size_px,
        }
    }

    /// Uploads what a frame's pixels share.
    pub fn write(&self, gpu: &Gpu, frame: &GpuFrame) {
        gpu.write(&self.frame, &[*frame]);
    }

    /// What a frame's pixels share, uniform ([`GpuFrame`]).
    #[must_use]
    pub fn frame(&self) -> &wgpu::Buffer {
        &self.frame
    }

    /// Ratio on phantoms, alpha 1 where there is one.
    #[must_use]
    pub fn ratio(&self) -> &wgpu::TextureView {
        &self.target
    }

    /// Irradiance of all light in the room on phantoms that show any, past the real things; alpha 1 where there is one.
    #[must_use]
    pub fn real_light(&self) -> &wgpu::TextureView {
        &self.real_light
    }

    /// Radiance that virtual lamps add to phantoms, in the rig's common RGB: for [`super::lamp_receive`] to fill, else black.
    #[must_use]
    pub fn added(&self) -> &wgpu::TextureView {
        &self.added
    }

    /// Computes the ratios from the light on the phantoms.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("receive");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("receive"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
    }
}
