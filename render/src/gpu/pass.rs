//! Builders that state a pass in ten lines: buffers, textures, pipelines, bindings.

use bytemuck::Pod;
use wgpu::util::DeviceExt;

use super::{Gpu, shader};
use crate::scene::Vertex;

/// Format of depth and shadow maps.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Format of everything that holds radiance.
pub const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// How the vertex buffer is read.
pub const VERTEX_LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Vertex>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![
        0 => Float32x3, 1 => Uint32, 2 => Float32x3, 3 => Uint32, 4 => Float32x2, 5 => Float32x2, 6 => Float32x4, 7 => Float32x4
    ],
};

impl Gpu {
    /// A buffer for any use on the GPU, filled with `items` (at least one).
    #[must_use]
    pub fn buffer<T: Pod>(&self, label: &str, items: &[T]) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents: bytemuck::cast_slice(items),
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::UNIFORM
                | wgpu::BufferUsages::VERTEX
                | wgpu::BufferUsages::INDEX
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::COPY_SRC,
        })
    }

    /// A buffer that passes write and read, filled with zeros.
    #[must_use]
    pub fn storage(&self, label: &str, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        })
    }

    /// Writes `items` to the start of `buffer`.
    pub fn write<T: Pod>(&self, buffer: &wgpu::Buffer, items: &[T]) {
        self.queue.write_buffer(buffer, 0, bytemuck::cast_slice(items));
    }

    /// A 2-D texture (array) that passes render or write to and read from.
    #[must_use]
    pub fn texture(&self, label: &str, shape: TextureShape, format: wgpu::TextureFormat) -> wgpu::Texture {
        let mut usage = wgpu::TextureUsages::TEXTURE_BINDING;
        if shape.samples == 1 {
            usage |= wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC;
        }
        if format == RADIANCE_FORMAT && shape.samples == 1 {
            usage |= wgpu::TextureUsages::STORAGE_BINDING;
        }
        if matches!(format, DEPTH_FORMAT | RADIANCE_FORMAT) {
            usage |= wgpu::TextureUsages::RENDER_ATTACHMENT;
        }
        self.texture_for(label, shape, format, usage)
    }

    /// A 2-D texture that is drawn to and read from, of any colour or depth format.
    #[must_use]
    pub fn target(&self, label: &str, shape: TextureShape, format: wgpu::TextureFormat) -> wgpu::Texture {
        let mut usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        if !format.is_depth_stencil_format() {
            usage |=
                wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST;
        }
        self.texture_for(label, shape, format, usage)
    }

    fn texture_for(
        &self,
        label: &str,
        shape: TextureShape,
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d {
                width: shape.size_px[0],
                height: shape.size_px[1],
                depth_or_array_layers: shape.layers,
            },
            mip_level_count: shape.mips,
            sample_count: shape.samples,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    }

    /// A compute pipeline whose layout is read off the shader.
    #[must_use]
    pub fn compute_pipeline(&self, name: &'static str) -> wgpu::ComputePipeline {
        self.compute_pipeline_variant(name, &[])
    }

    /// The same with values for the shader's pipeline constants.
    #[must_use]
    pub fn compute_pipeline_variant(&self, name: &'static str, constants: &[(&str, f64)]) -> wgpu::ComputePipeline {
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: None,
            module: &shader::module(&self.device, name),
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..wgpu::PipelineCompilationOptions::default()
            },
            cache: None,
        })
    }

    /// A pipeline that draws the scene's triangles into depth and, where given, colour targets.
    #[must_use]
    pub fn render_pipeline(&self, name: &'static str, state: &RasterState<'_>) -> wgpu::RenderPipeline {
        self.render_pipeline_variant(name, state, &[])
    }

    /// The same with values for the shader's pipeline constants.
    #[must_use]
    pub fn render_pipeline_variant(
        &self,
        name: &'static str,
        state: &RasterState<'_>,
        constants: &[(&str, f64)],
    ) -> wgpu::RenderPipeline {
        let module = shader::module(&self.device, name);
        let targets: Vec<_> = state
            .targets
            .iter()
            .map(|&format| Some(wgpu::ColorTargetState::from(format)))
            .collect();
        self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(name),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[Some(VERTEX_LAYOUT)],
            },
            primitive: wgpu::PrimitiveState {
                cull_mode: state.cull,
                ..wgpu::PrimitiveState::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::LessEqual),
                stencil: wgpu::StencilState::default(),
                bias: state.bias,
            }),
            multisample: wgpu::MultisampleState {
                count: state.samples,
                ..wgpu::MultisampleState::default()
            },
            fragment: (!targets.is_empty()).then(|| wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    ..wgpu::PipelineCompilationOptions::default()
                },
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }

    /// Resources bound to group 0 of a pipeline, in the order of their bindings from 0.
    #[must_use]
    pub fn bind(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: &[wgpu::BindingResource<'_>],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = resources
            .iter()
            .enumerate()
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: resource.clone(),
            })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries: &entries,
        })
    }

    /// A sampler that filters linearly within a mip and repeats at the edges.
    #[must_use]
    pub fn repeating_sampler(&self) -> wgpu::Sampler {
        self.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("repeating"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        })
    }

    /// A sampler that filters linearly between texels and mips and clamps at the edges.
    #[must_use]
    pub fn linear_sampler(&self) -> wgpu::Sampler {
        self.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("linear"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        })
    }
}

/// Extent of a texture.
#[derive(Debug, Clone, Copy)]
pub struct TextureShape {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// Array layers.
    pub layers: u32,
    /// Mip levels.
    pub mips: u32,
    /// Samples per pixel.
    pub samples: u32,
}

impl TextureShape {
    /// One layer, one mip, one sample.
    #[must_use]
    pub fn plain(size_px: [u32; 2]) -> Self {
        Self {
            size_px,
            layers: 1,
            mips: 1,
            samples: 1,
        }
    }

    /// An array of layers.
    #[must_use]
    pub fn layered(size_px: [u32; 2], layers: u32) -> Self {
        Self {
            layers,
            ..Self::plain(size_px)
        }
    }
}

/// What differs between pipelines that draw triangles.
#[derive(Debug, Clone, Copy)]
pub struct RasterState<'a> {
    /// Colour targets, in order.
    pub targets: &'a [wgpu::TextureFormat],
    /// Samples per pixel.
    pub samples: u32,
    /// Depth bias.
    pub bias: wgpu::DepthBiasState,
    /// Which faces are left out.
    pub cull: Option<wgpu::Face>,
}
