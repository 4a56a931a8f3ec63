//! The passes of a dome.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::lights::GpuDomeLight;
use super::{DomeCasters, DomeLight, MAX_DOME_LIGHTS};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::passes::shadow_map::Sphere;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::surface::Surface;

/// Bits of a word of visibility.
const WORD_BITS: u32 = 32;

/// How a pixel's ray finds out whether a light arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayMode {
    /// One comparison with the light's depth map: a hard shadow.
    Hard,
    /// A ray to a random place on the light, in steps of doubling height over the surface: a depth of the map is what
    /// stands in the way if its height is that of the step. A penumbra as wide as the light is seen, sharp at contacts.
    Soft,
}

/// Where light comes from that nothing shades.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unshaded {
    /// Every direction alike.
    Everywhere,
    /// The hemisphere around +z.
    Above,
}

/// What all pixels share (`Frame` in `shared/dome.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct GpuDomeFrame {
    /// x: number of lights; y: edge of a map, texels; z: first light to be refreshed; w: one past the last.
    counts: [u32; 4],
    /// x: number of triangles; y: columns; z: rows; w: 1 for soft shadows.
    sizes: [u32; 4],
    /// xyz: irradiance that nothing shades; w: 1 when it comes from above alone, 0 when from everywhere.
    ambient: Vec4,
}

/// What a dome draws.
#[derive(Debug, Clone, Copy)]
pub struct DomeJob<'a> {
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// The lights, [`MAX_DOME_LIGHTS`] at most.
    pub lights: &'a [DomeLight],
    /// Sphere around all casters and receivers.
    pub bounds: Sphere,
    /// Irradiance that nothing shades, on a surface that faces it.
    pub unshaded: Vec3,
    /// Where it comes from.
    pub unshaded_from: Unshaded,
    /// Whether casters or view have changed since the last picture, so that nothing may be kept.
    pub is_moved: bool,
    /// Maps refreshed at most in this picture; others keep what they show (the seed's rule is 1).
    pub refreshes_max: usize,
}

/// A dome over one surface.
#[derive(Debug)]
pub struct Dome {
    mode: RayMode,
    map_size: u32,
    n_lights: u32,
    size_px: [u32; 2],
    casters: DomeCasters,
    frame: wgpu::Buffer,
    lights: wgpu::Buffer,
    maps: wgpu::Buffer,
    draw: Step,
    look: Step,
    refine: Step,
    gather: Step,
    filter: Step,
    irradiance: wgpu::Texture,
    filtered: wgpu::Texture,
    /// What each map shows; `None` for nothing yet.
    drawn: Vec<Option<GpuDomeLight>>,
    /// The next map to be refreshed where not all may be.
    turn: usize,
}

#[derive(Debug)]
struct Step {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
}

impl Step {
    fn new(gpu: &Gpu, name: &'static str, resources: &[wgpu::BindingResource<'_>]) -> Self {
        let pipeline = gpu.compute_pipeline(name);
        let bindings = gpu.bind(name, &pipeline.get_bind_group_layout(0), resources);
        Self { pipeline, bindings }
    }

    fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, name: &'static str, [x, y, z]: [u32; 3]) {
        let span = timer.span(name);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(name),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(x, y, z);
    }
}

