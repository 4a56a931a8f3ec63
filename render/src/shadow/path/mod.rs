//! The reference of all light (D18): paths traced through the scene on the GPU, off line.
//!
//! Light is drawn at its source and met by chance, each way with the weight that Veach and Guibas (1995) give it. Surfaces
//! are diffuse, rough or smooth metal, coated, or smooth glass ([`crate::scene::Material`]); base colour pictures are not
//! read, as in the lab's other pictures. With [`PathSettings::max_bounces`] 1 it is the reference of direct light, whose
//! lights may be any [`super::light::ShadowLight`] and an environment.
//!
//! Caustics are honest: a path that leaves a mirror or glass and meets the rectangle or the environment by chance counts.
//! There is no photon map, so a small lamp behind glass needs many samples, and a point, spot or directional light makes no
//! caustic and leaves a black shadow behind glass: give it a size instead.
//!
//! [`PathTracer`] is the pass, [`scene::TracedScene`] what it traces, [`run::PathRun`] a picture that gets better sample by
//! sample. [`irradiance`] is the pass for real surfaces: what the environment gives them past two sets of things.

pub mod environment;
pub mod hierarchy;
pub mod irradiance;
pub mod run;
pub mod scene;

use glam::{Vec3, Vec4};

use super::light::ShadowLight;
use super::view::View;
use crate::error::RenderError;
use crate::gpu::Gpu;
use environment::Environment;
use run::PathRun;
use scene::TracedScene;

/// How paths are traced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathSettings {
    /// Paths per pixel.
    pub samples: u32,
    /// How often light may be scattered between its source and the eye: 0 shows lights only, 1 is direct light.
    pub max_bounces: u32,
    /// Another seed gives another picture of the same mean; the same one gives the same bits on the same adapter.
    pub seed: u32,
    /// How light is found.
    pub sampling: Sampling,
    /// Where in a pixel its rays go through.
    pub pixel: PixelRays,
    /// What surfaces are made of.
    pub surfaces: Surfaces,
}

/// How light is found. All ways have the same mean; only diffuse and rough surfaces may do without one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// At its source and by chance, weighted (multiple importance sampling).
    Both,
    /// At its source; by chance only where a surface mirrors or refracts, or where the light comes from everywhere alike.
    Lights,
    /// By chance; only lights without size at their source.
    Surfaces,
}

/// Where in a pixel its rays go through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelRays {
    /// All over it: smooth edges.
    Everywhere,
    /// Through its centre, where the other methods look.
    Center,
}

/// What surfaces are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surfaces {
    /// What their materials say.
    AsGiven,
    /// Matt, of their base colour, as the lab's other pictures show them.
    Matt,
}

impl Default for PathSettings {
    /// All of light in a picture that is good to look at.
    fn default() -> Self {
        Self {
            samples: 64,
            max_bounces: 8,
            seed: 0,
            sampling: Sampling::Both,
            pixel: PixelRays::Everywhere,
            surfaces: Surfaces::AsGiven,
        }
    }
}

impl PathSettings {
    /// What the lab's other methods approximate: direct light on matt surfaces, through the pixels' centres.
    #[must_use]
    pub fn direct(samples: u32) -> Self {
        Self {
            samples,
            max_bounces: 1,
            pixel: PixelRays::Center,
            surfaces: Surfaces::Matt,
            ..Self::default()
        }
    }
}

/// One picture to trace.
#[derive(Debug, Clone, Copy)]
pub struct PathJob<'a> {
    /// From where.
    pub view: &'a View,
    /// The light, if any. The eye does not see its rectangle, mirrors and glass show it.
    pub light: Option<&'a ShadowLight>,
    /// Light from infinitely far away.
    pub environment: Environment<'a>,
    /// How.
    pub settings: PathSettings,
    /// Where the mean goes on the GPU, of the view's size, [`crate::gpu::pass::RADIANCE_FORMAT`], for storage; w: share of
    /// rays that met a surface.
    pub target: Option<&'a wgpu::TextureView>,
}

/// A traced picture, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct PathPicture {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// Linear radiance; w: share of rays that met a surface.
    pub radiance: Vec<Vec4>,
    /// Standard error of the radiance if the samples were independent; they are spread evenly, so the error is at most
    /// about that and often far smaller.
    pub standard_error: Vec<Vec3>,
    /// Paths per pixel.
    pub samples: u32,
    /// Milliseconds per pass, measured by the GPU.
    pub stages_ms: Vec<(&'static str, f64)>,
}

/// The pass.
#[derive(Debug)]
pub struct PathTracer {
    pub(crate) pipeline: wgpu::ComputePipeline,
}

impl PathTracer {
    /// The pass for any scene.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            pipeline: gpu.compute_pipeline("shadow_path"),
        }
    }

    /// Traces a picture and reads it back.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for light that is no finite number, [`RenderError::TooLarge`] for a picture that the adapter
    /// has no room for, [`RenderError::Gpu`] when the device is lost.
    pub fn render(&self, gpu: &Gpu, scene: &TracedScene, job: &PathJob<'_>) -> Result<PathPicture, RenderError> {
        let mut run = PathRun::start(gpu, self, scene, job)?;
        run.add(gpu, job.settings.samples)?;
        run.picture(gpu)
    }
}

/// What the path tracer refuses.
pub(crate) fn refused(message: impl Into<String>, hint: &'static str) -> RenderError {
    RenderError::Shadow {
        method: "path",
        message: message.into(),
        hint,
    }
}
