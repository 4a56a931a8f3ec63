//! Which lights of a dome a surface's pixels see: one bit per pixel and light.

use std::ops::Range;

use bytemuck::Zeroable;
use glam::Vec4;

use super::maps::{DomeMaps, GpuDomeFrame};
use super::step::Step;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::shadow::surface::SurfaceViews;

/// Bits of a word of visibility.
const WORD_BITS: u32 = 32;

/// How a pixel's ray finds out whether a light arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayMode {
    /// One comparison with the light's depth map: a hard shadow.
    Hard,
    /// A ray to a random place on the light, in steps of growing height over the surface: a depth of the map is what
    /// stands in the way if its height is that of the step. A penumbra as wide as the light is seen, sharp at contacts.
    Soft,
}

/// Bits of one surface past one set of casters.
#[derive(Debug)]
pub struct DomeSight {
    mode: RayMode,
    size_px: [u32; 2],
    frame: wgpu::Buffer,
    look: Step,
    refine: Step,
    /// Word after word, each for all pixels, rows from the top.
    pub(super) bits: wgpu::Buffer,
}

impl DomeSight {
    /// Room for the bits of a surface.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more lights and pixels than the adapter takes.
    pub fn new(gpu: &Gpu, surface: SurfaceViews<'_>, maps: &DomeMaps, mode: RayMode) -> Result<Self, RenderError> {
        let [width, height] = surface.size_px.map(u64::from);
        let bytes = 4 * width * height * u64::from(maps.n_lights().max(1).div_ceil(WORD_BITS));
        gpu.within(
            "the dome's visibility in bytes",
            bytes,
            gpu.device.limits().max_storage_buffer_binding_size,
        )?;
        let frame = gpu.buffer("dome: sight's frame", &[GpuDomeFrame::zeroed()]);
        let bits = gpu.storage("dome: visibility", bytes);
        let resources = [
            frame.as_entire_binding(),
            maps.lights.as_entire_binding(),
            wgpu::BindingResource::TextureView(surface.place),
            wgpu::BindingResource::TextureView(surface.normal),
            maps.maps.as_entire_binding(),
            bits.as_entire_binding(),
        ];
        Ok(Self {
            mode,
            size_px: surface.size_px,
            look: Step::new(gpu, "dome_visibility", &resources),
            refine: Step::new(gpu, "dome_refine", &resources),
            frame,
            bits,
        })
    }

    /// Looks towards the lights in `range`; the bits of others stay.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (maps, range): (&DomeMaps, Range<usize>),
    ) {
        if range.is_empty() {
            return;
        }
        let [width, height] = self.size_px;
        gpu.write(
            &self.frame,
            &[GpuDomeFrame {
                counts: [maps.n_shown(), maps.map_size(), range.start as u32, range.end as u32],
                sizes: [0, width, height, u32::from(self.mode == RayMode::Soft)],
                unshaded: Vec4::ZERO,
                bright: maps.bright(),
            }],
        );
        self.look
            .record(encoder, timer, [width.div_ceil(16), height.div_ceil(16), 1]);
        self.refine
            .record(encoder, timer, [width.div_ceil(8), height.div_ceil(8), 1]);
    }
}
