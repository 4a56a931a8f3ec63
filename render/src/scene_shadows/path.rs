//! Rays to the whole map, infinitely far away: the off-line reference of the dome methods.

use glam::Vec3;

use super::{EyeSurfaces, ShadowFrame, Things};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::shadow::casters::Casters;
use crate::shadow::dome::Step;
use crate::shadow::path::environment::{Environment, EnvironmentBuffers};
use crate::shadow::path::irradiance::{IrradianceJob, IrradianceMaps, IrradiancePass, OccluderSets};

/// Rays per pixel, drawn half by the map's power and half by the cosine.
const RAYS: u32 = 512;

/// Irradiance by rays, on both surfaces.
#[derive(Debug)]
pub(super) struct PathShadows {
    pass: IrradiancePass,
    occluders: OccluderSets,
    sides: [Side; 2],
    size_px: [u32; 2],
}

#[derive(Debug)]
struct Side {
    places: wgpu::TextureView,
    normals: wgpu::TextureView,
    maps: IrradianceMaps,
    /// Into the formats of the other methods.
    hand_over: Step,
}

impl PathShadows {
    pub(super) fn new(gpu: &Gpu, things: &Things, surfaces: EyeSurfaces<'_>) -> Result<Self, RenderError> {
        let pass = IrradiancePass::new(gpu);
        let occluders = occluders(gpu, things)?;
        let size_px = surfaces.surfaces[0].views().size_px;
        let side = |index: usize| -> Result<Side, RenderError> {
            let (views, target) = (surfaces.surfaces[index].views(), &surfaces.targets[index]);
            let maps = pass.maps(gpu, size_px)?;
            let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
            let hand_over = Step::new(
                gpu,
                "path_light_pair",
                &[
                    wgpu::BindingResource::TextureView(&whole(&maps.without)),
                    wgpu::BindingResource::TextureView(&whole(&maps.with_all)),
                    wgpu::BindingResource::TextureView(&target.without),
                    wgpu::BindingResource::TextureView(&target.with_virtual),
                ],
            );
            Ok(Side {
                places: views.place.clone(),
                normals: views.normal.clone(),
                maps,
                hand_over,
            })
        };
        Ok(Self {
            sides: [side(0)?, side(1)?],
            pass,
            occluders,
            size_px,
        })
    }

    /// Fills the targets; the surfaces must have been drawn and submitted.
    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (frame, things): (&ShadowFrame<'_>, &Things),
    ) -> Result<(), RenderError> {
        if frame.is_moved {
            self.occluders = occluders(gpu, things)?;
        }
        let environment = EnvironmentBuffers::new(gpu, &Environment::Cube(&frame.light.far))?;
        for side in &self.sides {
            let job = IrradianceJob {
                places: &side.places,
                normals: &side.normals,
                environment: &environment,
                occluders: &self.occluders,
                rays: RAYS,
                seed: 1,
            };
            // It times and submits itself.
            self.pass.render(gpu, &mut Timer::new(gpu), &side.maps, &job)?;
            let [width, height] = self.size_px.map(|edge| edge.div_ceil(8));
            side.hand_over.record(encoder, timer, [width, height, 1]);
        }
        Ok(())
    }
}

/// Real and virtual things where they are now.
fn occluders(gpu: &Gpu, things: &Things) -> Result<OccluderSets, RenderError> {
    let corners = |casters: &Casters| -> Vec<[Vec3; 3]> { casters.triangles().collect() };
    OccluderSets::new(gpu, &corners(&things.phantoms), &corners(&things.virtuals))
}
