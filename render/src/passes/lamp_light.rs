//! Light of the virtual lamps on a surface, past the shadows of all objects.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Vec4};

use super::direct::ShadowedLight;
use super::groups;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::scene::{GONE, Lamp, LampKind, MAX_LAMPS};
use crate::scene_gpu::SceneBuffers;
use crate::scene_rays::SceneRays;
use crate::shadow::dome::Step;
use crate::shadow::surface::SurfaceViews;

/// A lamp as the shaders take it (`Lamp` in `shared/lamp.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuLamp {
    /// xyz: its middle, world, metres; w: 0 a ball, 1 a distant lamp, 2 a rectangle.
    pub position_m: Vec4,
    /// xyz: unit direction in which it shines, world; w: radius of a ball in metres, sine of a distant lamp's angular radius.
    pub direction: Vec4,
    /// xyz: half of a rectangle's first side, metres; w: cosine of the angle that a ball shines into fully.
    pub across: Vec4,
    /// xyz: half of its second side; w: cosine of the angle beyond which a ball does not shine.
    pub along: Vec4,
    /// xyz: irradiance on a surface that faces it 1 m away, linear RGB; w: unused.
    pub irradiance: Vec4,
}

/// All lamps (`Lamps` in `shared/lamp.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuLamps {
    /// x: how many there are; y: one bit for each whose shadows are soft; z, w: unused.
    pub counts: [u32; 4],
    /// The lamps.
    pub all: [GpuLamp; MAX_LAMPS],
}

impl GpuLamps {
    /// The first [`MAX_LAMPS`] of `lamps`, moved with what carries them, world from carrier; a lamp whose carrier is [`GONE`]
    /// is left out.
    #[must_use]
    pub fn new(lamps: &[Lamp], world_from_carrier: impl Fn(&Lamp) -> Affine3A) -> Self {
        let mut gpu = Self::zeroed();
        let placed = lamps.iter().map(|lamp| (lamp, world_from_carrier(lamp)));
        let there = placed.filter(|(_, placement)| *placement != GONE);
        for (slot, (lamp, placement)) in gpu.all.iter_mut().zip(there) {
            *slot = GpuLamp::new(lamp, placement);
            gpu.counts[1] |= u32::from(!lamp.kind.is_hard()) << gpu.counts[0];
            gpu.counts[0] += 1;
        }
        gpu
    }
}

impl GpuLamp {
    /// A lamp whose carrier stands at `world_from_carrier`.
    #[must_use]
    pub fn new(lamp: &Lamp, world_from_carrier: Affine3A) -> Self {
        let position = world_from_carrier.transform_point3(lamp.position_m);
        let direction = world_from_carrier.transform_vector3(lamp.direction).normalize();
        let across = world_from_carrier.transform_vector3(lamp.across).normalize();
        let along = direction.cross(across);
        // Cosines that every direction is within.
        let all_round = [-1.0, -2.0];
        let (kind, size, half_m, [inner, outer]) = match lamp.kind {
            LampKind::Point { radius_m } => (0.0, radius_m, [0.0; 2], all_round),
            LampKind::Spot {
                radius_m,
                inner_rad,
                outer_rad,
            } => (0.0, radius_m, [0.0; 2], [inner_rad.cos(), outer_rad.cos()]),
            LampKind::Directional { angular_radius_rad } => (1.0, angular_radius_rad.sin(), [0.0; 2], all_round),
            LampKind::Rectangle { half_m } => (2.0, 0.0, half_m, all_round),
        };
        Self {
            position_m: position.extend(kind),
            direction: direction.extend(size),
            across: (half_m[0] * across).extend(inner),
            along: (half_m[1] * along).extend(outer),
            irradiance: lamp.irradiance.extend(0.0),
        }
    }
}

/// The pass for one surface; without lamps it does nothing, and its targets stay black.
#[derive(Debug)]
pub struct LampLight {
    /// Rays, and their sum; none without lamps.
    steps: Option<[Step; 2]>,
    size_px: [u32; 2],
}

impl LampLight {
    /// A pass that fills the lamps' part of `light` on the surface that `views` shows.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        (scene, rays): (&SceneBuffers, &SceneRays),
        (views, light): (SurfaceViews<'_>, &ShadowedLight),
    ) -> Self {
        let size_px = views.size_px;
        if scene.n_lamps == 0 {
            return Self { steps: None, size_px };
        }
        let own_shares = gpu
            .texture("lamp_shares: rays", TextureShape::layered(size_px, 2), RADIANCE_FORMAT)
            .create_view(&layers());
        let view = |view| wgpu::BindingResource::TextureView(view);
        let lamps = || scene.lamps.as_entire_binding();
        let of_rays = rays.resources().into_iter().zip(0..);
        let of_shares: Vec<wgpu::BindGroupEntry<'_>> =
            [lamps(), view(views.place), view(views.normal), view(&own_shares)]
                .into_iter()
                .zip(4..)
                // Binding 3, the vertices, tells what was hit: of no use here.
                .chain(of_rays.take(3))
                .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource })
                .collect();
        let of_light = [
            lamps(),
            view(views.place),
            view(views.normal),
            view(&own_shares),
            view(&light.lamp_shares),
            view(&light.lamps),
        ];
        Self {
            steps: Some([
                Step::with_entries(gpu, "lamp_shares", &of_shares),
                Step::new(gpu, "lamp_light", &of_light),
            ]),
            size_px,
        }
    }

    /// Casts the rays and sums up.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        for step in self.steps.iter().flatten() {
            step.record(encoder, timer, [groups(self.size_px[0]), groups(self.size_px[1]), 1]);
        }
    }
}

/// All layers of a texture.
pub(super) fn layers() -> wgpu::TextureViewDescriptor<'static> {
    wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..wgpu::TextureViewDescriptor::default()
    }
}
