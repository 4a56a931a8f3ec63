//! An area light as many hard shadows from places all over it (Brotman, Badler 1984, "Generating soft shadows with a depth
//! buffer algorithm"): the reference of one light.

use bytemuck::{Pod, Zeroable};

use super::atlas::MapAtlas;
use super::key::{Job, KeyShadow};
use super::light::ShadowLight;
use super::map_view::{MapView, boxes, from_rectangle};
use super::pcf::{PcfShadow, Taps};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// Places on the light in the reference.
pub const N_REFERENCE: u32 = 1024;
/// Maps of a batch fill a square of this many texels a side at most: 64 MiB.
const BATCH_PX: u32 = 4096;

/// One batch of maps as the shader takes it.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct GpuBatch {
    /// First view, number of views, 1 for the first batch, 1 for the last.
    range: [u32; 4],
}

/// The passes.
#[derive(Debug)]
pub struct AreaShadow {
    n_places: u32,
    map_size: u32,
    atlas: MapAtlas,
    pipeline: wgpu::ComputePipeline,
    /// Light that arrives and light that would, per pixel, and for how many pixels there is room.
    sums: (wgpu::Buffer, u32),
    /// For lights without extent, of which one hard shadow tells all; made with the first of them.
    sharp: Option<PcfShadow>,
}

impl AreaShadow {
    /// Passes with `n_places` maps (1 at least) of `map_size` texels a side.
    #[must_use]
    pub fn new(gpu: &Gpu, map_size: u32, n_places: u32) -> Self {
        Self {
            n_places: n_places.max(1),
            map_size,
            atlas: MapAtlas::new(gpu, "area", map_size),
            pipeline: gpu.compute_pipeline("shadow_area"),
            sums: (sums_for(gpu, 1), 1),
            sharp: None,
        }
    }

    /// Room for the maps of a batch, and for the sums of a picture; views from all places.
    fn prepare(&mut self, gpu: &Gpu, job: &Job<'_>, [center_m, half_u_m, half_v_m]: [glam::Vec3; 3]) {
        let size_px = self.atlas.size_for(gpu, 1);
        let fitting = (BATCH_PX / size_px).clamp(1, 8);
        let columns = fitting.min((f64::from(self.n_places)).sqrt().ceil() as u32);
        let boxes = boxes(job.casters);
        let views: Vec<MapView> = (0..self.n_places)
            .map(|i| {
                let [u, v] = place_on_light(i, self.n_places);
                let place_m = center_m + u * half_u_m + v * half_v_m;
                from_rectangle(place_m, [half_u_m, half_v_m], &boxes, size_px)
            })
            .collect();
        self.atlas.set_views(gpu, &views, ([columns; 2], size_px));
        let n_pixels = job.surface.view.size_px[0] * job.surface.view.size_px[1];
        if self.sums.1 < n_pixels {
            self.sums = (sums_for(gpu, n_pixels), n_pixels);
        }
    }
}

impl KeyShadow for AreaShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let ShadowLight::Rect {
            center_m,
            half_u_m,
            half_v_m,
            ..
        } = *job.light
        else {
            let sharp = self
                .sharp
                .get_or_insert_with(|| PcfShadow::new(gpu, self.map_size, Taps::One));
            return sharp.record(gpu, encoder, timer, job);
        };
        self.prepare(gpu, job, [center_m, half_u_m, half_v_m]);
        let per_batch = self.atlas.n_slots();
        let n_batches = self.n_places.div_ceil(per_batch);
        let span = timer.span("shadow_area");
        let [width, height] = job.surface.view.size_px;
        for index in 0..n_batches {
            let first = index * per_batch;
            let batch = GpuBatch {
                range: [
                    first,
                    per_batch.min(self.n_places - first),
                    u32::from(index == 0),
                    u32::from(index + 1 == n_batches),
                ],
            };
            let ends = Ends::of(2 * index as usize, 2 * n_batches as usize);
            self.atlas.record(gpu, encoder, span.render(ends), (job, first));
            let batch = gpu.buffer("shadow_area: batch", &[batch]);
            let [shape, views] = self.atlas.bindings();
            let bindings = gpu.bind(
                "shadow_area",
                &self.pipeline.get_bind_group_layout(0),
                &[
                    shape,
                    batch.as_entire_binding(),
                    views,
                    wgpu::BindingResource::TextureView(self.atlas.depth()),
                    wgpu::BindingResource::TextureView(&job.surface.place),
                    wgpu::BindingResource::TextureView(&job.surface.normal),
                    self.sums.0.as_entire_binding(),
                    wgpu::BindingResource::TextureView(job.visibility),
                ],
            );
            let ends = Ends::of(2 * index as usize + 1, 2 * n_batches as usize);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("shadow_area"),
                timestamp_writes: span.compute(ends),
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        }
        Ok(())
    }
}

/// Place `i` of `n` on a rectangle, -1 ..= 1 along both sides: Hammersley's points, which fall into n different strips along
/// both sides, so that no edge parallel to a side shows steps.
#[must_use]
pub fn place_on_light(i: u32, n: u32) -> [f32; 2] {
    let along = (f64::from(i) + 0.5) / f64::from(n);
    // Half a strip further, so that the mean is the middle.
    let across = f64::from(i.reverse_bits()) / 4_294_967_296.0 + 0.5 / f64::from(n);
    [along, across.min(1.0)].map(|x| (2.0 * x - 1.0) as f32)
}

fn sums_for(gpu: &Gpu, n_pixels: u32) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("shadow_area: sums"),
        size: 8 * u64::from(n_pixels.max(1)),
        usage: wgpu::BufferUsages::STORAGE,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_fill_the_light_evenly() {
        for n in [1u32, 16, 1024] {
            let places: Vec<[f32; 2]> = (0..n).map(|i| place_on_light(i, n)).collect();
            for axis in 0..2 {
                let mut along: Vec<f32> = places.iter().map(|place| place[axis]).collect();
                along.sort_by(f32::total_cmp);
                for (i, x) in along.iter().enumerate() {
                    let expected = (2.0 * i as f32 + 1.0) / n as f32 - 1.0;
                    assert!((x - expected).abs() < 1e-4, "{n} {axis} {i}: {x} {expected}");
                }
            }
        }
    }
}
