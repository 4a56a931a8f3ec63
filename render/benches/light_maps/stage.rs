//! One environment on the GPU, and the maps made of it.

use glam::{Vec3, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::sh::IrradianceSh;
use mirrorball_render::config::LightConfig;
use mirrorball_render::environments::{Environments, SH_STRIDE_BYTES, Slot};
use mirrorball_render::error::RenderError;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::{GpuCamera, GpuEnvironment};
use mirrorball_render::light_maps::LightMaps;

use crate::support;

/// A device with room for the maps of one environment.
pub(crate) struct Stage {
    pub(crate) gpu: Gpu,
    pub(crate) timer: Timer,
    pub(crate) environments: Environments,
    camera: wgpu::Buffer,
}

impl Stage {
    pub(crate) fn new() -> Result<Self, RenderError> {
        let gpu = Gpu::open()?;
        let slot = Slot {
            name: "bench".into(),
            center_m: Vec3::ZERO,
            radius_m: 0.1,
            is_glossy: true,
            parameters: gpu.buffer("bench: parameters", &[<GpuEnvironment as bytemuck::Zeroable>::zeroed()]),
            hit_m: gpu.buffer("bench: distances", &[0.0f32]),
        };
        Ok(Self {
            environments: Environments::with_slots(&gpu, vec![slot]),
            camera: gpu.buffer("bench: camera", &[<GpuCamera as bytemuck::Zeroable>::zeroed()]),
            timer: Timer::new(&gpu),
            gpu,
        })
    }

    /// The passes of some methods.
    pub(crate) fn maps(&self, config: &LightConfig) -> LightMaps {
        let sampler = self.gpu.linear_sampler();
        LightMaps::new(&self.gpu, &self.environments, config, (&self.camera, &sampler))
    }

    pub(crate) fn upload(&self, radiance: &Cube<Vec3>) {
        let texels = support::halves(radiance.texels().iter().map(|t| t.extend(1.0)));
        support::write_texture(&self.gpu, &self.environments.radiance, &texels);
    }

    /// Makes the maps of the environment that was uploaded.
    pub(crate) fn make(&mut self, maps: &LightMaps) -> Result<(), RenderError> {
        self.timer.start_frame();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        maps.record(&mut encoder, &mut self.timer, &self.environments);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.wait("making maps")
    }

    pub(crate) fn specular(&self, mip: u32) -> Cube<Vec3> {
        support::read_cube(&self.gpu, &self.environments.specular, mip).map(|t| t.xyz())
    }

    pub(crate) fn irradiance(&self) -> Cube<Vec3> {
        support::read_cube(&self.gpu, &self.environments.irradiance, 0).map(|t| t.xyz())
    }

    pub(crate) fn harmonics(&self) -> Result<IrradianceSh, RenderError> {
        let readback = Readback::new(&self.gpu, "bench: harmonics", SH_STRIDE_BYTES);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.environments.harmonics, 0, readback.buffer(), 0, SH_STRIDE_BYTES);
        readback.record(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        let mut coefficients = [glam::Vec4::ZERO; SH_STRIDE_BYTES as usize / 16];
        readback.read(&self.gpu, &mut coefficients)?;
        Ok(IrradianceSh {
            coefficients: std::array::from_fn(|i| coefficients[i].xyz()),
        })
    }
}
