//! Light from afar as lights that rays can ask (`shared/far_lights.wgsl`).

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use crate::gpu::Gpu;
use crate::probe::Light;
use crate::scene_shadows::dome_light;
use crate::shadow::dome::MAX_DOME_LIGHTS;

/// One light (`FarLight` in `shared/far_lights.wgsl`). World frame, metres, linear RGB.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuFarLight {
    /// xyz: where it stands; w: tangent of half the angle that it fills.
    pub position_m: Vec4,
    /// xyz: intensity, so that irradiance = intensity cos θ / distance²; w: unused.
    pub intensity: Vec4,
}

/// All lights (`FarLights` in `shared/far_lights.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuFarLights {
    /// xyz: where the light was measured, world, metres; w: number of lights.
    pub position_m: Vec4,
    /// The lights; those beyond the number are unused.
    pub lights: [GpuFarLight; MAX_DOME_LIGHTS],
}

/// The lights on the GPU, uniform.
#[derive(Debug)]
pub struct FarLights {
    buffer: wgpu::Buffer,
}

impl FarLights {
    /// No light yet.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            buffer: gpu.buffer("near: light from afar", &[GpuFarLights::zeroed()]),
        }
    }

    /// Uploads the lights of a frame, measured at `probe_m` (world, metres).
    pub fn upload(&self, gpu: &Gpu, light: &Light, probe_m: Vec3) {
        let mut lights = GpuFarLights::zeroed();
        let mut n = 0;
        for (slot, key) in lights.lights.iter_mut().zip(&light.lights) {
            let placed = dome_light(key, probe_m);
            *slot = GpuFarLight {
                position_m: placed.position_m.extend(placed.angular_radius_rad.min(1.4).tan()),
                intensity: placed.intensity.extend(0.0),
            };
            n += 1;
        }
        lights.position_m = probe_m.extend(n as f32);
        gpu.write(&self.buffer, &[lights]);
    }

    /// The uniform buffer ([`GpuFarLights`]).
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}
