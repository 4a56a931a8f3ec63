//! A scene on the test stand: pictures of it, and how long they take.

use glam::Vec4;
use image::RgbImage;
use mirrorball_render::{
    error::RenderError,
    gpu::Gpu,
    lab::{
        Lab, LabFrame,
        lamp::{AMBIENT, Lamp, LampKind},
        scenes::{self, MovingScene},
        tone,
    },
    shadow::{ShadowMethod, light::ShadowLight, path::PathSettings},
};
use mirrorball_tests::statistics;
use std::time::{Duration, Instant};

/// Time of the scene from picture to picture, seconds.
const STEP_S: f32 = 1.0 / 25.0;
/// Most pictures behind one median.
const PICTURES_MAX: usize = 200;

/// How much is done for every figure.
pub(crate) struct Effort {
    /// Pictures that do not count.
    pub(crate) warm_up: usize,
    /// Pictures that do, at least.
    pub(crate) pictures_min: usize,
    /// More of them for so long.
    time: Duration,
    /// Fewer of them, but one, after so long.
    time_max: Duration,
    /// By how much pictures are smaller than their tables say.
    picture_divisor: u32,
    /// By how much shadow maps are smaller than their tables say.
    map_divisor: u32,
}

impl Effort {
    /// What the tables say.
    pub(crate) const FULL: Self = Self {
        warm_up: 2,
        pictures_min: 5,
        time: Duration::from_secs(2),
        time_max: Duration::from_secs(20),
        picture_divisor: 1,
        map_divisor: 1,
    };
    /// Whether it runs at all.
    pub(crate) const QUICK: Self = Self {
        warm_up: 0,
        pictures_min: 1,
        time: Duration::ZERO,
        time_max: Duration::ZERO,
        picture_divisor: 8,
        map_divisor: 8,
    };

    /// Whether only to see that it runs.
    pub(crate) fn is_quick(&self) -> bool {
        self.time.is_zero()
    }

    /// Size of a picture.
    pub(crate) fn picture_px(&self, size_px: [u32; 2]) -> [u32; 2] {
        size_px.map(|px| px / self.picture_divisor)
    }

    /// Paths per pixel of a reference.
    pub(crate) fn paths(&self) -> u32 {
        if self.is_quick() { 4 } else { 256 }
    }

    /// Edge of a shadow map.
    pub(crate) fn map_size(&self, texels: u32) -> u32 {
        texels / self.map_divisor
    }
}

/// What is drawn, and how.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    /// The method.
    pub(crate) method: ShadowMethod,
    /// Edge of shadow maps, texels.
    pub(crate) map_size: u32,
    /// Depth maps of a dome refreshed at most per picture.
    pub(crate) refreshes_max: usize,
}

impl Way {
    /// Everything refreshed.
    pub(crate) fn new(method: ShadowMethod, map_size: u32) -> Self {
        Self {
            method,
            map_size,
            refreshes_max: usize::MAX,
        }
    }
}

/// What came of a measurement.
pub(crate) enum Outcome {
    /// Times.
    Timed(Timed),
    /// The method's reason not to draw this.
    Refused(String),
}

/// Medians over the pictures.
pub(crate) struct Timed {
    /// Milliseconds by the clock.
    pub(crate) ms: f64,
    /// Milliseconds of every pass by the adapter.
    pub(crate) passes_ms: Vec<(&'static str, f64)>,
}

/// A finished picture, or the method's reason not to draw it.
pub(crate) type Painted = Result<(RgbImage, Vec<bool>), String>;

/// A scene with its lamp.
pub(crate) struct Stand {
    lab: Lab,
    scene: MovingScene,
    lamp: Lamp,
    size_px: [u32; 2],
}

impl Stand {
    /// Uploads a scene, lit by the rectangle lamp.
    pub(crate) fn new(scene: MovingScene, size_px: [u32; 2]) -> Result<Self, RenderError> {
        let lab = Lab::new(
            Gpu::open()?,
            scene.scene.clone(),
            scene.placements(0.0),
            &scenes::view(size_px),
        )?;
        Ok(Self {
            lab,
            scene,
            lamp: Lamp::over_test_scene(LampKind::Rect),
            size_px,
        })
    }

