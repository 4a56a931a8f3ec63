//! Probe picture to radiance cube.

use glam::{Vec3, Vec4};

use super::groups;
use crate::config::ProbeConfig;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::{GpuCamera, GpuProbe};
use crate::scene_gpu::PictureBuffers;
use mirrorball_calib::probe::ProbeOptics;
use mirrorball_calib::probe::cube::{Cube, FACES};
use mirrorball_calib::probe::mapping::Mapping;
use mirrorball_calib::probe::radiance_map::{OUTLINE_RAMP_PX, RIM_RAMP_PX};

/// The pass with its buffers.
#[derive(Debug)]
pub struct RadianceMap {
    pipeline: wgpu::ComputePipeline,
    /// Bindings of every picture that was looked at.
    bindings: Vec<(wgpu::TextureView, wgpu::BindGroup)>,
    camera: wgpu::Buffer,
    probe: wgpu::Buffer,
    near_m: wgpu::Buffer,
    out: Readback,
    cube_size: u32,
}

impl RadianceMap {
    /// A pass for cubes like `near_m`, the distances to the first phantom in metres.
    #[must_use]
    pub fn new(gpu: &Gpu, near_m: &Cube<f32>) -> Self {
        let texels = near_m.texels().len();
        Self {
            pipeline: gpu.compute_pipeline("radiance_map"),
            bindings: Vec::new(),
            camera: gpu.buffer("radiance_map: camera", &[<GpuCamera as bytemuck::Zeroable>::zeroed()]),
            probe: gpu.buffer("radiance_map: probe", &[<GpuProbe as bytemuck::Zeroable>::zeroed()]),
            near_m: gpu.buffer("radiance_map: distances", near_m.texels()),
            out: Readback::new(gpu, "radiance_map: radiance", (texels * size_of::<Vec4>()) as u64),
            cube_size: near_m.size(),
        }
    }

    /// Says how far away what each direction shows is taken to be, metres; the room's distance of [`CubePlace`] is the most.
    pub fn write_distances(&self, gpu: &Gpu, distance_m: &Cube<f32>) {
        gpu.write(&self.near_m, distance_m.texels());
    }

    /// Measures the cube; texels are [`Seen::pack`]ed, 0 where nothing is seen.
    ///
    /// [`Seen::pack`]: mirrorball_calib::probe::radiance_map::Seen::pack
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn run(
        &mut self,
        gpu: &Gpu,
        timer: &mut Timer,
        inputs: (&GpuCamera, &GpuProbe, &PictureBuffers),
    ) -> Result<Vec<Vec4>, RenderError> {
        let (camera, probe, picture) = inputs;
        gpu.write(&self.camera, &[*camera]);
        gpu.write(&self.probe, &[*probe]);
        let index = self.bindings_of(gpu, picture);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
            label: Some("radiance_map"),
        });
        {
            let span = timer.span("radiance_map");
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("radiance_map"),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings[index].1, &[]);
            pass.dispatch_workgroups(groups(self.cube_size), groups(self.cube_size), FACES as u32);
        }
        self.out.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        let mut out = vec![Vec4::ZERO; FACES * (self.cube_size * self.cube_size) as usize];
        self.out.read(gpu, &mut out)?;
        Ok(out)
    }
}

impl RadianceMap {
    /// Index of the bindings of a picture, made when it is first looked at: one per camera of the rig.
    fn bindings_of(&mut self, gpu: &Gpu, picture: &PictureBuffers) -> usize {
        if let Some(index) = self.bindings.iter().position(|(view, _)| *view == picture.view) {
            return index;
        }
        let bindings = gpu.bind(
            "radiance_map",
            &self.pipeline.get_bind_group_layout(0),
            &[
                self.camera.as_entire_binding(),
                self.probe.as_entire_binding(),
                picture.response.as_entire_binding(),
                wgpu::BindingResource::TextureView(&picture.view),
                self.near_m.as_entire_binding(),
                self.out.buffer().as_entire_binding(),
            ],
        );
        self.bindings.push((picture.view.clone(), bindings));
        self.bindings.len() - 1
    }
}

/// Where a cube's light arrives, and how far away the room is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubePlace {
    /// The cube's centre, world frame, metres.
    pub origin_m: Vec3,
    /// Distance of the room from it, metres.
    pub room_m: f32,
}

/// The probe as the shader takes it; `camera_m` is the centre of the camera that looks at it, world frame, metres.
#[must_use]
pub fn gpu_probe(optics: &ProbeOptics, camera_m: Vec3, config: &ProbeConfig, place: CubePlace) -> GpuProbe {
    let (radius_m, reflectance) = match optics {
        ProbeOptics::MirrorBall { ball, reflectance } => (ball.radius_m as f32, *reflectance),
        ProbeOptics::Fisheye { .. } => (0.0, Vec3::ONE),
    };
    let position_m = optics.position_m();
    let trust = config.trust();
    let camera_angle = (trust.camera_radius_m / camera_m.distance(position_m).max(1e-3))
        .min(1.0)
        .asin();
    let wrap = match config.mapping() {
        Mapping::Exact => -1.0,
        Mapping::Simple { wrap } => wrap as f32,
    };
    let [outline, rim] = [OUTLINE_RAMP_PX, RIM_RAMP_PX].map(|ramp| ramp.map(|px| px as f32));
    GpuProbe {
        position_m: position_m.extend(radius_m),
        origin_m: place.origin_m.extend(place.room_m),
        reflectance: reflectance.extend(wrap),
        limits: Vec4::new(
            trust.min_view_cosine,
            trust.full_view_cosine(),
            camera_angle,
            config.cube_size as f32,
        ),
        ramps_px: Vec4::new(outline[0], outline[1], rim[0], rim[1]),
    }
}
