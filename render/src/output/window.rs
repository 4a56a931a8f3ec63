//! A live window: the picture, and in its title frame rate, latency from frame set to picture, and marker state. Escape quits, S goes to the
//! next shadow method.

use std::sync::Arc;
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::window::{Window, WindowId};

use crate::app::{App, Step};
use crate::error::RenderError;
use crate::gpu::pass::TextureShape;
use crate::gpu::{Gpu, shader};
use crate::node::RenderedFrame;
use crate::shadow::ShadowMethod;
use crate::tracker::TrackedPose;

/// How long the window waits for a frame before it looks at the keyboard again.
const PATIENCE: Duration = Duration::from_millis(20);

/// Runs an app in a window until the recording ends, Escape is pressed or the window is closed.
///
/// # Errors
/// [`RenderError::Window`] without a display, and whatever stops the app.
pub fn run(app: &mut App, should_stop: &dyn Fn() -> bool) -> Result<(), RenderError> {
    let event_loop = EventLoop::new().map_err(|e| failed(&e))?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut viewer = Viewer {
        app,
        should_stop,
        shown: None,
        rate: Rate::default(),
        result: Ok(()),
    };
    event_loop.run_app(&mut viewer).map_err(|e| failed(&e))?;
    viewer.result
}

fn failed(error: &dyn std::error::Error) -> RenderError {
    RenderError::Window {
        message: error.to_string(),
    }
}

struct Viewer<'a> {
    app: &'a mut App,
    should_stop: &'a dyn Fn() -> bool,
    shown: Option<Shown>,
    rate: Rate,
    result: Result<(), RenderError>,
}

impl ApplicationHandler for Viewer<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.shown.is_none() {
            match Shown::open(event_loop, self.app.node().gpu()) {
                Ok(shown) => self.shown = Some(shown),
                Err(error) => self.stop(event_loop, Err(error)),
            }
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => self.stop(event_loop, Ok(())),
            WindowEvent::KeyboardInput {
                event:
                    KeyEvent {
                        logical_key: Key::Named(NamedKey::Escape),
                        state: ElementState::Pressed,
                        ..
                    },
                ..
            } => self.stop(event_loop, Ok(())),
            WindowEvent::KeyboardInput {
                event:
                    KeyEvent {
                        logical_key: Key::Character(key),
                        state: ElementState::Pressed,
                        repeat: false,
                        ..
                    },
                ..
            } if key.eq_ignore_ascii_case("s") => self.next_shadow_method(event_loop),
            WindowEvent::Resized(size) => {
                if let Some(shown) = &mut self.shown {
                    shown.resize(self.app.node().gpu(), [size.width, size.height]);
                }
            }
            _ => {}
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if (self.should_stop)() {
            self.stop(event_loop, Ok(()));
            return;
        }
        match self.app.step(PATIENCE) {
            Ok(Step::Rendered(frame)) => {
                if let Some(shown) = &mut self.shown {
                    let method = self.app.node().shadow_method();
                    let title = format!("{}, shadows: {}", self.rate.title(&frame), method.name());
                    let result = shown.show(self.app.node().gpu(), &frame, &title);
                    if let Err(error) = result {
                        self.stop(event_loop, Err(error));
                    }
                }
            }
            Ok(Step::Skipped) => {}
            Ok(Step::Waiting) => {
                if let Some(shown) = self.shown.as_ref().filter(|_| self.rate.has_paused()) {
                    shown.window.set_title("mirrorball: waiting for frames");
                }
            }
            Ok(Step::Ended) => self.stop(event_loop, Ok(())),
            Err(error @ RenderError::Shadow { .. }) => {
                tracing::warn!("{error}; going on with the next method");
                self.next_shadow_method(event_loop);
            }
            Err(error) => self.stop(event_loop, Err(error)),
        }
    }
}

impl Viewer<'_> {
    /// Changes to the next shadow method that can serve here.
    fn next_shadow_method(&mut self, event_loop: &ActiveEventLoop) {
        let mut method = self.app.node().shadow_method();
        for _ in ShadowMethod::ALL {
            method = method.next();
            match self.app.set_shadow_method(method) {
                Ok(()) => {
                    tracing::info!(method = method.name(), "shadow method");
                    return;
                }
                Err(error @ RenderError::Shadow { .. }) => tracing::warn!("{error}"),
                Err(error) => {
                    self.stop(event_loop, Err(error));
                    return;
                }
            }
        }
    }

    fn stop(&mut self, event_loop: &ActiveEventLoop, result: Result<(), RenderError>) {
        if self.result.is_ok() {
            self.result = result;
        }
        event_loop.exit();
    }
}

/// Frame rate over the last frames.
#[derive(Debug, Default)]
struct Rate {
    last: Option<Instant>,
    seconds_per_frame: f64,
}

impl Rate {
    /// Whether no frame came for two seconds.
    fn has_paused(&self) -> bool {
        self.last.is_none_or(|last| last.elapsed() > Duration::from_secs(2))
    }

    fn title(&mut self, frame: &RenderedFrame) -> String {
        let now = Instant::now();
        if let Some(last) = self.last.replace(now) {
            let seconds = (now - last).as_secs_f64();
            let share = if self.seconds_per_frame == 0.0 { 1.0 } else { 0.1 };
            self.seconds_per_frame += share * (seconds - self.seconds_per_frame);
        }
        let fps = if self.seconds_per_frame > 0.0 {
            1.0 / self.seconds_per_frame
        } else {
            0.0
        };
        let latency_ms = frame
            .stages_ms
            .iter()
            .find(|(name, _)| *name == "total")
            .map_or(0.0, |(_, ms)| *ms);
        let markers = match &frame.pose {
            TrackedPose::Found {
                markers,
                reprojection_error_px,
                ..
            } => {
                format!("{markers} markers, {reprojection_error_px:.2} px")
            }
            TrackedPose::Lost { reason, .. } => format!("no pose: {reason}"),
        };
        format!("mirrorball: {fps:.1} frames/s, {latency_ms:.0} ms, {markers}")
    }
}

/// An open window with its surface.
struct Shown {
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    pipeline: wgpu::RenderPipeline,
    picture: Option<(wgpu::Texture, wgpu::BindGroup)>,
}

impl Shown {
    fn open(event_loop: &ActiveEventLoop, gpu: &Gpu) -> Result<Self, RenderError> {
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

    fn resize(&mut self, gpu: &Gpu, size_px: [u32; 2]) {
        self.config.width = size_px[0].max(1);
        self.config.height = size_px[1].max(1);
        self.surface.configure(&gpu.device, &self.config);
    }

    fn show(&mut self, gpu: &Gpu, frame: &RenderedFrame, title: &str) -> Result<(), RenderError> {
        use wgpu::CurrentSurfaceTexture as Current;
        self.window.set_title(title);
        let (texture, bindings) = self.picture.get_or_insert_with(|| {
            let [width, height] = frame.size_px;
            // The window takes the picture's size; a refusal leaves the picture scaled.
            let _ = self
                .window
                .request_inner_size(winit::dpi::PhysicalSize::new(width, height));
            picture(gpu, &self.pipeline, frame.size_px)
        });
        upload(gpu, texture, frame);
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

fn upload(gpu: &Gpu, texture: &wgpu::Texture, frame: &RenderedFrame) {
    gpu.queue.write_texture(
        texture.as_image_copy(),
        &frame.rgba,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4 * frame.size_px[0]),
            rows_per_image: None,
        },
        texture.size(),
    );
}
