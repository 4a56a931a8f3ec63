//! The light of a dome on a surface, past the shadows that its bits tell.

use bytemuck::Zeroable;
use glam::Vec3;

use super::maps::{DomeMaps, GpuDomeFrame, NONE_BRIGHT};
use super::sight::{DomeSight, RayMode};
use super::step::Step;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::shadow::surface::SurfaceViews;

/// Where light comes from that nothing shades.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unshaded {
    /// Every direction alike.
    Everywhere,
    /// The hemisphere around +z.
    Above,
}

/// Irradiance of one surface.
#[derive(Debug)]
pub struct DomeGather {
    size_px: [u32; 2],
    frame: wgpu::Buffer,
    sum: Step,
    filters: Vec<Step>,
}

impl DomeGather {
    /// The light past one set of casters into `target`.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        surface: SurfaceViews<'_>,
        (maps, sight): (&DomeMaps, &DomeSight),
        (target, mode): (&wgpu::TextureView, RayMode),
    ) -> Self {
        Self::with_bits(gpu, (surface, maps), "dome_light", (&[sight], &[target], mode))
    }

    /// The light past the first set of casters, and past both, into two targets.
    #[must_use]
    pub fn pair(
        gpu: &Gpu,
        surface: SurfaceViews<'_>,
        (maps, sights): (&DomeMaps, [&DomeSight; 2]),
        (targets, mode): ([&wgpu::TextureView; 2], RayMode),
    ) -> Self {
        Self::with_bits(gpu, (surface, maps), "dome_light_pair", (&sights, &targets, mode))
    }

    /// The bright lights alone: past the first set of casters, and what the second takes of that, into two targets.
    #[must_use]
    pub fn bright(
        gpu: &Gpu,
        surface: SurfaceViews<'_>,
        (maps, sights): (&DomeMaps, [&DomeSight; 2]),
        (targets, mode): ([&wgpu::TextureView; 2], RayMode),
    ) -> Self {
        Self::with_bits(gpu, (surface, maps), "dome_light_bright", (&sights, &targets, mode))
    }

    fn with_bits(
        gpu: &Gpu,
        (surface, maps): (SurfaceViews<'_>, &DomeMaps),
        name: &'static str,
        (sights, targets, mode): (&[&DomeSight], &[&wgpu::TextureView], RayMode),
    ) -> Self {
        let frame = gpu.buffer("dome: gather's frame", &[GpuDomeFrame::zeroed()]);
        // Rays of soft shadows are put together by a filter, from textures of their own.
        let raw: Vec<wgpu::TextureView> = match mode {
            RayMode::Hard => Vec::new(),
            RayMode::Soft => targets
                .iter()
                .map(|_| {
                    let texture = gpu.target("dome: rays", TextureShape::plain(surface.size_px), RADIANCE_FORMAT);
                    texture.create_view(&wgpu::TextureViewDescriptor::default())
                })
                .collect(),
        };
        let summed: Vec<&wgpu::TextureView> = match mode {
            RayMode::Hard => targets.to_vec(),
            RayMode::Soft => raw.iter().collect(),
        };
        let place = || wgpu::BindingResource::TextureView(surface.place);
        let normal = || wgpu::BindingResource::TextureView(surface.normal);
        let mut resources = vec![
            frame.as_entire_binding(),
            maps.lights.as_entire_binding(),
            place(),
            normal(),
        ];
        resources.extend(sights.iter().map(|sight| sight.bits.as_entire_binding()));
        resources.extend(summed.iter().map(|view| wgpu::BindingResource::TextureView(view)));
        let filters = raw.iter().zip(targets).map(|(from, to)| {
            let resources = [
                place(),
                normal(),
                wgpu::BindingResource::TextureView(from),
                wgpu::BindingResource::TextureView(to),
            ];
            Step::new(gpu, "dome_filter", &resources)
        });
        Self {
            size_px: surface.size_px,
            sum: Step::new(gpu, name, &resources),
            filters: filters.collect(),
            frame,
        }
    }

    /// Sums the light up; `unshaded` is irradiance that nothing shades, on a surface that faces it.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (maps, unshaded, from): (&DomeMaps, Vec3, Unshaded),
    ) {
        let [width, height] = self.size_px;
        gpu.write(
            &self.frame,
            &[GpuDomeFrame {
                counts: [maps.n_shown(), maps.map_size(), 0, 0],
                sizes: [0, width, height, 0],
                unshaded: unshaded.extend(f32::from(from == Unshaded::Above)),
                bright: if self.filters.is_empty() {
                    NONE_BRIGHT
                } else {
                    maps.bright()
                },
            }],
        );
        let tiles = [width.div_ceil(8), height.div_ceil(8), 1];
        self.sum.record(encoder, timer, tiles);
        for filter in &self.filters {
            filter.record(encoder, timer, tiles);
        }
    }
}
