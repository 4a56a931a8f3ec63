//! Dome methods: every light with its shadows.

use glam::Vec3;
use mirrorball_calib::lights::KeyLight;

use super::key::{KeyGroup, strongest};
use super::{Bounds, EyeSurfaces, ShadowFrame, Things};
use crate::config::ShadowConfig;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::scene::Vertex;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::ShadowMethod;
use crate::shadow::casters::Casters;
use crate::shadow::dome::{DomeCasters, DomeGather, DomeLight, DomeMaps, DomeSight, MapsJob, Surroundings, plan};
use crate::shadow::shadow_view::Sphere;

/// A light that is farther away than this counts as that far, metres: nothing near the probe sees the difference.
pub(super) const FARTHEST_LIGHT_M: f32 = 100.0;

/// Maps of the real things and of the virtual ones, the same for all eyes.
#[derive(Debug)]
pub(super) struct SharedMaps {
    maps: [DomeMaps; 2],
    method: ShadowMethod,
    /// Irradiance that nothing shades.
    unshaded: Vec3,
}

/// What one eye sees of them: for either surface the bits past both sets, and the light.
#[derive(Debug)]
pub(super) struct DomeShadows {
    sights: [[DomeSight; 2]; 2],
    gathers: [DomeGather; 2],
    /// The bright lights alone, on the phantoms.
    bright: Option<DomeGather>,
}

impl SharedMaps {
    pub(super) fn new(
        gpu: &Gpu,
        (things, bounds, buffers): (&Things, &Bounds, &SceneBuffers),
        config: &ShadowConfig,
    ) -> Result<Self, RenderError> {
        let n_lights = match config.method {
            ShadowMethod::Stable => config.dome_lights + config.bright_lights,
            method => method.dome_lights(),
        };
        let maps = |casters: &Casters, receivers: Sphere| {
            let texel_m = 2.0 * receivers.radius_m / config.map_size as f32;
            let casters = DomeCasters::new(gpu, casters, texel_m)?;
            DomeMaps::new(gpu, buffers, casters, [n_lights, config.map_size])
        };
        Ok(Self {
            maps: [
                maps(&things.phantoms, bounds.receivers())?,
                maps(&things.virtuals, bounds.virtuals)?,
            ],
            method: config.method,
            unshaded: Vec3::ZERO,
        })
    }

    /// Changes an object's shape.
    pub(super) fn bend(&mut self, gpu: &Gpu, object: usize, moved: &[Vertex]) {
        for maps in &mut self.maps {
            maps.bend(gpu, object, moved);
        }
    }

    /// Draws the maps that have changed.
    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (frame, bounds): (&ShadowFrame<'_>, &Bounds),
    ) {
        let KeyGroup { light, rest } = strongest(&frame.light.lights, frame.probe_m);
        let around = Surroundings {
            radiance: &frame.light.far,
            distance_m: &frame.light.distance_m,
            center_m: frame.probe_m,
            far_m: FARTHEST_LIGHT_M,
            stable: &frame.light.lights,
            hand: (light.as_dome_light(), upward(&rest)),
        };
        let plan = plan(self.method, &around);
        self.unshaded = plan.unshaded;
        for (maps, receivers) in self.maps.iter_mut().zip([bounds.receivers(), bounds.virtuals]) {
            let job = MapsJob {
                lights: &plan.lights,
                receivers,
                everything: bounds.everything,
                is_moved: frame.is_moved,
                refreshes_max: usize::MAX,
            };
            maps.record(gpu, encoder, timer, &job);
        }
    }
}

impl DomeShadows {
    pub(super) fn new(gpu: &Gpu, shared: &SharedMaps, surfaces: EyeSurfaces<'_>) -> Result<Self, RenderError> {
        let mode = shared.method.ray_mode();
        let [real, virtuals] = &shared.maps;
        let sights = |surface: usize| -> Result<[DomeSight; 2], RenderError> {
            let views = surfaces.surfaces[surface].views();
            Ok([
                DomeSight::new(gpu, views, real, mode)?,
                DomeSight::new(gpu, views, virtuals, mode)?,
            ])
        };
        let sights = [sights(0)?, sights(1)?];
        let gathers = [0, 1].map(|surface| {
            let [past_real, past_virtual] = &sights[surface];
            let target = &surfaces.targets[surface];
            DomeGather::pair(
                gpu,
                surfaces.surfaces[surface].views(),
                (real, [past_real, past_virtual]),
                ([&target.without, &target.with_virtual], mode),
            )
        });
        let bright = surfaces.bright.map(|bright| {
            let [past_real, past_virtual] = &sights[0];
            DomeGather::bright(
                gpu,
                surfaces.surfaces[0].views(),
                (real, [past_real, past_virtual]),
                ([&bright.arriving, &bright.lost], mode),
            )
        });
        Ok(Self {
            sights,
            gathers,
            bright,
        })
    }

    /// Sums the light up on what the eye sees.
    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        shared: &SharedMaps,
    ) {
        let job = (&shared.maps[0], shared.unshaded, shared.method.unshaded_from());
        for (sights, gather) in self.sights.iter_mut().zip(&self.gathers) {
            for (sight, maps) in sights.iter_mut().zip(&shared.maps) {
                sight.record(gpu, encoder, timer, (maps, 0..maps.n_shown() as usize));
            }
            gather.record(gpu, encoder, timer, job);
        }
        if let Some(bright) = &self.bright {
            bright.record(gpu, encoder, timer, job);
        }
    }
}

/// Irradiance of lights on a surface that faces up.
fn upward(lights: &[KeyLight]) -> Vec3 {
    lights.iter().map(|l| l.irradiance * l.direction.z.max(0.0)).sum()
}

/// A measured light as one of a dome.
pub(crate) fn dome_light(light: &KeyLight, probe_m: Vec3) -> DomeLight {
    let distance_m = light.distance_m.min(FARTHEST_LIGHT_M);
    DomeLight {
        position_m: probe_m + light.direction * distance_m,
        intensity: light.irradiance * distance_m * distance_m,
        angular_radius_rad: light.angular_radius_rad,
    }
}
