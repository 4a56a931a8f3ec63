//! A texture, small, in a corner of the finished picture.

use bytemuck::{Pod, Zeroable};

use super::groups;
use crate::codes::Codes;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// How the numbers of a texture become colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// Radiance, as bright as in the picture.
    Radiance,
    /// Irradiance, as the radiance of a white surface.
    Irradiance,
    /// A change of irradiance: grey is none, darker is less.
    Change,
    /// A ratio: grey is 1, white is 2.
    Ratio,
    /// Alpha, from black to white.
    Coverage,
    /// Place in the world: each axis goes through its colour once in 0.1 m.
    Place,
    /// Unit normal: grey is 0, full is 1.
    Normal,
}

impl How {
    /// Value of the shader's `how`.
    fn number(self) -> u32 {
        match self {
            Self::Radiance => 0,
            Self::Irradiance => 1,
            Self::Change => 2,
            Self::Ratio => 3,
            Self::Coverage => 4,
            Self::Place => 5,
            Self::Normal => 6,
        }
    }
}

/// Where an inset is drawn, and how (`Tile` in `inset.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct GpuTile {
    /// First column and row, columns and rows.
    pub place_px: [u32; 4],
    /// x: columns of the picture; y: number of [`How`]; z, w: unused.
    pub parameters: [u32; 4],
}

/// The pass, bound to one texture and one picture.
#[derive(Debug)]
pub struct Inset {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    size_px: [u32; 2],
}

impl Inset {
    /// The share of the picture's width and height that an inset takes at most is one in so many.
    pub const PER_EDGE: u32 = 4;

    /// A pass that draws `source` (a view of one mip as an array: one layer, or a cube's six side by side) as number
    /// `index` of the places in `codes`, from the top left; `camera` is the uniform of the camera that sees the picture.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        (camera, codes): (&wgpu::Buffer, &Codes),
        (source, how): (&wgpu::TextureView, How),
        index: u32,
    ) -> Self {
        let pipeline = gpu.compute_pipeline("inset");
        let tile = tile(codes.size_px(), (source.texture().size(), how), index);
        let bindings = gpu.bind(
            "inset",
            &pipeline.get_bind_group_layout(0),
            &[
                camera.as_entire_binding(),
                gpu.buffer("inset: tile", &[tile]).as_entire_binding(),
                wgpu::BindingResource::TextureView(source),
                codes.buffer().as_entire_binding(),
            ],
        );
        let [_, _, width, height] = tile.place_px;
        Self {
            pipeline,
            bindings,
            size_px: [width, height],
        }
    }

    /// Draws it over the finished picture.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let span = timer.span("inset");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("inset"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(groups(self.size_px[0]), groups(self.size_px[1]), 1);
    }
}

/// Place `index` of the picture's grid, filled as far as the texture's shape allows; cubes are three faces wide and two high.
fn tile(picture_px: [u32; 2], (extent, how): (wgpu::Extent3d, How), index: u32) -> GpuTile {
    let n = Inset::PER_EDGE;
    let cell = picture_px.map(|edge| edge / n);
    let [wide, high] = if extent.depth_or_array_layers >= 6 {
        [3, 2]
    } else {
        [extent.width, extent.height]
    };
    let width = cell[0].min(cell[1] * wide / high).max(1);
    let height = (width * high / wide).clamp(1, cell[1].max(1));
    GpuTile {
        place_px: [index % n * cell[0], index / n % n * cell[1], width, height],
        parameters: [picture_px[0], how.number(), 0, 0],
    }
}
