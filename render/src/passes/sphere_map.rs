//! Sphere maps in eye space, for comparison: Supan 2006, 2.5.1.
//!
//! They are made of each object's own environment, not cut out of the picture of the ball, so that they hold the same
//! light as the other methods, also with a fixed probe camera.

use super::groups;
use crate::environments::{Environments, cube_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// Edge of a sphere map, texels.
pub const SPHERE_MAP_SIZE: u32 = 256;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct SphereMap {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl SphereMap {
    /// Binds the pass to the environments of `slots` and their irradiance cubes; `camera` is the scene camera's uniform
    /// buffer, `sampler` is linear.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        environments: &Environments,
        slots: &[u32],
        (camera, sampler): (&wgpu::Buffer, &wgpu::Sampler),
    ) -> Self {
        let pipeline = gpu.compute_pipeline("sphere_map");
        let bindings = slots
            .iter()
            .map(|&slot| {
                let radiance = environments.radiance.create_view(&cube_view(slot, 1));
                let irradiance = environments.irradiance.create_view(&cube_view(slot, 1));
                let out = environments.sphere_maps.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2Array),
                    base_array_layer: 2 * slot,
                    array_layer_count: Some(2),
                    ..wgpu::TextureViewDescriptor::default()
                });
                gpu.bind(
                    "sphere_map",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        camera.as_entire_binding(),
                        wgpu::BindingResource::TextureView(&radiance),
                        wgpu::BindingResource::TextureView(&irradiance),
                        wgpu::BindingResource::Sampler(sampler),
                        wgpu::BindingResource::TextureView(&out),
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Fills the sphere maps as the camera stands now.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("sphere_map");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("sphere_map"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        let n = groups(SPHERE_MAP_SIZE);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(n, n, 1);
        }
    }
}
