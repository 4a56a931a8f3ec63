//! A window that shows finished pictures.

use std::sync::Arc;

use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use crate::error::RenderError;
use crate::gpu::pass::TextureShape;
use crate::gpu::{Gpu, shader};

/// What the window system said, as this crate's error.
pub(crate) fn failed(error: &dyn std::error::Error) -> RenderError {
    RenderError::Window {
        message: error.to_string(),
    }
}

/// An open window with its surface.
#[derive(Debug)]
pub struct Screen {
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    pipeline: wgpu::RenderPipeline,
    picture: Option<(wgpu::Texture, wgpu::BindGroup)>,
}

impl Screen {
    /// Opens a window.
    ///
    /// # Errors
    /// [`RenderError::Window`] without a display, or with one that the adapter cannot draw to.
    pub fn open(event_loop: &ActiveEventLoop, gpu: &Gpu) -> Result<Self, RenderError> {
        let attributes = Window::default_attributes().with_title("mirrorball");
        let window = Arc::new(event_loop.create_window(attributes).map_err(|e| failed(&e))?);
        let surface = gpu.instance.create_surface(window.clone()).map_err(|e| failed(&e))?;
        let size = window.inner_size();
        let mut config = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| RenderError::Window {
                message: format!("`{}` cannot draw to this display", gpu.name),
            })?;
        // Codes are shown as they are: a format without its own encoding.
        config.format = config.format.remove_srgb_suffix();
        surface.configure(&gpu.device, &config);
        Ok(Self {
            pipeline: pipeline(gpu, config.format),
            window,
            surface,
            config,
            picture: None,
        })
    }

    /// Takes the size that the user drew the window to.
    pub fn resize(&mut self, gpu: &Gpu, size_px: [u32; 2]) {
        self.config.width = size_px[0].max(1);
        self.config.height = size_px[1].max(1);
        self.surface.configure(&gpu.device, &self.config);
    }

    /// Sets what stands over the picture.
    pub fn set_title(&self, title: &str) {
        self.window.set_title(title);
    }

    /// Shows a picture: four bytes per pixel, codes as they are, rows from the top. All pictures have the first one's size.
    ///
    /// # Errors
    /// [`RenderError::Window`] when the window's surface is lost.
    pub fn show(&mut self, gpu: &Gpu, size_px: [u32; 2], rgba: &[u8]) -> Result<(), RenderError> {
        use wgpu::CurrentSurfaceTexture as Current;
        let (texture, bindings) = self.picture.get_or_insert_with(|| {
            let [width, height] = size_px;
            // The window takes the picture's size; a refusal leaves the picture scaled.
            let _ = self
                .window
                .request_inner_size(winit::dpi::PhysicalSize::new(width, height));
            picture(gpu, &self.pipeline, size_px)
        });
        upload(gpu, texture, rgba);
        let target = match self.surface.get_current_texture() {
            Current::Success(target) | Current::Suboptimal(target) => target,
            Current::Timeout | Current::Occluded => return Ok(()),
            Current::Outdated => {
                self.surface.configure(&gpu.device, &self.config);
                return Ok(());
            }
            Current::Lost | Current::Validation => {
                return Err(RenderError::Window {
                    message: "the window's surface was lost".into(),
                });
            }
        };
        let view = target.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("present") });
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("present"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations::default(),
                })],
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &*bindings, &[]);
            pass.draw(0..3, 0..1);
        }
        gpu.queue.submit([encoder.finish()]);
        gpu.queue.present(target);
        Ok(())
    }
}

fn pipeline(gpu: &Gpu, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    let module = shader::module(&gpu.device, "present");
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("present"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn picture(gpu: &Gpu, pipeline: &wgpu::RenderPipeline, size_px: [u32; 2]) -> (wgpu::Texture, wgpu::BindGroup) {
    let texture = gpu.texture(
        "present: picture",
        TextureShape::plain(size_px),
        wgpu::TextureFormat::Rgba8Unorm,
    );
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    let sampler = gpu.linear_sampler();
    let bindings = gpu.bind(
        "present",
        &pipeline.get_bind_group_layout(0),
        &[
            wgpu::BindingResource::TextureView(&view),
            wgpu::BindingResource::Sampler(&sampler),
        ],
    );
    (texture, bindings)
}

fn upload(gpu: &Gpu, texture: &wgpu::Texture, rgba: &[u8]) {
    gpu.queue.write_texture(
        texture.as_image_copy(),
        rgba,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4 * texture.width()),
            rows_per_image: None,
        },
        texture.size(),
    );
}
