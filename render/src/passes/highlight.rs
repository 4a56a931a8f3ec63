//! The bright part of each environment alone, for highlights on plastics.
//!
//! Supan 2006 (2.1.2, fig. 2.6 and 2.7) darkens the map for materials that absorb most of the light until only lamps are
//! left of it, without saying by how much. Here a texel keeps what its luminance has above a multiple of the mean.

use glam::Vec4;

use super::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE, groups};
use crate::environments::{Environments, faces_view, harmonics_binding};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use mirrorball_calib::probe::cube::FACES;

/// The pass with its result.
#[derive(Debug)]
pub struct Highlight {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
    darkened: wgpu::Texture,
}

impl Highlight {
    /// Binds the pass to the environments of `slots`, whose harmonics give the mean; `threshold` is in means.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, (slots, threshold): (&[u32], f32)) -> Self {
        let pipeline = gpu.compute_pipeline("highlight");
        let shape = TextureShape {
            mips: ENVIRONMENT_MIPS,
            ..TextureShape::layered([ENVIRONMENT_SIZE; 2], environments.radiance.depth_or_array_layers())
        };
        let darkened = gpu.texture("highlight: radiance", shape, RADIANCE_FORMAT);
        let threshold = gpu.buffer("highlight: threshold", &[Vec4::new(threshold, 0.0, 0.0, 0.0)]);
        let bindings = slots
            .iter()
            .map(|&slot| {
                let source = environments.radiance.create_view(&faces_view(slot, 0));
                let out = darkened.create_view(&faces_view(slot, 0));
                gpu.bind(
                    "highlight",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        threshold.as_entire_binding(),
                        wgpu::BindingResource::TextureView(&source),
                        harmonics_binding(&environments.harmonics, slot),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                )
            })
            .collect();
        Self {
            pipeline,
            bindings,
            darkened,
        }
    }

    /// The darkened environments, six layers per slot; this pass fills the first mip, [`super::downsample`] the others.
    #[must_use]
    pub fn darkened(&self) -> &wgpu::Texture {
        &self.darkened
    }

    /// Darkens every environment.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("highlight");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("highlight"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        let n = groups(ENVIRONMENT_SIZE);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(n, n, FACES as u32);
        }
    }
}
