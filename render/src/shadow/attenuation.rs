//! Layered attenuation maps: what places all over the light see, as layers of the view from its middle (D17).
//!
//! Agrawala, Ramamoorthi, Heirich, Moll 2000, "Efficient image-based methods for rendering soft shadows", section 3. Every
//! layer of a texel knows how much of the light sees it; a pixel looks up the layer it is on. The maps are kept until light or
//! casters move: a new view costs one look-up a pixel.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat4, UVec4, Vec4};

use super::key::{Job, KeyShadow};
use super::light::ShadowLight;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::shadow_view::{Sphere, basis};

/// Places on a rectangle.
pub const N_PLACES: u32 = 64;
/// Layers of a texel; those of `shared/attenuation.wgsl`.
const N_LAYERS: u64 = 8;
/// Smallest and largest edge of the maps, texels.
const SIZES: [u32; 2] = [32, 1024];

/// The method with its maps.
#[derive(Debug)]
pub struct AttenuationMaps {
    depth_pipeline: wgpu::RenderPipeline,
    warp_pipeline: wgpu::ComputePipeline,
    count_pipeline: wgpu::ComputePipeline,
    pipeline: wgpu::ComputePipeline,
    size: u32,
    frame: wgpu::Buffer,
    places: wgpu::Buffer,
    layers: wgpu::Buffer,
    shares: wgpu::Buffer,
    /// Every place's map.
    maps: Vec<wgpu::TextureView>,
    all_maps: wgpu::TextureView,
    drawn: Option<Drawn>,
}

/// What the maps show.
#[derive(Debug, Clone, PartialEq)]
struct Drawn {
    light: ShadowLight,
    /// Index in the scene, number of indices and placement of every caster.
    casters: Vec<(usize, usize, Affine3A)>,
}

/// The view from the light's middle (`AttenuationFrame` in `shared/attenuation.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuAttenuationFrame {
    /// w: 1 for an orthographic view.
    pub origin_m: Vec4,
    /// w: half the view's width, metres, at distance 1 for a perspective one.
    pub right: Vec4,
    /// Unit axis upward.
    pub up: Vec4,
    /// Unit direction of view.
    pub forward: Vec4,
    /// Edge of the maps, texels; number of places.
    pub counts: UVec4,
}

/// The view from one place on the light (`LightPlace` in the same file).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuLightPlace {
    /// Where it is; w: unused.
    pub position_m: Vec4,
    /// World to clip coordinates of its map.
    pub clip_from_world: Mat4,
    /// Its inverse.
    pub world_from_clip: Mat4,
}