impl Dome {
    /// A dome of up to `n_lights` lights with maps of `map_size` texels over a surface.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more lights, maps or pixels than the adapter takes.
    pub fn new(
        gpu: &Gpu,
        (surface, scene): (&Surface, &SceneBuffers),
        casters: DomeCasters,
        (mode, n_lights, map_size): (RayMode, u32, u32),
    ) -> Result<Self, RenderError> {
        let limit = gpu.device.limits().max_storage_buffer_binding_size;
        gpu.within("a number of dome lights", u64::from(n_lights), MAX_DOME_LIGHTS as u64)?;
        let texels = u64::from(n_lights.max(1)) * u64::from(map_size) * u64::from(map_size);
        gpu.within("the dome's maps in bytes", 4 * texels, limit)?;
        let size_px = surface.view.size_px;
        let pixels = u64::from(size_px[0]) * u64::from(size_px[1]);
        let words = u64::from(n_lights.max(1).div_ceil(WORD_BITS));
        gpu.within("the dome's visibility in bytes", 4 * pixels * words, limit)?;
        let frame = gpu.buffer("dome: frame", &[GpuDomeFrame::zeroed()]);
        let lights = gpu.buffer("dome: lights", &[GpuDomeLight::zeroed(); MAX_DOME_LIGHTS]);
        let maps = storage(gpu, "dome: maps", 4 * texels);
        let bits = storage(gpu, "dome: visibility", 4 * pixels * words);
        let [irradiance, filtered] = ["dome: irradiance", "dome: filtered"]
            .map(|label| gpu.target(label, TextureShape::plain(size_px), RADIANCE_FORMAT));
        let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let place = wgpu::BindingResource::TextureView(&surface.place);
        let normal = wgpu::BindingResource::TextureView(&surface.normal);
        let draw = Step::new(
            gpu,
            "dome_maps",
            &with(
                (&frame, &lights),
                vec![
                    casters.corners.as_entire_binding(),
                    scene.objects.as_entire_binding(),
                    maps.as_entire_binding(),
                ],
            ),
        );
        let rays = with(
            (&frame, &lights),
            vec![
                place.clone(),
                normal.clone(),
                maps.as_entire_binding(),
                bits.as_entire_binding(),
            ],
        );
        let look = Step::new(gpu, "dome_visibility", &rays);
        let refine = Step::new(gpu, "dome_refine", &rays);
        let irradiance_view = whole(&irradiance);
        let gather = Step::new(
            gpu,
            "dome_light",
            &with(
                (&frame, &lights),
                vec![
                    place.clone(),
                    normal.clone(),
                    bits.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&irradiance_view),
                ],
            ),
        );
        let filter = Step::new(
            gpu,
            "dome_filter",
            &[
                place,
                normal,
                wgpu::BindingResource::TextureView(&irradiance_view),
                wgpu::BindingResource::TextureView(&whole(&filtered)),
            ],
        );
        Ok(Self {
            mode,
            map_size,
            n_lights,
            size_px,
            casters,
            frame,
            lights,
            maps,
            draw,
            look,
            refine,
            gather,
            filter,
            irradiance,
            filtered,
            drawn: vec![None; n_lights as usize],
            turn: 0,
        })
    }

    /// Irradiance on the surface, linear RGB, after [`Dome::record`]; alpha 1 where there is a surface.
    #[must_use]
    pub fn irradiance(&self) -> &wgpu::Texture {
        match self.mode {
            RayMode::Hard => &self.irradiance,
            RayMode::Soft => &self.filtered,
        }
    }

    /// Draws what has changed and gathers the light. Returns how many maps were refreshed.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &DomeJob<'_>,
    ) -> usize {
        let lights: Vec<GpuDomeLight> = job
            .lights
            .iter()
            .take(self.n_lights as usize)
            .map(|light| GpuDomeLight::new(light, job.bounds, self.map_size))
            .collect();
        let range = self.stale(&lights, job);
        for index in range.clone() {
            self.drawn[index] = Some(lights[index]);
        }
        // A map that is not refreshed yet goes on showing what its light saw, with the light of now.
        let shown: Vec<GpuDomeLight> = lights
            .iter()
            .zip(&self.drawn)
            .map(|(light, drawn)| {
                drawn.map_or(*light, |drawn| GpuDomeLight {
                    intensity: light.intensity,
                    ..drawn
                })
            })
            .collect();
        if !shown.is_empty() {
            gpu.write(&self.lights, &shown);
        }
        let [width, height] = self.size_px;
        gpu.write(
            &self.frame,
            &[GpuDomeFrame {
                counts: [shown.len() as u32, self.map_size, range.start as u32, range.end as u32],
                sizes: [
                    self.casters.n_triangles,
                    width,
                    height,
                    u32::from(self.mode == RayMode::Soft),
                ],
                ambient: job.unshaded.extend(f32::from(job.unshaded_from == Unshaded::Above)),
            }],
        );
        let tiles = [width.div_ceil(8), height.div_ceil(8), 1];
        if !range.is_empty() {
            let layer = 4 * u64::from(self.map_size) * u64::from(self.map_size);
            let n = range.len() as u64;
            encoder.clear_buffer(&self.maps, layer * range.start as u64, Some(layer * n));
            let groups = self.casters.n_triangles.div_ceil(64);
            let rows = groups.div_ceil(MAX_GROUPS).max(1);
            self.draw
                .record(encoder, timer, "dome_maps", [groups.div_ceil(rows).max(1), rows, 1]);
            let half = [width.div_ceil(16), height.div_ceil(16), 1];
            self.look.record(encoder, timer, "dome_visibility", half);
            self.refine.record(encoder, timer, "dome_refine", tiles);
        }
        self.gather.record(encoder, timer, "dome_light", tiles);
        if self.mode == RayMode::Soft {
            self.filter.record(encoder, timer, "dome_filter", tiles);
        }
        range.len()
    }

    /// The maps to be drawn anew: one run of lights.
    fn stale(&mut self, lights: &[GpuDomeLight], job: &DomeJob<'_>) -> std::ops::Range<usize> {
        let n = lights.len();
        let same_place = |a: &GpuDomeLight, b: &GpuDomeLight| {
            GpuDomeLight {
                intensity: Vec4::ZERO,
                ..*a
            } == GpuDomeLight {
                intensity: Vec4::ZERO,
                ..*b
            }
        };
        let is_stale = |i: usize| {
            job.is_moved
                || self.drawn[i]
                    .as_ref()
                    .is_none_or(|drawn| !same_place(drawn, &lights[i]))
        };
        let Some(first) = (0..n).find(|&i| is_stale(i)) else {
            return 0..0;
        };
        let last = (first..n).rev().find(|&i| is_stale(i)).unwrap_or(first);
        let never_drawn = self.drawn[..n].iter().any(Option::is_none);
        if never_drawn || last + 1 - first <= job.refreshes_max {
            return first..last + 1;
        }
        let from = self.turn % n;
        let to = (from + job.refreshes_max.max(1)).min(n);
        self.turn = to;
        from..to
    }
}

/// Workgroups along one axis that every adapter takes.
const MAX_GROUPS: u32 = 65_535;

/// The bindings of all passes, and more after them.
fn with<'a>(
    (frame, lights): (&'a wgpu::Buffer, &'a wgpu::Buffer),
    more: Vec<wgpu::BindingResource<'a>>,
) -> Vec<wgpu::BindingResource<'a>> {
    let first = [frame.as_entire_binding(), lights.as_entire_binding()];
    first.into_iter().chain(more).collect()
}

fn storage(gpu: &Gpu, label: &str, bytes: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
