//! One frame, from pictures to picture: every step, in order.

use std::time::Instant;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::{Frame, FrameSet};

use crate::error::RenderError;
use crate::gpu::types::{GpuAim, GpuCamera, GpuFrame, GpuLight, GpuStrong, MAX_CASTER_SPHERES, MAX_STRONG};
use crate::node::{RenderNode, RenderedFrame, Work};
use crate::passes::shadow_map::{ShadowView, ShadowWork, Sphere};
use crate::probe::Light;
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::probe::ProbeOptics;
use mirrorball_calib::probe::radiance::luminance;

/// Height over the receiver that a penumbra is filtered for, metres: half of a thing that stands on a table.
const CASTER_HEIGHT_M: f32 = 0.03;
/// A light that gives less than this share of the light has its shadows compared with one tap: its edges do not show.
const SINGLE_TAP_SHARE: f32 = 0.02;
/// A light that is farther away than this counts as that far, metres: nothing near the probe sees the difference.
const FARTHEST_LIGHT_M: f32 = 1000.0;
/// Room around a virtual object for the filter of its shadow, metres.
const CASTER_MARGIN_M: f32 = 0.01;
/// The phantoms' shadow maps reach this far around the virtual objects, metres.
const RECEIVER_MARGIN_M: f32 = 0.1;

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
        self.pictures.scene.upload(&self.gpu, frame);
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
        passes.camera_depth.record(&mut encoder, timer, &self.scene);
        passes.local_environment.record(&mut encoder, timer);
        timer.record(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Hands the camera and the light of this frame to the GPU.
    fn upload(&mut self, frame: &Frame, camera_from_world: &Pose, light: &Light) {
        let gpu = &self.gpu;
        let camera = self.gpu_camera(self.rig.scene_camera(), camera_from_world, frame);
        gpu.write(&self.pictures.camera, &[camera]);
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
        let gpu = &self.gpu;
        let probe_m = self.probe.optics().position_m();
        let lights = self.gpu_lights(light, probe_m);
        let aims = |receivers: Sphere| -> Vec<Option<GpuAim>> {
            let is_lit = |l: &GpuLight| l.intensity.truncate() != Vec3::ZERO;
            lights
                .iter()
                .map(|l| is_lit(l).then(|| self.aim(l.position_m.truncate(), receivers)))
                .collect()
        };
        let (phantom_aims, virtual_aims) = (aims(self.receivers()), aims(self.bounds.virtuals));
        self.passes.direct.write(gpu, &self.gpu_frame(lights.len()), &lights);

        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let (passes, timer, scene) = (&mut self.passes, &mut self.timer, &self.scene);
        let work = ShadowWork {
            maps: &mut passes.phantom_maps,
            scene,
            casters: &scene.phantoms,
            aims: &phantom_aims,
        };
        passes.shadow_map.record(gpu, &mut encoder, timer, work);
        let work = ShadowWork {
            maps: &mut passes.virtual_maps,
            scene,
            casters: &scene.virtuals,
            aims: &virtual_aims,
        };
        passes.shadow_map.record(gpu, &mut encoder, timer, work);
        passes.camera_depth.record(&mut encoder, timer, scene);
        passes.local_environment.record(&mut encoder, timer);
        passes.light_maps.record(&mut encoder, timer, &self.environments);
        passes.irradiance.record(&mut encoder, timer);
        passes
            .receive
            .record(&mut encoder, timer, scene, passes.camera_depth.single());
        passes
            .shade
            .record(&mut encoder, timer, scene, passes.camera_depth.multisampled());
        passes.composite.record(&mut encoder, timer);
        timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        passes.composite.read(gpu)
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

    fn gpu_frame(&self, n_lights: usize) -> GpuFrame {
        let taps = self.config.shadow.pcf_taps.isqrt();
        let ball_m = match self.probe.optics() {
            ProbeOptics::MirrorBall { ball, .. } => Some((ball.center_m, ball.radius_m)),
            ProbeOptics::Fisheye { .. } => self.rig.ball.as_ref().map(|ball| (ball.center_m, ball.radius_m)),
        };
        let (center_m, radius_m) = ball_m.unwrap_or((DVec3::ZERO, 0.0));
        GpuFrame {
            counts: [
                n_lights as u32,
                taps,
                self.environments.slots.len() as u32,
                self.config.shadow.map_size,
            ],
            ball_m: center_m.as_vec3().extend(radius_m as f32),
            receivers_m: self.receivers().to_vec4(),
            virtuals_m: self.bounds.virtuals.to_vec4(),
            everything_m: self.bounds.everything.to_vec4(),
            casters_m: self.caster_spheres(),
        }
    }

    /// What the phantoms' shadow maps cover: the virtual objects and the ground around them.
    fn receivers(&self) -> Sphere {
        let virtuals = self.bounds.virtuals;
        Sphere {
            radius_m: 1.3 * virtuals.radius_m + RECEIVER_MARGIN_M,
            ..virtuals
        }
    }

    /// Spheres around the virtual objects; those beyond the last place make the last one larger.
    fn caster_spheres(&self) -> [Vec4; MAX_CASTER_SPHERES] {
        let mut spheres = [Vec4::new(0.0, 0.0, 0.0, -1.0); MAX_CASTER_SPHERES];
        for (index, slot) in self.environments.slots.iter().enumerate() {
            let radius_m = slot.radius_m + CASTER_MARGIN_M;
            match spheres.get_mut(index) {
                Some(sphere) => *sphere = slot.center_m.extend(radius_m),
                None => {
                    let last = &mut spheres[MAX_CASTER_SPHERES - 1];
                    last.w = last.w.max(last.truncate().distance(slot.center_m) + radius_m);
                }
            }
        }
        spheres
    }

    fn aim(&self, light_m: Vec3, receivers: Sphere) -> GpuAim {
        GpuAim {
            position_m: light_m.extend(self.config.shadow.map_size as f32),
            receivers_m: receivers.to_vec4(),
            casters_m: self.bounds.everything.to_vec4(),
        }
    }

    fn gpu_lights(&self, light: &Light, probe_m: Vec3) -> Vec<GpuLight> {
        let total: f32 = light.lights.iter().map(|l| luminance(l.irradiance)).sum();
        light
            .lights
            .iter()
            .map(|l| {
                let taps = if luminance(l.irradiance) < SINGLE_TAP_SHARE * total {
                    Taps::One
                } else {
                    Taps::Many
                };
                self.gpu_light(l, taps, probe_m)
            })
            .collect()
    }

    /// A light at its distance from the probe, its shadows filtered for its size.
    fn gpu_light(&self, light: &KeyLight, taps: Taps, probe_m: Vec3) -> GpuLight {
        let distance_m = light.distance_m.min(FARTHEST_LIGHT_M);
        let position_m = probe_m + light.direction * distance_m;
        // Taps further apart than a texel and a half would show as copies of the edge.
        let widest = 0.75 * (self.config.shadow.pcf_taps.isqrt() - 1) as f32;
        let radius = |receivers: Sphere| {
            if taps == Taps::One {
                return 0.0;
            }
            let texel_m = ShadowView::new(&self.aim(position_m, receivers)).texel_m;
            (light.angular_radius_rad * CASTER_HEIGHT_M / texel_m).clamp(0.75, widest.max(0.75))
        };
        GpuLight {
            position_m: position_m.extend(radius(self.receivers())),
            intensity: (light.irradiance * distance_m * distance_m).extend(radius(self.bounds.virtuals)),
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

/// How a light's shadow is filtered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Taps {
    /// One bilinear comparison.
    One,
    /// Percentage-closer filtering over the light's penumbra.
    Many,
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