impl AttenuationMaps {
    /// Empty maps: 64 of half the edge `map_size`, so that they take the memory of 16 shadow maps.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] where the adapter has no room for them.
    pub fn new(gpu: &Gpu, map_size: u32) -> Result<Self, RenderError> {
        let size = (map_size / 2).clamp(SIZES[0], SIZES[1]);
        let n_texels = u64::from(size) * u64::from(size);
        let limits = gpu.device.limits();
        gpu.within(
            "a layered attenuation map",
            8 * N_LAYERS * n_texels,
            limits.max_storage_buffer_binding_size,
        )?;
        gpu.within(
            "a number of shadow map layers",
            u64::from(N_PLACES),
            u64::from(limits.max_texture_array_layers),
        )?;
        let state = RasterState {
            targets: &[],
            samples: 1,
            // Points are moved off their surface instead: a biased depth would make layers that lie too deep.
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let storage = |label, size| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let shape = TextureShape::layered([size; 2], N_PLACES);
        let texture = gpu.texture("attenuation: depths", shape, DEPTH_FORMAT);
        let map = |index| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: index,
                array_layer_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            })
        };
        Ok(Self {
            depth_pipeline: gpu.render_pipeline("shadow_attenuation_depth", &state),
            warp_pipeline: gpu.compute_pipeline("shadow_attenuation_warp"),
            count_pipeline: gpu.compute_pipeline("shadow_attenuation_count"),
            pipeline: gpu.compute_pipeline("shadow_attenuation"),
            size,
            frame: gpu.buffer("attenuation: frame", &[GpuAttenuationFrame::zeroed()]),
            places: gpu.buffer("attenuation: places", &[GpuLightPlace::zeroed(); N_PLACES as usize]),
            layers: storage("attenuation: layers", 8 * N_LAYERS * n_texels),
            shares: storage("attenuation: shares", 4 * N_LAYERS * n_texels),
            maps: (0..N_PLACES).map(map).collect(),
            all_maps: texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..wgpu::TextureViewDescriptor::default()
            }),
            drawn: None,
        })
    }

    /// Uploads the views of the light; returns how many places it has.
    fn write(&self, gpu: &Gpu, light: &ShadowLight, bounds: Sphere) -> u32 {
        let n_places = match light {
            ShadowLight::Rect { .. } => N_PLACES,
            _ => 1,
        };
        let places: Vec<GpuLightPlace> = (0..n_places)
            .map(|i| {
                let view = light.view(place(i, n_places), bounds);
                let clip_from_world = view.clip_from_world;
                GpuLightPlace {
                    position_m: view.position_m.extend(0.0),
                    clip_from_world,
                    world_from_clip: clip_from_world.inverse(),
                }
            })
            .collect();
        gpu.write(&self.places, &places);
        let middle = light.view([0.0; 2], bounds);
        let forward = (bounds.center_m - middle.position_m).normalize_or(glam::Vec3::NEG_Z);
        let [right, up] = basis(forward);
        let is_orthographic = matches!(light, ShadowLight::Directional { .. });
        let frame = GpuAttenuationFrame {
            origin_m: middle.position_m.extend(f32::from(u8::from(is_orthographic))),
            right: right.extend(0.5 * middle.width_m),
            up: up.extend(0.0),
            forward: forward.extend(0.0),
            counts: UVec4::new(self.size, n_places, 0, 0),
        };
        gpu.write(&self.frame, &[frame]);
        n_places
    }

    /// Draws the casters as every place on the light sees them.
    fn draw_depths(&self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, (job, n): (&Job<'_>, u32)) {
        let bindings = gpu.bind(
            "shadow_attenuation_depth",
            &self.depth_pipeline.get_bind_group_layout(0),
            &[self.places.as_entire_binding(), job.scene.objects.as_entire_binding()],
        );
        let span = timer.span("attenuation depths");
        for (index, view) in (0..n).zip(&self.maps) {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("attenuation depths"),
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(1.0),
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: span.render(Ends::of(index as usize, n as usize)),
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_pipeline(&self.depth_pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            let casters = &job.casters.range;
            if casters.n_indices > 0 {
                pass.set_vertex_buffer(0, job.scene.vertices.slice(..));
                pass.set_index_buffer(casters.buffer.slice(..), wgpu::IndexFormat::Uint32);
                pass.draw_indexed(0..casters.n_indices, 0, index..index + 1);
            }
        }
    }

    /// Runs one of the compute passes, which share their first bindings.
    fn compute(
        &self,
        (gpu, encoder, timer): (&Gpu, &mut wgpu::CommandEncoder, &mut Timer),
        (name, pipeline): (&'static str, &wgpu::ComputePipeline),
        further: &[wgpu::BindingResource<'_>],
        groups: [u32; 3],
    ) {
        let mut resources = vec![
            self.frame.as_entire_binding(),
            self.places.as_entire_binding(),
            wgpu::BindingResource::TextureView(&self.all_maps),
            self.layers.as_entire_binding(),
        ];
        resources.extend_from_slice(further);
        let bindings = gpu.bind(name, &pipeline.get_bind_group_layout(0), &resources);
        let span = timer.span(name);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(name),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
    }
}

impl KeyShadow for AttenuationMaps {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let shares = self.shares.as_entire_binding();
        let drawn = Drawn {
            light: *job.light,
            casters: (job.casters.objects.iter())
                .map(|caster| (caster.index, caster.mesh.indices.len(), caster.world_from_object))
                .collect(),
        };
        if self.drawn.as_ref() != Some(&drawn) {
            let n_places = self.write(gpu, job.light, job.casters.bounds());
            let n_groups = self.size.div_ceil(8);
            self.draw_depths(gpu, encoder, timer, (job, n_places));
            encoder.clear_buffer(&self.layers, 0, None);
            let warp = ("attenuation warp", &self.warp_pipeline);
            self.compute((gpu, encoder, timer), warp, &[], [n_groups, n_groups, n_places]);
            let count = ("attenuation count", &self.count_pipeline);
            self.compute(
                (gpu, encoder, timer),
                count,
                std::slice::from_ref(&shares),
                [n_groups, n_groups, 1],
            );
        }
        let [width, height] = job.surface.view.size_px;
        let further = [
            shares,
            wgpu::BindingResource::TextureView(&job.surface.place),
            wgpu::BindingResource::TextureView(&job.surface.normal),
            wgpu::BindingResource::TextureView(job.visibility),
        ];
        let look_up = ("attenuation", &self.pipeline);
        self.compute(
            (gpu, encoder, timer),
            look_up,
            &further,
            [width.div_ceil(8), height.div_ceil(8), 1],
        );
        self.drawn = Some(drawn);
        Ok(())
    }
}

/// Place `i` of `n` on the light, -1 ..= 1 along both sides: a Hammersley set.
fn place(i: u32, n: u32) -> [f32; 2] {
    if n == 1 {
        return [0.0; 2];
    }
    let x = (i as f32 + 0.5) / n as f32;
    let y = (i.reverse_bits() as f32 + 0.5 * 4_294_967_296.0 / n as f32) / 4_294_967_296.0;
    [2.0 * x - 1.0, 2.0 * y - 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_spread_evenly_over_the_light() {
        let mut cells = [0; 64];
        for i in 0..N_PLACES {
            let [x, y] = place(i, N_PLACES).map(|p| (4.0 * (p + 1.0)) as usize);
            cells[8 * y + x] += 1;
        }
        assert_eq!(cells, [1; 64]);
        assert_eq!(place(0, 1), [0.0, 0.0]);
    }
}
