//! One frame, from pictures to picture: every step, in order.

use std::time::Instant;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::{Frame, FrameSet};

use crate::error::RenderError;
use crate::gpu::types::{GpuCamera, GpuFrame, GpuStrong, MAX_STRONG};
use crate::node::{RenderNode, RenderedFrame, Work};
use crate::probe::Light;
use crate::scene_shadows::ShadowFrame;
use mirrorball_calib::probe::ProbeOptics;

impl RenderNode {
    /// Renders the virtual objects into the scene camera's frame.
    ///
    /// Without a pose, and before any light was measured, the picture comes back as it is.
    ///
    /// # Errors
    /// [`RenderError::FrameSize`] or [`RenderError::NoSceneFrame`] for frames that the rig does not know,
    /// [`RenderError::RigMismatch`] when the first frames show that cameras are exchanged or have moved,
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn render(&mut self, set: &FrameSet) -> Result<RenderedFrame, RenderError> {
        let started = Instant::now();
        let frame = self.scene_frame(set)?;
        self.check_rig(set)?;
        self.timer.start_frame();
        let mut stages_ms = Vec::with_capacity(24);

        let pose = self.tracker.locate(frame, &self.rig, self.rig.scene_camera());
        stages_ms.push(("track", ms_since(started)));

        let begun = Instant::now();
        self.seen.picture.upload(&self.gpu, frame);
        self.measure_light(set, frame, pose.camera_from_world())?;
        stages_ms.push(("light", ms_since(begun)));

        let begun = Instant::now();
        let rgba = match (pose.camera_from_world(), self.light.take()) {
            (Some(camera_from_world), Some(light)) => {
                let rgba = match self.work {
                    Work::Everything => self.draw(frame, camera_from_world, &light),
                    Work::LightOnly => {
                        self.move_light(frame, camera_from_world, &light);
                        Ok(untouched(frame))
                    }
                };
                self.light = Some(light);
                rgba?
            }
            (_, light) => {
                self.light = light;
                untouched(frame)
            }
        };
        stages_ms.push(("draw", ms_since(begun)));
        stages_ms.push(("total", ms_since(started)));
        stages_ms.extend(self.timer.read_ms(&self.gpu)?);
        Ok(RenderedFrame {
            sequence: frame.meta.sequence,
            timestamp_ns: frame.meta.timestamp_ns,
            pose,
            light: self.light_report(),
            size_px: self.rig.scene_camera().intrinsics.size_px,
            rgba,
            stages_ms,
        })
    }

