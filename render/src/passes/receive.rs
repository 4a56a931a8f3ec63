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
    size_px: [u32; 2],
}

impl Receive {
    /// A pass for pictures of `size_px`, in which bright light may be missing.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, bright: &BrightLight, size_px: [u32; 2]) -> Self {
        let pipeline = gpu.compute_pipeline("receive");
        let frame = gpu.buffer("receive: frame", &[<GpuFrame as bytemuck::Zeroable>::zeroed()]);
        let target = gpu
            .texture("receive: ratio", TextureShape::plain(size_px), RADIANCE_FORMAT)
            .create_view(&wgpu::TextureViewDescriptor::default());
        // The camera and the objects' placements are of no use here, and the shader leaves them out.
        let resources = direct::resources(inputs);
        let mut entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
            .zip(resources)
            .skip(2)
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
