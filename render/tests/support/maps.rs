//! Environments made by formula, and the maps of light that are made of them.

use glam::{Vec3, Vec4, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::sh::IrradianceSh;
use mirrorball_render::config::{DiffuseMethod, LightConfig, SpecularMethod};
use mirrorball_render::environments::SH_STRIDE_BYTES;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::gpu::types::MAX_ENVIRONMENTS;
use mirrorball_render::light_maps::LightMaps;
use mirrorball_render::passes::ENVIRONMENT_SIZE;

use super::stage::{Stage, environment_stage};
use super::{cube_of, halves, read_cube};

/// Towards a lamp, not along any axis.
pub(crate) const LAMP: Vec3 = Vec3::new(0.48, -0.36, 0.8);
/// A stage with a method's maps.
pub(crate) struct Maps {
    pub(crate) stage: Stage,
    pub(crate) maps: LightMaps,
}

impl Maps {
    pub(crate) fn new(gpu: Gpu, diffuse: DiffuseMethod, specular: SpecularMethod) -> Self {
        let stage = environment_stage(gpu);
        let config = LightConfig {
            diffuse,
            specular,
            ..LightConfig::default()
        };
        let sampler = stage.gpu.linear_sampler();
        let maps = LightMaps::new(&stage.gpu, &stage.environments, &config, (&stage.camera, &sampler));
        Self { stage, maps }
    }

    /// Makes the maps of an environment; they are left on the GPU.
    pub(crate) fn make(&mut self, environment: &Cube<Vec3>) {
        let stage = &mut self.stage;
        super::write_texture(
            &stage.gpu,
            &stage.environments.radiance,
            &halves(environment.texels().iter().map(|t| t.extend(1.0))),
        );
        let mut encoder = stage
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.maps.record(&mut encoder, &mut stage.timer, &stage.environments);
        stage.gpu.queue.submit([encoder.finish()]);
        stage.gpu.wait("making maps").expect("the device works");
    }

    pub(crate) fn specular(&self, mip: u32) -> Cube<Vec3> {
        read_cube(&self.stage.gpu, &self.stage.environments.specular, mip).map(|t| t.xyz())
    }

    pub(crate) fn irradiance(&self) -> Cube<Vec3> {
        read_cube(&self.stage.gpu, &self.stage.environments.irradiance, 0).map(|t| t.xyz())
    }

    pub(crate) fn harmonics(&self) -> IrradianceSh {
        harmonics_in(&self.stage, &self.stage.environments.harmonics)
    }
}

/// The first environment's harmonics.
pub(crate) fn harmonics_in(stage: &Stage, buffer: &wgpu::Buffer) -> IrradianceSh {
    let coefficients: Vec<Vec4> = read_buffer(stage, buffer, MAX_ENVIRONMENTS as u64 * SH_STRIDE_BYTES);
    IrradianceSh {
        coefficients: std::array::from_fn(|i| coefficients[i].xyz()),
    }
}

/// The first bytes of a buffer.
pub(crate) fn read_buffer<T: bytemuck::Pod>(stage: &Stage, buffer: &wgpu::Buffer, bytes: u64) -> Vec<T> {
    let readback = Readback::new(&stage.gpu, "test: buffer", bytes);
    let mut encoder = stage
        .gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, readback.buffer(), 0, bytes);
    readback.record(&mut encoder);
    stage.gpu.queue.submit([encoder.finish()]);
    let mut out = vec![T::zeroed(); bytes as usize / size_of::<T>()];
    readback.read(&stage.gpu, &mut out).expect("the device works");
    out
}

/// Smooth light in three colours.
pub(crate) fn smooth_room() -> Cube<Vec3> {
    cube_of(ENVIRONMENT_SIZE, |d| {
        let wave = (3.0 * d.x).sin() + (4.0 * d.y + d.z).cos();
        Vec3::new(2.0 + wave, 2.2 - wave, 1.5 + 0.5 * (5.0 * d.z).sin())
    })
}

/// A room of about 1 with a lamp `radius_rad` wide, 10,000 times as bright.
pub(crate) fn lamp_room(lamp: Vec3, radius_rad: f32) -> Cube<Vec3> {
    cube_of(ENVIRONMENT_SIZE, |d| {
        if d.angle_between(lamp) < radius_rad {
            Vec3::new(10_000.0, 9_000.0, 7_000.0)
        } else {
            Vec3::splat(1.0 + 0.3 * (3.0 * d.x).sin())
        }
    })
}
