//! Virtual objects for displays that show no camera picture: before a backdrop (VR), or before black on a display that one
//! looks through.
//!
//! A display that one looks through can only add light: what virtual objects add to the light on real things is shown, what
//! they take away is not. Real things still hide virtual ones.

use super::groups;
use super::receive::Receive;
use super::shade::Shade;
use crate::codes::Codes;
use crate::config::{BackdropName, ModeConfig, PhantomsInVr};
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::mode::Surround;
use crate::passes::direct::ShadowedLight;
use crate::passes::real_radiance::RealRadiance;

/// The pass with its result.
#[derive(Debug)]
pub struct Display {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    codes: Codes,
}

/// What the pass reads.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The eye's camera, uniform; a pinhole.
    pub camera: &'a wgpu::Buffer,
    /// Virtual objects.
    pub shade: &'a Shade,
    /// Ratio on phantoms, and what virtual lamps add to them.
    pub receive: &'a Receive,
    /// Real things as they are.
    pub real: &'a RealRadiance,
    /// Light on phantoms.
    pub light: &'a ShadowedLight,
    /// Radiance at the probe, a cube.
    pub probe_radiance: &'a wgpu::TextureView,
}

/// Value of the shader's constant `SURROUND`.
fn surround_constant(config: &ModeConfig) -> f64 {
    match (config.name.surround(), config.backdrop) {
        (Surround::Picture | Surround::Nothing, _) => 0.0,
        (Surround::Backdrop, BackdropName::Colour) => 1.0,
        (Surround::Backdrop, BackdropName::Environment) => 2.0,
    }
}

impl Display {
    /// A pass for pictures of `size_px`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, (config, size_px): (&ModeConfig, [u32; 2])) -> Self {
        let [red, green, blue] = config.background.map(f64::from);
        let phantoms = match config.phantoms {
            PhantomsInVr::LeftOut => 0.0,
            PhantomsInVr::Grey => 1.0,
        };
        let constants = [
            ("SURROUND", surround_constant(config)),
            ("PHANTOMS", phantoms),
            ("RED", red),
            ("GREEN", green),
            ("BLUE", blue),
        ];
        let pipeline = gpu.compute_pipeline_variant("display", &constants);
        let codes = Codes::new(gpu, "display: codes", size_px);
        let bindings = gpu.bind(
            "display",
            &pipeline.get_bind_group_layout(0),
            &[
                inputs.camera.as_entire_binding(),
                wgpu::BindingResource::TextureView(inputs.shade.radiance()),
                wgpu::BindingResource::TextureView(inputs.receive.ratio()),
                wgpu::BindingResource::TextureView(inputs.real.radiance()),
                wgpu::BindingResource::TextureView(&inputs.light.with_virtual),
                wgpu::BindingResource::TextureView(&inputs.light.lamps),
                wgpu::BindingResource::TextureView(&inputs.light.near),
                wgpu::BindingResource::TextureView(inputs.probe_radiance),
                wgpu::BindingResource::Sampler(&gpu.linear_sampler()),
                codes.buffer().as_entire_binding(),
                wgpu::BindingResource::TextureView(inputs.receive.added()),
            ],
        );
        Self {
            pipeline,
            bindings,
            codes,
        }
    }

    /// The finished picture.
    #[must_use]
    pub fn codes(&self) -> &Codes {
        &self.codes
    }

    /// Mixes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("display");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("display"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        let [width, height] = self.codes.size_px();
        pass.dispatch_workgroups(groups(width), groups(height), 1);
    }
}
