//! The scene without camera in a window. S: next method; L: next kind of light; arrows, Page Up and Page Down: move the
//! light; space: pause; Escape: quit. The title says what is shown and how long it took.

use std::time::Instant;

use glam::Vec3;
use winit::application::ApplicationHandler;
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::window::WindowId;

use super::show::{Action, Show};
use crate::error::RenderError;
use crate::output::screen::{Screen, failed};

/// Shows a scene until Escape is pressed or the window is closed.
///
/// # Errors
/// [`RenderError::Window`] without a display, and whatever stops the drawing. A method that refuses the light or the
/// scene stops nothing: the title says why, and the picture has no shadows.
pub fn run(show: &mut Show) -> Result<(), RenderError> {
    let event_loop = EventLoop::new().map_err(|e| failed(&e))?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut viewer = Viewer {
        show,
        screen: None,
        last: Instant::now(),
        smooth_ms: 0.0,
        result: Ok(()),
    };
    event_loop.run_app(&mut viewer).map_err(|e| failed(&e))?;
    viewer.result
}

struct Viewer<'a> {
    show: &'a mut Show,
    screen: Option<Screen>,
    last: Instant,
    /// Milliseconds per picture over the last ones; 0 after a change.
    smooth_ms: f64,
    result: Result<(), RenderError>,
}

impl ApplicationHandler for Viewer<'_> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.screen.is_none() {
            match Screen::open(event_loop, self.show.gpu()) {
                Ok(screen) => self.screen = Some(screen),
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
                        logical_key,
                        state: ElementState::Pressed,
                        ..
                    },
                ..
            } => {
                if logical_key == Key::Named(NamedKey::Escape) {
                    self.stop(event_loop, Ok(()));
                } else if let Some(action) = action_of(&logical_key) {
                    self.show.act(action);
                    self.smooth_ms = 0.0;
                }
            }
            WindowEvent::Resized(size) => {
                if let Some(screen) = &mut self.screen {
                    screen.resize(self.show.gpu(), [size.width, size.height]);
                }
            }
            _ => {}
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let passed = self.last.elapsed();
        self.last = Instant::now();
        self.show.advance(passed.as_secs_f32().min(0.2));
        if let Err(error) = self.draw() {
            self.stop(event_loop, Err(error));
        }
    }
}

impl Viewer<'_> {
    fn draw(&mut self) -> Result<(), RenderError> {
        let Some(screen) = &mut self.screen else {
            return Ok(());
        };
        let begun = Instant::now();
        let (shown, refusal) = match self.show.picture() {
            Err(RenderError::Shadow { message, .. }) => (self.show.picture_without_shadow()?, Some(message)),
            result => (result?, None),
        };
        let ms = 1e3 * begun.elapsed().as_secs_f64();
        let share = if self.smooth_ms == 0.0 { 1.0 } else { 0.1 };
        self.smooth_ms += share * (ms - self.smooth_ms);
        let gpu_ms: f64 = shown.stages_ms.iter().map(|(_, ms)| ms).sum();
        let (method, lamp, _) = self.show.state();
        let what = format!("{}, {} light", method.name(), lamp.kind.name());
        screen.set_title(&refusal.map_or_else(
            || format!("{what}: {:.1} ms, of these {gpu_ms:.1} on the GPU", self.smooth_ms),
            |message| format!("{what}: {message}"),
        ));
        screen.show(self.show.gpu(), shown.size_px, &shown.rgba)
    }

    fn stop(&mut self, event_loop: &ActiveEventLoop, result: Result<(), RenderError>) {
        if self.result.is_ok() {
            self.result = result;
        }
        event_loop.exit();
    }
}

/// What a key does, if anything.
fn action_of(key: &Key) -> Option<Action> {
    match key {
        Key::Named(NamedKey::Space) => Some(Action::Pause),
        Key::Named(NamedKey::ArrowLeft) => Some(Action::MoveLamp(Vec3::NEG_X)),
        Key::Named(NamedKey::ArrowRight) => Some(Action::MoveLamp(Vec3::X)),
        Key::Named(NamedKey::ArrowUp) => Some(Action::MoveLamp(Vec3::Y)),
        Key::Named(NamedKey::ArrowDown) => Some(Action::MoveLamp(Vec3::NEG_Y)),
        Key::Named(NamedKey::PageUp) => Some(Action::MoveLamp(Vec3::Z)),
        Key::Named(NamedKey::PageDown) => Some(Action::MoveLamp(Vec3::NEG_Z)),
        Key::Character(text) if text.eq_ignore_ascii_case("s") => Some(Action::NextMethod),
        Key::Character(text) if text.eq_ignore_ascii_case("l") => Some(Action::NextLamp),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_do_what_the_module_says() {
        assert_eq!(action_of(&Key::Character("S".into())), Some(Action::NextMethod));
        assert_eq!(action_of(&Key::Character("l".into())), Some(Action::NextLamp));
        assert_eq!(action_of(&Key::Character("x".into())), None);
        assert_eq!(action_of(&Key::Named(NamedKey::Space)), Some(Action::Pause));
        assert_eq!(
            action_of(&Key::Named(NamedKey::PageUp)),
            Some(Action::MoveLamp(Vec3::Z))
        );
    }
}
