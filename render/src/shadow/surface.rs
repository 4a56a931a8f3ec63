//! What a view sees, per pixel: place, normal and colour of the first surface, and its depth.

use super::view::{GpuView, View};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape, VERTEX_LAYOUT};
use crate::gpu::shader;
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::{IndexRange, SceneBuffers};

/// Format of places: world, metres.
pub const PLACE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
/// Format of the depth and of the stencil that volumes count in.
pub const DEPTH_STENCIL_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth24PlusStencil8;

/// The pass.
#[derive(Debug)]
pub struct SurfacePass {
    pipeline: wgpu::RenderPipeline,
}

/// A view and what it sees.
#[derive(Debug)]
pub struct Surface {
    /// The view.
    pub view: View,
    /// The same for the shaders, uniform ([`GpuView`]).
    pub view_buffer: wgpu::Buffer,
    /// xyz: place of the surface, world, metres; w: 1 where there is one, else 0. Not filterable.
    pub place: wgpu::TextureView,
    /// xyz: unit normal towards the eye's side, world; w: index of the object.
    pub normal: wgpu::TextureView,
    /// Linear base colour; a: 1.
    pub color: wgpu::TextureView,
    /// Depth and stencil, for attachments. [`SurfacePass::record`] clears the stencil to 0.
    pub depth_stencil: wgpu::TextureView,
    /// The texture behind `place`, to be read back.
    pub place_texture: wgpu::Texture,
    bindings: wgpu::BindGroup,
}

impl SurfacePass {
    /// The pass.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let module = shader::module(&gpu.device, "surface");
        let targets = [PLACE_FORMAT, RADIANCE_FORMAT, RADIANCE_FORMAT].map(|f| Some(wgpu::ColorTargetState::from(f)));
        let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("surface"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[Some(VERTEX_LAYOUT)],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_STENCIL_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { pipeline }
    }

    /// Targets for pictures of the view's size.
    #[must_use]
    pub fn surface(&self, gpu: &Gpu, view: &View, scene: &SceneBuffers) -> Surface {
        let shape = TextureShape::plain(view.size_px);
        let place_texture = gpu.target("surface: place", shape, PLACE_FORMAT);
        let [normal, color] =
            ["surface: normal", "surface: colour"].map(|label| gpu.target(label, shape, RADIANCE_FORMAT));
        let depth_stencil = gpu.target("surface: depth", shape, DEPTH_STENCIL_FORMAT);
        let view_buffer = gpu.buffer("surface: view", &[view.to_gpu()]);
        let bindings = gpu.bind(
            "surface",
            &self.pipeline.get_bind_group_layout(0),
            &[
                view_buffer.as_entire_binding(),
                scene.objects.as_entire_binding(),
                scene.materials.buffer().as_entire_binding(),
            ],
        );
        let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        Surface {
            view: *view,
            view_buffer,
            place: whole(&place_texture),
            normal: whole(&normal),
            color: whole(&color),
            depth_stencil: whole(&depth_stencil),
            place_texture,
            bindings,
        }
    }

    /// Draws `receivers` and clears the stencil.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (surface, scene, receivers): (&Surface, &SceneBuffers, &IndexRange),
    ) {
        let span = timer.span("surface");
        let clear = |view| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("surface"),
            color_attachments: &[clear(&surface.place), clear(&surface.normal), clear(&surface.color)],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &surface.depth_stencil,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0),
                    store: wgpu::StoreOp::Store,
                }),
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &surface.bindings, &[]);
        receivers.draw(&mut pass, &scene.vertices);
    }
}

/// Places and normals of a surface, per pixel.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceViews<'a> {
    /// xyz: place, world, metres; w: 1 where there is one, else 0.
    pub place: &'a wgpu::TextureView,
    /// xyz: unit normal, world; w: index of the object.
    pub normal: &'a wgpu::TextureView,
    /// Columns and rows.
    pub size_px: [u32; 2],
}

impl Surface {
    /// Its places and normals.
    #[must_use]
    pub fn views(&self) -> SurfaceViews<'_> {
        SurfaceViews {
            place: &self.place,
            normal: &self.normal,
            size_px: self.view.size_px,
        }
    }

    /// Moves the camera; the picture keeps its size.
    pub fn set_view(&mut self, gpu: &Gpu, view: &View) {
        self.view = View {
            size_px: self.view.size_px,
            ..*view
        };
        gpu.write::<GpuView>(&self.view_buffer, &[self.view.to_gpu()]);
    }
}
