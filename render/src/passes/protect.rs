//! The protection mask: shadows in the picture of real things that the scene does not know, so that virtual objects do not
//! take the same light away a second time.
//!
//! Where phantoms are exact the ratio of [`super::receive`] counts no shadow twice. A real thing without phantom throws a
//! shadow that the prediction does not have. Three passes find it:
//!
//! 1. `protect_cells`: picture over predicted irradiance is a reflectance, a mean per cell of 4 × 4 pixels. In a shadow that
//!    the prediction does not know it is too dark by the share that the bright lights have there, and has the colour of the
//!    light that is left.
//! 2. `protect_vote`: every cell asks cells all over the picture that lie in the same plane. Those whose reflectance, less the
//!    bright lights' share per channel, is the cell's speak for a shadow; those of the cell's own reflectance against it. So
//!    a pattern is taken for a shadow only if the plane also shows its pattern brighter by just that factor in all channels.
//! 3. `protect_spread`: near believing cells, a pixel's own radiance tells how much of the bright lights it misses, so that
//!    edges and penumbrae are the picture's. So it does at the edges of known shadows, which the prediction has softer than
//!    the picture and, with a mesh that is off, elsewhere.
//!
//! What is missing is taken off the predicted light, and what virtual objects take of it is given back.
//!
//! Blind to: lights that give less than two fifths of a surface's light, shadows that leave nothing of their plane lit,
//! planes that show less than a few cells. Black print in light so hard that its shadow is as black is taken for one.
//! Related: shadow detection by illumination-invariant colour (Finlayson et al. 2006) and the shadow protection mask of
//! Jacobs, Nahmias, Angus, Reche, Loscos and Steed (2005).

use bytemuck::{Pod, Zeroable};
use glam::Vec4;

use super::direct::{self, Inputs};
use super::groups;
use crate::camera_view::CameraView;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::{Ends, Timer};

/// Pixels along the edge of a cell (`CELL_PX` in `shared/protect.wgsl`).
pub const CELL_PX: u32 = 4;
/// Bytes of what is said of a cell (`Verdict` in `shared/protect.wgsl`).
const VERDICT_BYTES: u64 = size_of::<Vec4>() as u64;
/// Cells of a row that are asked, about.
const ASKED: u32 = 24;
/// Cells that a workgroup of `protect_vote` judges.
const VOTERS: u32 = 64;

/// A square of pixels on one surface (`Cell` in `shared/protect.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuCell {
    /// xyz: natural logarithm of the reflectance that picture and predicted light give; w: 1 where it means something.
    pub log_reflectance: Vec4,
    /// xyz: share of the bright lights in the predicted light; w: unused.
    pub share: Vec4,
    /// xyz: place, world, metres; w: 1 where there is one.
    pub place_m: Vec4,
    /// xyz: unit normal, world; w: unused.
    pub normal: Vec4,
}

/// Bright lights on the phantoms, per pixel; irradiance, linear RGB. Black until passes fill it.
#[derive(Debug)]
pub struct BrightLight {
    /// What arrives past the known real things.
    pub arriving: wgpu::TextureView,
    /// What virtual objects take of it.
    pub lost: wgpu::TextureView,
    /// What arrives by the prediction and is missing in the picture.
    pub absent: wgpu::TextureView,
    /// What virtual objects would take of that.
    pub returned: wgpu::TextureView,
}

impl BrightLight {
    /// Room for pictures of `size_px`.
    #[must_use]
    pub fn new(gpu: &Gpu, size_px: [u32; 2]) -> Self {
        let target = |label| {
            let texture = gpu.target(label, TextureShape::plain(size_px), RADIANCE_FORMAT);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            arriving: target("bright light past real things"),
            lost: target("bright light that virtual objects take"),
            absent: target("bright light missing in the picture"),
            returned: target("bright light given back"),
        }
    }

