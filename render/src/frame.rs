//! One frame, from pictures to picture: every step, in order.

use std::time::Instant;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::{Frame, FrameSet};

use crate::ball_place::BallPlace;
use crate::config::{self, SceneCamera};
use crate::error::RenderError;
use crate::eye::Eye;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::gpu::types::{GpuCamera, GpuFrame, GpuNoise, GpuStrong, MAX_STRONG};
use crate::mode::Viewers;
use crate::node::{RenderNode, RenderedFrame, Work};
use crate::passes::lamp_light::GpuLamps;
use crate::passes::ray_light::GpuLightProbe;
use crate::probe::Light;
use crate::scene_shadows::{SceneShadows, ShadowFrame};
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
        self.measure_look(frame, pose.camera_from_world());
        stages_ms.push(("look", ms_since(begun)));

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
                match (self.work, self.mode().viewers()) {
                    (Work::LightOnly, _) | (_, Viewers::Camera) => untouched(frame),
                    (Work::Everything, Viewers::OneEye | Viewers::TwoEyes) => self.draw_without_scene()?,
                }
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
            mode: self.mode(),
            size_px: self.size_px(),
            rgba,
            stages_ms,
        })
    }

    /// Measures how blurred the picture is.
    fn measure_look(&mut self, frame: &Frame, camera_from_world: Option<&Pose>) {
        match (self.config.look.sharpness, camera_from_world) {
            (config::Sharpness::Measured, Some(pose)) => {
                self.sharpness
                    .update(frame, self.rig.scene_camera(), &self.rig.markers, pose);
            }
            (config::Sharpness::Measured, None) | (config::Sharpness::Off, _) => {}
        }
    }

    /// Gives the virtual pixels of every eye the blur and the noise of this frame.
    fn set_look(&mut self, frame: &Frame) {
        let noise = match self.config.look.noise {
            config::Noise::Measured => {
                let photometry = &self.rig.scene_camera().photometry;
                GpuNoise::new(photometry, &frame.meta.exposure, frame.meta.sequence)
            }
            config::Noise::Off => <GpuNoise as bytemuck::Zeroable>::zeroed(),
        };
        let blur_px2 = self.sharpness.blur_px2();
        for eye in &mut self.eyes {
            // A display shows objects as sharp as they are; so does a view of an eye's own, whose pixels are others.
            eye.look.set(&self.gpu, blur_px2.filter(|_| eye.own.is_none()));
            eye.finish.set_noise(&self.gpu, &noise);
        }
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
        for eye in &self.eyes {
            if let Some(own) = &eye.own {
                let eye_from_world = eye.from_world(camera_from_world);
                gpu.write(
                    &own.view.camera,
                    &[self.gpu_camera(&own.view.model, &eye_from_world, frame)],
                );
            }
        }
        let probe_m = self.probe.optics().position_m();
        gpu.write(&self.room, &[probe_m.extend(light.room_m)]);
        self.pictures.radiance.upload(gpu, &light.radiance, &light.strong);
        self.pictures.far.upload(gpu, &light.far, &light.strong);
        self.pictures.behind.upload(gpu, &light.behind, &light.strong);
        gpu.write(&self.pictures.strong, &[gpu_strong(light)]);
        gpu.write(
            &self.scene.lamps,
            &[GpuLamps::new(&self.lamps, |lamp| {
                self.whereabouts.world_from_carrier(lamp, &self.given_rig)
            })],
        );
        self.environments
            .place(gpu, self.probe.optics().position_m(), light.room_m);
        self.near.upload(gpu, light, self.probe.optics().position_m());
    }

    /// Every pass of the picture, in order.
    fn draw(&mut self, frame: &Frame, camera_from_world: &Pose, light: &Light) -> Result<Vec<u8>, RenderError> {
        self.upload(frame, camera_from_world, light);
        self.set_look(frame);
        let (of_frame, of_rays) = (self.gpu_frame(), self.gpu_light_probe(light));
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
        for eye in &mut self.eyes {
            let eye_m = eye.from_world(camera_from_world).inverse().translation.as_vec3();
            eye.shade.sort(scene, &self.placements, eye_m);
            if let Some(own) = &eye.own {
                own.record(&mut surfaces, timer, scene);
            }
            eye.virtuals.record(&mut surfaces, timer, (scene, &scene.virtuals));
            eye.near.write(gpu, &of_frame);
            eye.receive.write(gpu, &of_frame);
            eye.traced.write(gpu, &of_rays);
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
        passes.room_mips.record(&mut encoder, timer);
        passes.light_maps.record(&mut encoder, timer, &self.environments);
        passes.irradiance.record(&mut encoder, timer);
        self.near.record(&mut encoder, timer);
        for eye in &mut self.eyes {
            let seen_from = (&self.shadows, &shadow_frame, camera_from_world);
            record_eye(gpu, &mut encoder, timer, eye, seen_from)?;
        }
        self.insets.record(&mut encoder, timer);
        for eye in &self.eyes {
            eye.finish.codes().record(&mut encoder);
        }
        timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        self.read_picture()
    }

    /// The eyes' pictures while there is no pose or no light: real things as far away as the room, no virtual ones.
    fn draw_without_scene(&mut self) -> Result<Vec<u8>, RenderError> {
        let (gpu, timer) = (&self.gpu, &mut self.timer);
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        Gpu::clear(&mut encoder, &[self.seen.phantoms.views().place]);
        for eye in &self.eyes {
            if let Some(own) = &eye.own {
                own.record_flat(&mut encoder, timer);
            }
            eye.record_nothing(&mut encoder);
            eye.finish.record(&mut encoder, timer);
            eye.finish.codes().record(&mut encoder);
        }
        timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        self.read_picture()
    }

    /// The finished pictures of all eyes, side by side.
    fn read_picture(&self) -> Result<Vec<u8>, RenderError> {
        let [width, height] = self.size_px();
        let mut rgba = vec![0; 4 * (width * height) as usize];
        for (index, eye) in self.eyes.iter().enumerate() {
            let place = (index, self.eyes.len());
            eye.finish.codes().read_beside(&self.gpu, &mut rgba, place)?;
        }
        Ok(rgba)
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

    /// Where the light was measured, and the ball as rays meet it: without a known reflectance none does.
    fn gpu_light_probe(&self, light: &Light) -> GpuLightProbe {
        let ball = self.gpu_frame().ball_m;
        let reflectance = self.ball_place.as_ref().map_or(Vec3::ZERO, BallPlace::reflectance);
        GpuLightProbe {
            position_m: self.probe.optics().position_m().extend(light.room_m),
            ball_m: if reflectance == Vec3::ZERO { Vec4::ZERO } else { ball },
            ball_reflectance: reflectance.extend(match self.config.probe.scene_camera {
                SceneCamera::Fills => 1.0,
                SceneCamera::Ignored => 0.0,
            }),
        }
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

/// Every pass of one eye's picture, in order; the passes that eyes share are recorded.
fn record_eye(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    timer: &mut Timer,
    eye: &mut Eye,
    (shadows, frame, camera_from_world): (&SceneShadows, &ShadowFrame<'_>, &Pose),
) -> Result<(), RenderError> {
    let eye_from_world = eye.from_world(camera_from_world);
    shadows.record_eye(gpu, encoder, timer, (&mut eye.shadows, frame, &eye_from_world))?;
    for lamps in &eye.lamps {
        lamps.record(encoder, timer);
    }
    if let Some(protect) = &eye.protect {
        protect.record(encoder, timer);
    }
    if let Some(unshadowed) = &eye.own_unshadowed {
        unshadowed.record(encoder, timer);
    }
    eye.near.record_change(encoder, timer);
    eye.receive.record(encoder, timer);
    eye.lamp_receive.record(encoder, timer);
    eye.real.record(encoder, timer);
    eye.near.record_light(encoder, timer);
    eye.traced.record(encoder, timer, frame.scene);
    eye.record_depth(encoder, timer, frame.scene);
    eye.shade.record(encoder, timer, frame.scene, eye.depth.view());
    if let Some(edges) = &eye.edges {
        edges.record(encoder, timer);
    }
    eye.look.record(encoder, timer);
    eye.finish.record(encoder, timer);
    Ok(())
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
