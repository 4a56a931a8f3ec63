//! What every one-light method is given and what it gives: a visibility per pixel.

use super::casters::Casters;
use super::light::ShadowLight;
use super::surface::Surface;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::scene_gpu::SceneBuffers;

/// One picture of one light's shadows.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// The view and what it sees, already drawn.
    pub surface: &'a Surface,
    /// All vertices and placements.
    pub scene: &'a SceneBuffers,
    /// What casts shadows.
    pub casters: &'a Casters,
    /// What shadows fall on, for methods that need its geometry besides its pixels.
    pub receivers: &'a Casters,
    /// The light.
    pub light: &'a ShadowLight,
    /// The same for the shaders, uniform ([`super::light::GpuShadowLight`]).
    pub light_buffer: &'a wgpu::Buffer,
    /// Where the share of the light goes that arrives: rgb alike, 0 in shadow ..= 1, of the view's size,
    /// [`crate::gpu::pass::RADIANCE_FORMAT`], for storage, sampling, rendering and blending.
    pub visibility: &'a wgpu::TextureView,
}

/// A method that draws the shadow of one light.
///
/// Only shadow is told: that a surface turns away from the light is the shading's business, so methods may leave such
/// pixels as they come.
pub trait KeyShadow: std::fmt::Debug + Send {
    /// Records the passes that fill `job.visibility`.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where the method cannot serve this light or these casters.
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError>;
}
