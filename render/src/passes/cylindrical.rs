//! Irradiance by turning the environment about the three axes in turn, for comparison: Supan 2006, 2.4.1 and 3.4.1.
//!
//! He renders a textured sphere at every step of the turn and adds the pictures up, and names the better way, which is
//! taken here: to turn the direction that is looked up.

use super::irradiance_cube::IRRADIANCE_SIZE;
use super::{ENVIRONMENT_SIZE, groups};
use crate::environments::{Environments, cube_view, faces_view};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuTurn;
use glam::{Vec3, Vec4};
use mirrorball_calib::probe::cube::FACES;

/// Angle swept about each axis, radians: √3. A sweep of w has the variance w² / 12; the three together spread every
/// direction by twice that along either axis, which is the cosine lobe's own 1/2 - 1/4.
pub const SWEEP_RAD: f32 = 1.732_050_8;
/// Steps of a sweep, 2° each: less than a texel, so that a lamp leaves no rings.
pub const STEPS: u32 = 48;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct Cylindrical {
    pipeline: wgpu::ComputePipeline,
    /// Three per environment: about x, y and z.
    bindings: Vec<wgpu::BindGroup>,
}

impl Cylindrical {
    /// Binds the pass to the environments of `slots`, whose mips are up to date when it runs; `sampler` is linear.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, (slots, sampler): (&[u32], &wgpu::Sampler)) -> Self {
        let pipeline = gpu.compute_pipeline("cylindrical");
        let shape = TextureShape::layered([IRRADIANCE_SIZE; 2], FACES as u32);
        let between =
            ["x", "y"].map(|axis| gpu.texture(&format!("cylindrical: turned about {axis}"), shape, RADIANCE_FORMAT));
        let turn = |axis: Vec3, factor: f32| {
            let turn = GpuTurn {
                axis: axis.extend(factor),
                sweep: Vec4::new(SWEEP_RAD, STEPS as f32, 0.0, 0.0),
            };
            gpu.buffer("cylindrical: turn", &[turn])
        };
        let turns = [
            turn(Vec3::X, 1.0),
            turn(Vec3::Y, 1.0),
            turn(Vec3::Z, std::f32::consts::PI),
        ];
        let mip = (ENVIRONMENT_SIZE / IRRADIANCE_SIZE).ilog2();
        let mut bindings = Vec::new();
        for &slot in slots {
            let first = environments.radiance.create_view(&wgpu::TextureViewDescriptor {
                base_mip_level: mip,
                ..cube_view(slot, 1)
            });
            let sources = [
                first,
                between[0].create_view(&cube_view(0, 1)),
                between[1].create_view(&cube_view(0, 1)),
            ];
            let outs = [
                between[0].create_view(&faces_view(0, 0)),
                between[1].create_view(&faces_view(0, 0)),
                environments.irradiance.create_view(&faces_view(slot, 0)),
            ];
            for ((turn, source), out) in turns.iter().zip(&sources).zip(&outs) {
                bindings.push(gpu.bind(
                    "cylindrical",
                    &pipeline.get_bind_group_layout(0),
                    &[
                        turn.as_entire_binding(),
                        wgpu::BindingResource::TextureView(source),
                        wgpu::BindingResource::Sampler(sampler),
                        wgpu::BindingResource::TextureView(out),
                    ],
                ));
            }
        }
        Self { pipeline, bindings }
    }

    /// Fills the irradiance cubes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.bindings.is_empty() {
            return;
        }
        let span = timer.span("cylindrical");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("cylindrical"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        let n = groups(IRRADIANCE_SIZE);
        for bindings in &self.bindings {
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(n, n, FACES as u32);
        }
    }
}