    /// The light moved to every virtual object, and nothing else.
    fn move_light(&mut self, frame: &Frame, camera_from_world: &Pose, light: &Light) {
        self.upload(frame, camera_from_world, light);
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("light") });
        let (passes, timer) = (&mut self.passes, &mut self.timer);
        let scene = &self.scene;
        self.seen.phantoms.record(&mut encoder, timer, (scene, &scene.phantoms));
        passes.surroundings.record(&mut encoder, timer, &self.environments);
        passes.local_environment.record(&mut encoder, timer);
        timer.record(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Hands the camera, the objects' places and the light of this frame to the GPU.
    fn upload(&mut self, frame: &Frame, camera_from_world: &Pose, light: &Light) {
        self.move_objects(frame, camera_from_world);
        let gpu = &self.gpu;
        let camera = self.gpu_camera(self.rig.scene_camera(), camera_from_world, frame);
        gpu.write(&self.seen.camera, &[camera]);
        self.pictures.radiance.upload(gpu, &light.radiance, &light.strong);
        self.pictures.far.upload(gpu, &light.far, &light.strong);
        self.pictures.behind.upload(gpu, &light.behind, &light.strong);
        gpu.write(&self.pictures.strong, &[gpu_strong(light)]);
        self.environments
            .place(gpu, self.probe.optics().position_m(), light.room_m);
    }

    /// Every pass of the picture, in order.
    fn draw(&mut self, frame: &Frame, camera_from_world: &Pose, light: &Light) -> Result<Vec<u8>, RenderError> {
        self.upload(frame, camera_from_world, light);
        let of_frame = self.gpu_frame();
        let gpu = &self.gpu;
        let encoder = |label| {
            gpu.device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) })
        };
        let (passes, timer, scene) = (&mut self.passes, &mut self.timer, &self.scene);

        // Surfaces go first, by themselves: some shadow methods submit work of their own that reads them.
        let mut surfaces = encoder("surfaces");
        self.seen
            .phantoms
            .record(&mut surfaces, timer, (scene, &scene.phantoms));
        for eye in &self.eyes {
            eye.virtuals.record(&mut surfaces, timer, (scene, &scene.virtuals));
            eye.receive.write(gpu, &of_frame);
        }
        gpu.queue.submit([surfaces.finish()]);

        let mut encoder = encoder("frame");
        let shadow_frame = ShadowFrame {
            scene,
            light,
            probe_m: self.probe.optics().position_m(),
            is_moved: self.whereabouts.changes().any(),
        };
        self.shadows.record(gpu, &mut encoder, timer, &shadow_frame);
        passes.surroundings.record(&mut encoder, timer, &self.environments);
        passes.local_environment.record(&mut encoder, timer);
        passes.light_maps.record(&mut encoder, timer, &self.environments);
        passes.irradiance.record(&mut encoder, timer);
        for eye in &mut self.eyes {
            let job = (&mut eye.shadows, &shadow_frame, camera_from_world);
            self.shadows.record_eye(gpu, &mut encoder, timer, job)?;
            eye.receive.record(&mut encoder, timer);
            eye.real.record(&mut encoder, timer);
            eye.depth.record(&mut encoder, timer, scene);
            eye.shade.record(&mut encoder, timer, scene, eye.depth.view());
            eye.composite.record(&mut encoder, timer);
        }
        timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        self.eyes[0].composite.read(gpu)
    }

    pub(crate) fn gpu_camera(&self, camera: &Camera, camera_from_world: &Pose, frame: &Frame) -> GpuCamera {
        let view = self.config.view;
        GpuCamera::new(
            camera,
            camera_from_world,
            &frame.meta.exposure,
            [view.near_m, view.far_m],
        )
    }

    fn gpu_frame(&self) -> GpuFrame {
        let ball_m = match self.probe.optics() {
            ProbeOptics::MirrorBall { ball, .. } => Some((ball.center_m, ball.radius_m)),
            ProbeOptics::Fisheye { .. } => self.rig.ball.as_ref().map(|ball| (ball.center_m, ball.radius_m)),
        };
        let (center_m, radius_m) = ball_m.unwrap_or((DVec3::ZERO, 0.0));
        GpuFrame {
            counts: [self.environments.slots.len() as u32, 0, 0, 0],
            ball_m: center_m.as_vec3().extend(radius_m as f32),
        }
    }
}

/// Where the strong lights stand, as the shader takes it.
fn gpu_strong(light: &Light) -> GpuStrong {
    let mut strong = <GpuStrong as bytemuck::Zeroable>::zeroed();
    for (index, of) in light.meter.lights.iter().take(MAX_STRONG).enumerate() {
        let directions = || of.texels.iter().map(|&texel| light.far.direction(texel));
        let direction = directions().sum::<Vec3>().normalize_or(Vec3::Z);
        let widest = directions().map(|d| d.angle_between(direction)).fold(0.0, f32::max);
        strong.lights[index] = direction.extend(of.distance_m);
        strong.cones[index] = Vec4::new(widest, 0.0, 0.0, 0.0);
    }
    strong
}

/// The camera's picture as RGBA.
fn untouched(frame: &Frame) -> Vec<u8> {
    frame
        .pixels
        .chunks_exact(3)
        .flat_map(|p| [p[0], p[1], p[2], 255])
        .collect()
}

fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
