//! A picture that gets better sample by sample: a few samples per submission, so that no submission takes long.

use std::time::{Duration, Instant};

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::environment::EnvironmentBuffers;
use super::hierarchy::within_binding;
use super::scene::TracedScene;
use super::{PathJob, PathPicture, PathSettings, PathTracer, PixelRays, Sampling, refused};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::readback::Readback;
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::light::{GpuShadowLight, ShadowLight};

/// A submission takes about this long at most, far from what makes a driver give up.
const SUBMISSION: Duration = Duration::from_millis(150);
/// Most samples in a submission.
const MAX_BATCH: u32 = 256;
/// A rectangle smaller than this gives no light, square metres.
const SMALLEST_AREA_M2: f32 = 1e-12;

/// How a pass traces (`Settings` in `shadow_path.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuPathSettings {
    /// First sample and number of samples, surfaces along a path at most, seed.
    pub counts: [u32; 4],
    /// Root of the hierarchy, texels along the environment's edge, whether the environment and the light are drawn.
    pub scene: [u32; 4],
    /// x: [`Sampling`]; y: 1 for rays all over the pixel.
    pub choices: [u32; 4],
}

/// What a pixel's samples sum to (`Sum` in `shadow_path.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct GpuSum {
    /// xyz: radiance; w: how many first rays met a surface.
    radiance: Vec4,
    /// xyz: squares of the radiance; w: number of samples.
    squares: Vec4,
}

/// A picture being traced.
#[derive(Debug)]
pub struct PathRun<'a> {
    tracer: &'a PathTracer,
    settings: GpuPathSettings,
    settings_buffer: wgpu::Buffer,
    bindings: wgpu::BindGroup,
    sums: Readback,
    size_px: [u32; 2],
    /// Samples in the next submission.
    batch: u32,
    timer: Timer,
    /// Milliseconds on the GPU so far, where it tells.
    elapsed_ms: Option<f64>,
}

impl<'a> PathRun<'a> {
    /// A picture without samples yet.
    ///
    /// # Errors
    /// As [`PathTracer::render`].
    pub fn start(
        gpu: &Gpu,
        tracer: &'a PathTracer,
        scene: &TracedScene,
        job: &PathJob<'_>,
    ) -> Result<Self, RenderError> {
        let size_px = job.view.size_px;
        let view = job.view.to_gpu();
        if !view.world_from_clip.is_finite() || size_px.contains(&0) {
            return Err(refused(
                "the view is flat or no finite number",
                "check its place and angles",
            ));
        }
        let n_pixels = size_px[0] as usize * size_px[1] as usize;
        within_binding(gpu, "a number of bytes of a picture", n_pixels * size_of::<GpuSum>())?;
        let light = checked(job.light)?;
        let environment = EnvironmentBuffers::new(gpu, &job.environment)?;
        let settings = gpu_settings(&job.settings, scene, &environment, light.is_some());
        let settings_buffer = gpu.buffer("path: settings", &[settings]);
        let sums = Readback::new(gpu, "path: sums", (n_pixels * size_of::<GpuSum>()) as u64);
        let light = light.unwrap_or_else(GpuShadowLight::zeroed);
        let buffers = [
            &environment.texels,
            &environment.cells,
            &scene.corners,
            &scene.materials,
            &gpu.buffer("path: view", &[view]),
            &gpu.buffer("path: light", &[light]),
            &settings_buffer,
            sums.buffer(),
        ];
        let bindings = bound(gpu, tracer, scene, (&buffers, job.target, size_px));
        Ok(Self {
            tracer,
            settings,
            settings_buffer,
            bindings,
            sums,
            size_px,
            batch: 1,
            timer: Timer::new(gpu),
            elapsed_ms: None,
        })
    }

    /// Paths per pixel so far.
    #[must_use]
    pub fn samples(&self) -> u32 {
        self.settings.counts[0]
    }

