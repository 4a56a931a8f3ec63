//! A scene without camera as it is shown: what moves with time, and what keys change.

use glam::Vec3;

use super::lamp::{AMBIENT, Lamp};
use super::scenes::MovingScene;
use super::{Lab, LabFrame, tone};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::shadow::ShadowMethod;
use crate::shadow::view::View;

/// What a key does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// The next method of [`ShadowMethod::ALL`].
    NextMethod,
    /// The next kind of light.
    NextLamp,
    /// Moves the light by steps along the world's axes.
    MoveLamp(Vec3),
    /// Stops the objects, or lets them move again.
    Pause,
}

/// What is chosen before a show begins.
#[derive(Debug, Clone, Copy)]
pub struct Choice {
    /// How shadows are drawn.
    pub method: ShadowMethod,
    /// Edge of shadow maps, texels.
    pub map_size: u32,
    /// The light.
    pub lamp: Lamp,
}

/// A scene at work.
#[derive(Debug)]
pub struct Show {
    scene: MovingScene,
    lab: Lab,
    choice: Choice,
    time_s: f32,
    is_paused: bool,
    size_px: [u32; 2],
}

/// A finished picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// sRGB codes, four bytes per pixel, rows from the top.
    pub rgba: Vec<u8>,
    /// Milliseconds per pass, measured by the GPU.
    pub stages_ms: Vec<(&'static str, f64)>,
}

impl Show {
    /// Uploads the scene.
    ///
    /// # Errors
    /// As [`Lab::new`].
    pub fn new(gpu: Gpu, scene: MovingScene, view: &View, choice: Choice) -> Result<Self, RenderError> {
        Ok(Self {
            lab: Lab::new(gpu, scene.scene.clone(), scene.placements(0.0), view)?,
            scene,
            choice,
            time_s: 0.0,
            is_paused: false,
            size_px: view.size_px,
        })
    }

    /// The graphics device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        self.lab.gpu()
    }

    /// Method, kind of light, and whether the objects stand still.
    #[must_use]
    pub fn state(&self) -> (ShadowMethod, Lamp, bool) {
        (self.choice.method, self.choice.lamp, self.is_paused)
    }

    /// Does what a key asks for.
    pub fn act(&mut self, action: Action) {
        match action {
            Action::NextMethod => self.choice.method = self.choice.method.next(),
            Action::NextLamp => self.choice.lamp.kind = self.choice.lamp.kind.next(),
            Action::MoveLamp(steps) => self.choice.lamp.step(steps),
            Action::Pause => self.is_paused = !self.is_paused,
        }
    }

    /// Lets time pass, unless paused.
    pub fn advance(&mut self, seconds: f32) {
        if !self.is_paused {
            self.time_s += seconds;
            self.lab.place(&self.scene.placements(self.time_s));
        }
    }

    /// Draws the picture with the method of choice.
    ///
    /// # Errors
    /// As [`Lab::picture`].
    pub fn picture(&mut self) -> Result<Shown, RenderError> {
        self.picture_with(self.choice.method)
    }

    /// Draws the picture without shadows, for when a method refuses.
    ///
    /// # Errors
    /// As [`Lab::picture`].
    pub fn picture_without_shadow(&mut self) -> Result<Shown, RenderError> {
        self.picture_with(ShadowMethod::None)
    }

    fn picture_with(&mut self, method: ShadowMethod) -> Result<Shown, RenderError> {
        let picture = self.lab.picture(&LabFrame {
            method,
            map_size: self.choice.map_size,
            light: &self.choice.lamp.light(),
            ambient: AMBIENT,
            refreshes_max: usize::MAX,
        })?;
        Ok(Shown {
            size_px: self.size_px,
            rgba: tone::srgb(&picture.radiance, tone::EXPOSURE),
            stages_ms: picture.stages_ms,
        })
    }
}
