//! The probe's light moved to each virtual object.

use super::{ENVIRONMENT_SIZE, groups};
use crate::environments::{Environments, faces_view};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use mirrorball_calib::probe::cube::FACES;

/// What the pass reads, the same for all objects.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene camera, uniform.
    pub camera: &'a wgpu::Buffer,
    /// Its response table.
    pub response: &'a wgpu::Buffer,
    /// Its picture.
    pub picture: &'a wgpu::TextureView,
    /// Places of the phantoms that it sees.
    pub camera_places: &'a wgpu::TextureView,
    /// Radiance at the probe.
    pub probe_radiance: &'a wgpu::TextureView,
    /// The room without phantoms, faces as layers; alpha: number of the strong light, from 1.
    pub far_faces: &'a wgpu::TextureView,
    /// The room without the strong lights.
    pub behind_radiance: &'a wgpu::TextureView,
    /// Where the strong lights stand, uniform.
    pub strong: &'a wgpu::Buffer,
    /// Linear, clamped.
    pub sampler: &'a wgpu::Sampler,
}

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct LocalEnvironment {
    pipeline: wgpu::ComputePipeline,
    bindings: Vec<wgpu::BindGroup>,
}

impl LocalEnvironment {
    /// Binds the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, inputs: Inputs<'_>) -> Self {
        let pipeline = gpu.compute_pipeline("local_environment");
        let bindings = environments
            .slots
            .iter()
            .enumerate()
            .map(|(slot, environment)| {
                let out = environments.radiance.create_view(&faces_view(slot as u32, 0));
                let room = environments.room.create_view(&faces_view(slot as u32, 0));
                gpu.bind(
                    "local_environment",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        environment.parameters.as_entire_binding(),
                        inputs.camera.as_entire_binding(),
                        inputs.response.as_entire_binding(),
                        wgpu::BindingResource::TextureView(inputs.picture),
                        environment.hit_m.as_entire_binding(),
                        wgpu::BindingResource::TextureView(inputs.probe_radiance),
                        wgpu::BindingResource::TextureView(inputs.behind_radiance),
                        wgpu::BindingResource::Sampler(inputs.sampler),
                        wgpu::BindingResource::TextureView(inputs.camera_places),
                        wgpu::BindingResource::TextureView(&out),
                        wgpu::BindingResource::TextureView(inputs.far_faces),
                        inputs.strong.as_entire_binding(),
                        wgpu::BindingResource::TextureView(&room),
                    ],
                )
            })
            .collect();
        Self { pipeline, bindings }
    }

    /// Fills the first mip of every environment, and of the room around it.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("local_environment");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("local_environment"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(groups(ENVIRONMENT_SIZE), groups(ENVIRONMENT_SIZE), FACES as u32);
        }
    }
}
