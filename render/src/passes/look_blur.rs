//! The camera's blur on what is virtual: the objects with their coverage, and the ratios of their shadows on real things.

use glam::{DMat2, Vec4};

use super::groups;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuBlurLine;
use crate::look::kernel::{self, LINE_WEIGHTS};

/// The pass; it blurs pictures in place.
#[derive(Debug)]
pub struct LookBlur {
    pipeline: wgpu::ComputePipeline,
    lines: [wgpu::Buffer; 3],
    /// Per picture, for the three lines one after the other.
    bindings: Vec<[wgpu::BindGroup; 3]>,
    size_px: [u32; 2],
    is_needed: bool,
}

impl LookBlur {
    /// A pass for some `pictures` of `size_px`, radiance or ratios times coverage, alpha the coverage. Blurs nothing until
    /// [`LookBlur::set`].
    #[must_use]
    pub fn new(gpu: &Gpu, pictures: &[&wgpu::TextureView], size_px: [u32; 2]) -> Self {
        let pipeline = gpu.compute_pipeline("look_blur");
        let lines = [0, 1, 2].map(|_| gpu.buffer("look_blur: line", &[<GpuBlurLine as bytemuck::Zeroable>::zeroed()]));
        let between = ["look_blur: after one line", "look_blur: after two"].map(|label| {
            gpu.texture(label, TextureShape::plain(size_px), RADIANCE_FORMAT)
                .create_view(&wgpu::TextureViewDescriptor::default())
        });
        let layout = pipeline.get_bind_group_layout(0);
        let bindings = pictures
            .iter()
            .map(|picture| {
                let way = [*picture, &between[0], &between[1], *picture];
                [0, 1, 2].map(|i: usize| {
                    gpu.bind(
                        "look_blur",
                        &layout,
                        &[
                            lines[i].as_entire_binding(),
                            wgpu::BindingResource::TextureView(way[i]),
                            wgpu::BindingResource::TextureView(way[i + 1]),
                        ],
                    )
                })
            })
            .collect();
        Self {
            pipeline,
            lines,
            bindings,
            size_px,
            is_needed: false,
        }
    }

    /// Blurs with this covariance (px²) from now on; `None` leaves the pictures as they are.
    pub fn set(&mut self, gpu: &Gpu, covariance_px2: Option<DMat2>) {
        self.is_needed = covariance_px2.is_some();
        if let Some(covariance) = covariance_px2 {
            for (buffer, line) in self.lines.iter().zip(kernel::lines(covariance)) {
                gpu.write(buffer, &[gpu_line(&line)]);
            }
        }
    }

    /// Blurs every picture.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if !self.is_needed {
            return;
        }
        let span = timer.span("look_blur");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("look_blur"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for bindings in self.bindings.iter().flatten() {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
        }
    }
}

fn gpu_line(line: &kernel::Line) -> GpuBlurLine {
    let weight = |i: usize| line.weights.get(i).map_or(0.0, |&w| w as f32);
    GpuBlurLine {
        step: [line.step_px.x, line.step_px.y, line.weights.len() as i32 - 1, 0],
        weights: std::array::from_fn(|i| Vec4::from_array(std::array::from_fn(|j| weight(4 * i + j)))),
    }
}

const _: () = assert!(
    LINE_WEIGHTS == 4 * 5,
    "`GpuBlurLine` holds as many weights as a line has"
);
