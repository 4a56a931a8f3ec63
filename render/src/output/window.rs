//! A live window: the picture, and in its title frame rate, latency from frame set to picture, and marker state. Escape quits, S goes to the
//! next shadow method, D to the next buffer between the passes.

use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::window::WindowId;

use crate::app::{App, Step};
use crate::error::RenderError;
use crate::node::RenderedFrame;
use crate::output::screen::{Screen, failed};
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

struct Viewer<'a> {
    app: &'a mut App,
    should_stop: &'a dyn Fn() -> bool,
    shown: Option<Screen>,
    rate: Rate,
    result: Result<(), RenderError>,
}

impl ApplicationHandler for Viewer<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.shown.is_none() {
            match Screen::open(event_loop, self.app.node().gpu()) {
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
            } => self.press(event_loop, &key),
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
                    let node = self.app.node();
                    let mut title = format!("{}, shadows: {}", self.rate.title(&frame), node.shadow_method().name());
                    for buffer in node.shown() {
                        title += ", shown: ";
                        title += buffer.name();
                    }
                    shown.set_title(&title);
                    let result = shown.show(self.app.node().gpu(), frame.size_px, &frame.rgba);
                    if let Err(error) = result {
                        self.stop(event_loop, Err(error));
                    }
                }
            }
            Ok(Step::Skipped) => {}
            Ok(Step::Waiting) => {
                if let Some(shown) = self.shown.as_ref().filter(|_| self.rate.has_paused()) {
                    shown.set_title("mirrorball: waiting for frames");
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

    fn press(&mut self, event_loop: &ActiveEventLoop, key: &str) {
        if key.eq_ignore_ascii_case("s") {
            self.next_shadow_method(event_loop);
        } else if key.eq_ignore_ascii_case("d") {
            self.app.show_next_buffer();
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