    /// Makes it black again, for shadow methods that tell nothing of single lights.
    pub fn clear(&self, gpu: &Gpu) {
        for view in [&self.arriving, &self.lost, &self.absent, &self.returned] {
            let texture = view.texture();
            let size = texture.size();
            gpu.queue.write_texture(
                texture.as_image_copy(),
                &vec![0; 8 * (size.width * size.height) as usize],
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(8 * size.width),
                    rows_per_image: Some(size.height),
                },
                size,
            );
        }
    }
}

/// The passes with what goes from one to the next.
#[derive(Debug)]
pub struct Protect {
    cells: (wgpu::ComputePipeline, wgpu::BindGroup),
    vote: (wgpu::ComputePipeline, wgpu::BindGroup),
    spread: (wgpu::ComputePipeline, wgpu::BindGroup),
    grid: [u32; 2],
    size_px: [u32; 2],
}

impl Protect {
    /// Passes for the phantoms in the pictures of `view`; `frame` is what a frame's pixels share
    /// ([`crate::gpu::types::GpuFrame`], uniform).
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        inputs: Inputs<'_>,
        (view, frame): (&CameraView, &wgpu::Buffer),
        bright: &BrightLight,
    ) -> Self {
        let size_px = view.size_px();
        let grid = size_px.map(|edge| edge.div_ceil(CELL_PX));
        let n_cells = u64::from(grid[0]) * u64::from(grid[1]);
        let cells = gpu.storage("protect: cells", size_of::<GpuCell>() as u64 * n_cells);
        let verdicts = gpu.storage("protect: verdicts", VERDICT_BYTES * n_cells);
        let texture = |view| wgpu::BindingResource::TextureView(view);
        let of_pixel = [
            frame.as_entire_binding(),
            texture(&inputs.light.place),
            texture(&inputs.light.normal),
            texture(&bright.arriving),
            texture(&view.picture.view),
            view.picture.response.as_entire_binding(),
            cells.as_entire_binding(),
        ];
        let of_spread = vec![
            verdicts.as_entire_binding(),
            texture(&bright.lost),
            texture(&bright.absent),
            texture(&bright.returned),
        ];
        // Of the light's bindings: the camera, the environments, their harmonics, light past real things.
        let of_light: Vec<(u32, wgpu::BindingResource<'_>)> = (0..)
            .zip(direct::resources(inputs))
            .filter(|(binding, _)| [0, 2, 3, 4].contains(binding))
            .collect();
        let step = |name, resources: Vec<(u32, wgpu::BindingResource<'_>)>| {
            let pipeline = gpu.compute_pipeline(name);
            let entries: Vec<wgpu::BindGroupEntry<'_>> = resources
                .into_iter()
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
                .collect();
            let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(name),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            (pipeline, bindings)
        };
        let light_and = |more: Vec<_>| -> Vec<(u32, _)> {
            let own = (8..).zip(of_pixel.iter().cloned().chain(more));
            of_light.iter().cloned().chain(own).collect()
        };
        let stride = grid[0].div_ceil(ASKED).max(1);
        let grid_buffer = gpu.buffer("protect: grid", &[[grid[0], grid[1], stride, 0]]);
        let of_vote = [&grid_buffer, &cells, &verdicts].map(wgpu::Buffer::as_entire_binding);
        Self {
            cells: step("protect_cells", light_and(Vec::new())),
            vote: step("protect_vote", (0..).zip(of_vote).collect()),
            spread: step("protect_spread", light_and(of_spread)),
            grid,
            size_px,
        }
    }

    /// Finds what is missing, from the light on the phantoms.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("protect");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("protect"),
            timestamp_writes: span.compute(Ends::Both),
        });
        let [columns, rows] = self.grid;
        let [width, height] = self.size_px;
        let steps = [
            (&self.cells, [groups(columns), groups(rows)]),
            (&self.vote, [(columns * rows).div_ceil(VOTERS), 1]),
            (&self.spread, [groups(width), groups(height)]),
        ];
        for ((pipeline, bindings), [x, y]) in steps {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(x, y, 1);
        }
    }
}
