//! What the environment gives the surfaces of a picture, past the real things and past all things: the reference of the
//! ratio that darkens a camera's picture where virtual objects stand (Debevec 1998, "Rendering synthetic objects into real
//! scenes", with a ratio in place of the difference).
//!
//! Direct light only, from infinitely far away.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::environment::EnvironmentBuffers;
use super::hierarchy::{Hierarchies, HierarchyBuffers, within_binding};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::TextureShape;
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::surface::PLACE_FORMAT;

/// Rays start so far off the surface, metres: more than a rasterised place is wrong, less than a shadow's edge shows.
const START_M: f32 = 2e-4;

/// How a pass traces (`Settings` in `shadow_path_irradiance.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuIrradianceSettings {
    /// First ray and number of rays, seed, texels along the environment's edge.
    pub counts: [u32; 4],
    /// Roots of the two hierarchies, whether the environment's power is drawn, unused.
    pub roots: [u32; 4],
    /// x: how far off the surface rays start, metres.
    pub lengths: Vec4,
}

/// Two sets of things that stand in the light.
#[derive(Debug)]
pub struct OccluderSets {
    buffers: HierarchyBuffers,
    roots: [u32; 2],
}

impl OccluderSets {
    /// Uploads the things that are always there and those that only the second sum sees (corners of triangles, world,
    /// metres).
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more triangles than the adapter has room for.
    pub fn new(gpu: &Gpu, real: &[[Vec3; 3]], added: &[[Vec3; 3]]) -> Result<Self, RenderError> {
        let mut hierarchies = Hierarchies::default();
        let roots = [hierarchies.add(gpu, real)?.link, hierarchies.add(gpu, added)?.link];
        Ok(Self {
            buffers: hierarchies.upload(gpu)?,
            roots,
        })
    }
}

/// Irradiance per pixel, linear RGB, [`PLACE_FORMAT`]; w: 1 where there is a surface, else all 0.
#[derive(Debug)]
pub struct IrradianceMaps {
    /// Past the things that are always there.
    pub without: wgpu::Texture,
    /// Past the added ones, too.
    pub with_all: wgpu::Texture,
    size_px: [u32; 2],
    sums: wgpu::Buffer,
}

/// Where irradiance is wanted, and of what light.
#[derive(Debug, Clone, Copy)]
pub struct IrradianceJob<'a> {
    /// xyz: place, world, metres; w: 0 where there is no surface.
    pub places: &'a wgpu::TextureView,
    /// xyz: normal, world.
    pub normals: &'a wgpu::TextureView,
    /// The light, uploaded.
    pub environment: &'a EnvironmentBuffers,
    /// What stands in it.
    pub occluders: &'a OccluderSets,
    /// Rays per pixel.
    pub rays: u32,
    /// Another seed gives other noise.
    pub seed: u32,
}

/// The pass.
#[derive(Debug)]
pub struct IrradiancePass {
    pipeline: wgpu::ComputePipeline,
}

impl IrradiancePass {
    /// The pass for any picture.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            pipeline: gpu.compute_pipeline("shadow_path_irradiance"),
        }
    }

    /// Results for pictures of a size.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more pixels than the adapter has room for.
    pub fn maps(&self, gpu: &Gpu, size_px: [u32; 2]) -> Result<IrradianceMaps, RenderError> {
        let bytes = 2 * size_of::<Vec4>() * size_px[0] as usize * size_px[1] as usize;
        within_binding(gpu, "a number of bytes of a picture", bytes)?;
        let shape = TextureShape::plain(size_px);
        Ok(IrradianceMaps {
            without: gpu.target("path: irradiance without", shape, PLACE_FORMAT),
            with_all: gpu.target("path: irradiance with all", shape, PLACE_FORMAT),
            size_px,
            sums: gpu.buffer("path: irradiance sums", &vec![0u8; bytes.max(32)]),
        })
    }

    /// Fills the maps; a few rays per submission, so that none takes long. Returns milliseconds on the GPU.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn render(
        &self,
        gpu: &Gpu,
        timer: &mut Timer,
        maps: &IrradianceMaps,
        job: &IrradianceJob<'_>,
    ) -> Result<f64, RenderError> {
        let settings_buffer = gpu.buffer("path: irradiance settings", &[GpuIrradianceSettings::zeroed()]);
        let bindings = self.bindings(gpu, maps, job, &settings_buffer);
        let mut encoder = encoder(gpu);
        encoder.clear_buffer(&maps.sums, 0, None);
        gpu.queue.submit([encoder.finish()]);
        let mut total_ms = 0.0;
        let mut first = 0;
        // Even, so that both ways of drawing get their turn in every submission.
        let mut batch = 2;
        while first < job.rays {
            let n = batch.min(job.rays - first);
            let settings = GpuIrradianceSettings {
                counts: [first, n, job.seed, job.environment.size],
                roots: [
                    job.occluders.roots[0],
                    job.occluders.roots[1],
                    u32::from(job.environment.is_drawn),
                    0,
                ],
                lengths: Vec4::new(START_M, 0.0, 0.0, 0.0),
            };
            gpu.write(&settings_buffer, &[settings]);
            let start = std::time::Instant::now();
            total_ms += self.submit(gpu, timer, maps, &bindings)?;
            batch = match start.elapsed().as_millis() {
                0..75 => (2 * batch).min(1024),
                75..150 => batch,
                _ => (batch / 4 * 2).max(2),
            };
            first += n;
        }
        Ok(total_ms)
    }

    fn submit(
        &self,
        gpu: &Gpu,
        timer: &mut Timer,
        maps: &IrradianceMaps,
        bindings: &wgpu::BindGroup,
    ) -> Result<f64, RenderError> {
        timer.start_frame();
        let mut encoder = encoder(gpu);
        {
            let span = timer.span("path irradiance");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("path: irradiance"),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(maps.size_px[0].div_ceil(8), maps.size_px[1].div_ceil(8), 1);
        }
        timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        gpu.wait("tracing irradiance")?;
        Ok(timer.read_ms(gpu)?.iter().map(|(_, ms)| ms).sum())
    }

    fn bindings(
        &self,
        gpu: &Gpu,
        maps: &IrradianceMaps,
        job: &IrradianceJob<'_>,
        settings: &wgpu::Buffer,
    ) -> wgpu::BindGroup {
        let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let (without, with_all) = (whole(&maps.without), whole(&maps.with_all));
        gpu.bind(
            "path: irradiance",
            &self.pipeline.get_bind_group_layout(0),
            &[
                job.occluders.buffers.nodes.as_entire_binding(),
                job.occluders.buffers.triangles.as_entire_binding(),
                job.environment.texels.as_entire_binding(),
                job.environment.cells.as_entire_binding(),
                wgpu::BindingResource::TextureView(job.places),
                wgpu::BindingResource::TextureView(job.normals),
                settings.as_entire_binding(),
                maps.sums.as_entire_binding(),
                wgpu::BindingResource::TextureView(&without),
                wgpu::BindingResource::TextureView(&with_all),
            ],
        )
    }
}

fn encoder(gpu: &Gpu) -> wgpu::CommandEncoder {
    gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
        label: Some("path: irradiance"),
    })
}