    /// Takes another kind of lamp.
    pub(crate) fn with_lamp(mut self, kind: LampKind) -> Self {
        self.lamp.kind = kind;
        self
    }

    /// Times pictures of the moving scene.
    pub(crate) fn time(&mut self, way: Way, effort: &Effort) -> Result<Outcome, RenderError> {
        let light = self.lamp.light();
        let mut walls_ms = Vec::new();
        let mut passes_ms: Vec<(&'static str, Vec<f64>)> = Vec::new();
        let begun = Instant::now();
        for index in 0..PICTURES_MAX {
            let picture_begun = Instant::now();
            self.lab.place(&self.scene.placements(index as f32 * STEP_S));
            let passes = match self.lab.draw(&frame(way, &light)) {
                Err(error @ RenderError::Shadow { .. }) => return Ok(Outcome::Refused(error.to_string())),
                result => result?,
            };
            if index < effort.warm_up {
                continue;
            }
            walls_ms.push(1e3 * picture_begun.elapsed().as_secs_f64());
            for (name, ms) in passes {
                match passes_ms.iter_mut().find(|(known, _)| *known == name) {
                    Some((_, all)) => all.push(ms),
                    None => passes_ms.push((name, vec![ms])),
                }
            }
            let passed = begun.elapsed();
            if passed >= effort.time_max || (walls_ms.len() >= effort.pictures_min && passed >= effort.time) {
                break;
            }
        }
        let median = |all| statistics::median(all).unwrap_or(f64::NAN);
        Ok(Outcome::Timed(Timed {
            ms: median(walls_ms),
            passes_ms: passes_ms.into_iter().map(|(name, all)| (name, median(all))).collect(),
        }))
    }

    /// Draws the scene as it stands at first: a picture, and where there is a surface.
    pub(crate) fn paint(&mut self, way: Way) -> Result<Painted, RenderError> {
        self.lab.place(&self.scene.placements(0.0));
        let light = self.lamp.light();
        let picture = match self.lab.picture(&frame(way, &light)) {
            Err(error @ RenderError::Shadow { .. }) => return Ok(Err(error.to_string())),
            result => result?,
        };
        Ok(Ok(self.developed(&picture.radiance)))
    }

    /// Traces the scene as it stands at first on paths.
    pub(crate) fn trace(&mut self, settings: &PathSettings) -> Result<Painted, RenderError> {
        self.lab.place(&self.scene.placements(0.0));
        let light = self.lamp.light();
        let way = Way::new(ShadowMethod::PathTraced, 1);
        match self.lab.path_traced(&frame(way, &light), settings) {
            Err(error @ RenderError::Shadow { .. }) => Ok(Err(error.to_string())),
            result => Ok(Ok(self.developed(&result?.radiance))),
        }
    }

    /// Codes of a radiance, and where there is a surface.
    fn developed(&self, radiance: &[Vec4]) -> (RgbImage, Vec<bool>) {
        let codes = tone::srgb(radiance, tone::EXPOSURE);
        let [width, height] = self.size_px;
        let image = RgbImage::from_fn(width, height, |x, y| {
            let first = 4 * (y * width + x) as usize;
            image::Rgb([codes[first], codes[first + 1], codes[first + 2]])
        });
        (image, radiance.iter().map(|texel| texel.w > 0.5).collect())
    }
}

/// The frame of a way to draw.
fn frame(way: Way, light: &ShadowLight) -> LabFrame<'_> {
    LabFrame {
        method: way.method,
        map_size: way.map_size,
        light,
        ambient: AMBIENT,
        refreshes_max: way.refreshes_max,
    }
}