    /// Traces `samples` more paths per pixel. How they are split into submissions and calls does not change the picture.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn add(&mut self, gpu: &Gpu, samples: u32) -> Result<(), RenderError> {
        let mut left = samples;
        while left > 0 {
            let n = self.batch.min(left);
            let start = Instant::now();
            self.submit(gpu, n)?;
            let took = start.elapsed();
            if n == self.batch && 2 * took < SUBMISSION {
                self.batch = (2 * self.batch).min(MAX_BATCH);
            } else if took > SUBMISSION {
                self.batch = (self.batch / 2).max(1);
            }
            left -= n;
        }
        Ok(())
    }

    fn submit(&mut self, gpu: &Gpu, n: u32) -> Result<(), RenderError> {
        self.settings.counts[1] = n;
        gpu.write(&self.settings_buffer, &[self.settings]);
        self.timer.start_frame();
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("path") });
        {
            let span = self.timer.span("path");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("path"),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(&self.tracer.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups(self.size_px[0].div_ceil(8), self.size_px[1].div_ceil(8), 1);
        }
        self.timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        gpu.wait("tracing paths")?;
        for (_, ms) in self.timer.read_ms(gpu)? {
            *self.elapsed_ms.get_or_insert(0.0) += ms;
        }
        self.settings.counts[0] += n;
        Ok(())
    }

    /// The picture so far; black without samples.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn picture(&self, gpu: &Gpu) -> Result<PathPicture, RenderError> {
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("path") });
        self.sums.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        let n_pixels = self.size_px[0] as usize * self.size_px[1] as usize;
        let mut sums = vec![GpuSum::zeroed(); n_pixels];
        self.sums.read(gpu, &mut sums)?;
        Ok(PathPicture {
            size_px: self.size_px,
            radiance: sums.iter().map(GpuSum::mean).collect(),
            standard_error: sums.iter().map(GpuSum::standard_error).collect(),
            samples: self.samples(),
            stages_ms: self.elapsed_ms.map(|ms| ("path", ms)).into_iter().collect(),
        })
    }
}

impl GpuSum {
    fn mean(&self) -> Vec4 {
        self.radiance / self.squares.w.max(1.0)
    }

    fn standard_error(&self) -> Vec3 {
        let n = self.squares.w.max(1.0);
        let mean = self.radiance.truncate() / n;
        let variance = (self.squares.truncate() / n - mean * mean).max(Vec3::ZERO);
        (variance / (n - 1.0).max(1.0)).map(f32::sqrt)
    }
}

/// All that the pass reads and writes: the hierarchy, `buffers` and the picture, its own one where no target is given.
fn bound(
    gpu: &Gpu,
    tracer: &PathTracer,
    scene: &TracedScene,
    (buffers, target, size_px): (&[&wgpu::Buffer], Option<&wgpu::TextureView>, [u32; 2]),
) -> wgpu::BindGroup {
    let own_target;
    let target = match target {
        Some(target) => target,
        None => {
            own_target = gpu
                .target("path: radiance", TextureShape::plain(size_px), RADIANCE_FORMAT)
                .create_view(&wgpu::TextureViewDescriptor::default());
            &own_target
        }
    };
    let resources: Vec<wgpu::BindingResource<'_>> = [&scene.hierarchy.nodes, &scene.hierarchy.triangles]
        .iter()
        .chain(buffers)
        .map(|buffer| buffer.as_entire_binding())
        .chain([wgpu::BindingResource::TextureView(target)])
        .collect();
    gpu.bind("path", &tracer.pipeline.get_bind_group_layout(0), &resources)
}

/// The light for the shaders; none where it has no size to shine from.
fn checked(light: Option<&ShadowLight>) -> Result<Option<GpuShadowLight>, RenderError> {
    let Some(light) = light else { return Ok(None) };
    let gpu_light = light.to_gpu();
    let numbers = [gpu_light.position_m, gpu_light.u, gpu_light.v, gpu_light.power];
    if !numbers.iter().all(|v| v.is_finite()) {
        return Err(refused(
            format!("the light is no finite number: {light:?}"),
            "check its place and power",
        ));
    }
    let is_lit = match light {
        ShadowLight::Rect { half_u_m, half_v_m, .. } => 4.0 * half_u_m.cross(*half_v_m).length() > SMALLEST_AREA_M2,
        ShadowLight::Point { .. } | ShadowLight::Spot { .. } | ShadowLight::Directional { .. } => true,
    };
    Ok(is_lit.then_some(gpu_light))
}

fn gpu_settings(
    settings: &PathSettings,
    scene: &TracedScene,
    environment: &EnvironmentBuffers,
    is_lit: bool,
) -> GpuPathSettings {
    let sampling = match settings.sampling {
        Sampling::Both => 0,
        Sampling::Lights => 1,
        Sampling::Surfaces => 2,
    };
    GpuPathSettings {
        counts: [0, 0, settings.max_bounces, settings.seed],
        scene: [
            scene.root,
            environment.size,
            u32::from(environment.is_drawn),
            u32::from(is_lit),
        ],
        choices: [sampling, u32::from(settings.pixel == PixelRays::Everywhere), 0, 0],
    }
}
