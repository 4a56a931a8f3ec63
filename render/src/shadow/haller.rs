//! Haller's shadow volumes for augmented reality, as he ordered them: Haller, Drab, Hartmann 2003, "A real-time shadow
//! approach for an augmented reality application using shadow volumes".
//!
//! His frame has three steps. Real things' shadows on real things are in the camera's picture already. Virtual objects'
//! shadows on real things: the phantoms are drawn into the depth, the volumes of the virtual objects are counted, and the
//! shadow replaces the picture where the count is not 0. Shadows on virtual objects: everything is drawn into the depth, the
//! volumes of real and virtual things are counted anew, and virtual objects are lit where the count is 0. Here a step is one
//! [`Job`]: receivers phantoms and casters virtual for the second, receivers virtual and casters everything for the third;
//! how dark a shadow is, the caller says.
//!
//! What differs from [`super::volume`] is what the hardware and the paper of 2003 had: volumes are walls only, without caps;
//! they are counted from the eye, in two draws, first the polygons that are turned towards the eye, then the others; the
//! count stops at 0 and 255 instead of wrapping.
//!
//! Known failures, kept for comparison. With the eye inside a volume, its inside is lit (the count does not go below 0), and
//! so is what another shadow covers there less often than the eye is covered. Where the near plane cuts a volume's walls the
//! shadow has holes. A receiver seen through a caster that is not among the receivers (second step) has the shadow wrong,
//! for want of a cap; the caster is drawn over it later. A light
//! inside an object shines through it: no edge is between faces turned towards it and away.

use super::key::{Job, KeyShadow};
use super::stencil::{Count, Stencil};
use super::volume_mesh::{VolumeMeshes, WALLS};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;

/// The method.
#[derive(Debug)]
pub struct HallerShadow {
    stencil: Stencil,
    meshes: VolumeMeshes,
}

impl HallerShadow {
    /// The method.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::StencilOperation::{DecrementClamp, IncrementClamp};
        let count = |operation, cull| Count {
            front: Count::passing(operation),
            back: Count::passing(operation),
            cull: Some(cull),
            bias: wgpu::DepthBiasState::default(),
        };
        let order = [
            count(IncrementClamp, wgpu::Face::Back),
            count(DecrementClamp, wgpu::Face::Front),
        ];
        Self {
            stencil: Stencil::new(gpu, &order),
            meshes: VolumeMeshes::default(),
        }
    }
}

impl KeyShadow for HallerShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let light = job.light.homogeneous();
        let draws = self.meshes.draws(gpu, job.casters, light, |_| false)?;
        let order = [(0, WALLS), (1, WALLS)];
        self.stencil.record_count(gpu, encoder, timer, (job, draws, &order));
        self.stencil.record_resolve(encoder, timer, job);
        Ok(())
    }
}
