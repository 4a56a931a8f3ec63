//! Environments filtered for roughness: one GGX lobe per mip.

use glam::Vec4;

use super::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE, groups};
use crate::environments::{Environments, cube_view, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use mirrorball_calib::probe::cube::FACES;

/// Samples per texel of a mip: twice as many for each rougher one, whose lobes are wider and whose texels are a quarter
/// as many.
#[must_use]
pub fn samples_of_mip(mip: u32) -> u32 {
    32 << mip
}

/// GGX alpha of a mip: the square of its perceptual roughness, which rises evenly from 0 to 1.
#[must_use]
pub fn alpha_of_mip(mip: u32) -> f32 {
    let roughness = mip as f32 / (ENVIRONMENT_MIPS - 1) as f32;
    roughness * roughness
}

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct PrefilterSpecular {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<(u32, wgpu::BindGroup)>,
    glossy: Vec<u32>,
}

impl PrefilterSpecular {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, sampler: &wgpu::Sampler) -> Self {
        let pipeline = gpu.compute_pipeline("prefilter_specular");
        let glossy: Vec<u32> = (0..environments.slots.len() as u32)
            .filter(|&i| environments.slots[i as usize].is_glossy)
            .collect();
        let mut bindings = Vec::new();
        for &slot in &glossy {
            for mip in 1..ENVIRONMENT_MIPS {
                let lobe = Vec4::new(
                    alpha_of_mip(mip),
                    ENVIRONMENT_SIZE as f32,
                    samples_of_mip(mip) as f32,
                    0.0,
                );
                let lobe = gpu.buffer("prefilter_specular: lobe", &[lobe]);
                let source = environments.radiance.create_view(&cube_view(slot, ENVIRONMENT_MIPS));
                let out = environments.specular.create_view(&faces_view(slot, mip));
                let group = gpu.bind(
                    "prefilter_specular",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        lobe.as_entire_binding(),
                        wgpu::BindingResource::TextureView(&source),
                        wgpu::BindingResource::Sampler(sampler),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                );
                bindings.push((mip, group));
            }
        }
        Self {
            pipeline,
            bindings,
            glossy,
        }
    }

    /// Filters every environment that something glossy stands in; the first mip is the environment itself.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, environments: &Environments) {
        if self.bindings.is_empty() {
            return;
        }
        for &slot in &self.glossy {
            let face = |texture| wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: 0,
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: FACES as u32 * slot,
                },
                aspect: wgpu::TextureAspect::All,
            };
            let extent = wgpu::Extent3d {
                width: ENVIRONMENT_SIZE,
                height: ENVIRONMENT_SIZE,
                depth_or_array_layers: FACES as u32,
            };
            encoder.copy_texture_to_texture(face(&environments.radiance), face(&environments.specular), extent);
        }
        let span = timer.span("prefilter_specular");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("prefilter_specular"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for (mip, bindings) in &self.bindings {
            let n = groups(ENVIRONMENT_SIZE >> mip);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(n, n, FACES as u32);
        }
    }
}
