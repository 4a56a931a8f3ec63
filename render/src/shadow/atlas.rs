//! Shadow maps side by side in one depth texture, drawn in one pass: the cost of a map is its vertices, not its pass.

use bytemuck::{Pod, Zeroable};

use super::key::Job;
use super::map_view::MapView;
use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RasterState, TextureShape};

/// Largest edge of the whole texture, texels: 256 MiB.
const LARGEST_PX: u32 = 8192;
/// Smallest edge of a map: room for the rims of a cube's faces.
const SMALLEST_PX: u32 = 16;

/// Shape of the texture as the shaders take it (`Atlas` in `shared/map_view.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
struct GpuAtlas {
    /// Edge of a map, texels; maps per row; maps of this light; unused.
    shape: [u32; 4],
}

/// The pass with its texture.
#[derive(Debug)]
pub struct MapAtlas {
    method: &'static str,
    pipeline: wgpu::RenderPipeline,
    wanted_px: u32,
    has_warned: bool,
    size_px: u32,
    columns_rows: [u32; 2],
    n_views: u32,
    depth: wgpu::TextureView,
    shape: wgpu::Buffer,
    views: wgpu::Buffer,
}

impl MapAtlas {
    /// Room for maps of `wanted_px` × `wanted_px` texels. Where the adapter has no room for such large ones, they are as
    /// large as fits, and a warning says so, once, naming the `method`.
    #[must_use]
    pub fn new(gpu: &Gpu, method: &'static str, wanted_px: u32) -> Self {
        let state = RasterState {
            targets: &[],
            samples: 1,
            // The comparison carries the bias.
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let mut atlas = Self {
            method,
            pipeline: gpu.render_pipeline("shadow_depth", &state),
            wanted_px,
            has_warned: false,
            size_px: 1,
            columns_rows: [1; 2],
            n_views: 1,
            depth: depth_view(gpu, [1; 2]),
            shape: gpu.buffer("shadow_depth: shape", &[GpuAtlas::zeroed()]),
            views: gpu.buffer("shadow_depth: views", &[MapView::zeroed()]),
        };
        let _ = atlas.size_for(gpu, 1);
        atlas
    }

    /// Edge of each of `columns` × `columns` maps or fewer, texels.
    pub fn size_for(&mut self, gpu: &Gpu, columns: u32) -> u32 {
        let largest = gpu.device.limits().max_texture_dimension_2d.min(LARGEST_PX) / columns;
        let size_px = self.wanted_px.clamp(SMALLEST_PX, largest.max(SMALLEST_PX));
        if size_px < self.wanted_px && !self.has_warned {
            self.has_warned = true;
            tracing::warn!(
                "shadow method `{}`: maps of `{}` texels wanted, the largest that fit are `{size_px}`; taking those",
                self.method,
                self.wanted_px
            );
        }
        size_px
    }

    /// Takes the views of a light and makes room for `columns_rows` of their maps at a time, `size_px` texels each
    /// ([`MapAtlas::size_for`]).
    pub fn set_views(&mut self, gpu: &Gpu, views: &[MapView], (columns_rows, size_px): ([u32; 2], u32)) {
        if (self.size_px, self.columns_rows) != (size_px, columns_rows) {
            (self.size_px, self.columns_rows) = (size_px, columns_rows);
            self.depth = depth_view(gpu, columns_rows.map(|n| n * size_px));
        }
        self.n_views = views.len() as u32;
        let shape = [size_px, columns_rows[0], self.n_views, 0];
        gpu.write(&self.shape, &[GpuAtlas { shape }]);
        if self.views.size() < size_of_val(views) as u64 {
            self.views = gpu.buffer("shadow_depth: views", views);
        } else {
            gpu.write(&self.views, views);
        }
    }

    /// How many maps there is room for at a time.
    #[must_use]
    pub fn n_slots(&self) -> u32 {
        self.columns_rows[0] * self.columns_rows[1]
    }

    /// Edge of a map, texels.
    #[must_use]
    pub fn size_px(&self) -> u32 {
        self.size_px
    }

    /// The depth texture.
    #[must_use]
    pub fn depth(&self) -> &wgpu::TextureView {
        &self.depth
    }

    /// Shape (`Atlas`), views (`array<MapView>`): what every shader that reads the maps is bound to first.
    #[must_use]
    pub fn bindings(&self) -> [wgpu::BindingResource<'_>; 2] {
        [self.shape.as_entire_binding(), self.views.as_entire_binding()]
    }

    /// Draws the casters into the maps of the views from `first` on, as many as there is room for.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
        (job, first): (&Job<'_>, u32),
    ) {
        let bindings = gpu.bind(
            "shadow_depth",
            &self.pipeline.get_bind_group_layout(0),
            &[self.views.as_entire_binding(), job.scene.objects.as_entire_binding()],
        );
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow_depth"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes,
            ..wgpu::RenderPassDescriptor::default()
        });
        let casters = &job.casters.range;
        if casters.n_indices == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.set_vertex_buffer(0, job.scene.vertices.slice(..));
        pass.set_index_buffer(casters.buffer.slice(..), wgpu::IndexFormat::Uint32);
        let size = self.size_px as f32;
        for view in first..self.n_views.min(first + self.n_slots()) {
            let (slot, columns) = (view - first, self.columns_rows[0]);
            let [x, y] = [slot % columns, slot / columns].map(|n| n as f32 * size);
            pass.set_viewport(x, y, size, size, 0.0, 1.0);
            pass.draw_indexed(0..casters.n_indices, 0, view..view + 1);
        }
    }
}

fn depth_view(gpu: &Gpu, size_px: [u32; 2]) -> wgpu::TextureView {
    gpu.target("shadow_depth", TextureShape::plain(size_px), DEPTH_FORMAT)
        .create_view(&wgpu::TextureViewDescriptor::default())
}
