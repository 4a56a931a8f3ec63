//! The shadow scene's pictures by the path tracer.

use super::{Lab, LabFrame, LabPicture};
use crate::error::RenderError;
use crate::shadow::path::environment::Environment;
use crate::shadow::path::scene::TracedScene;
use crate::shadow::path::{PathJob, PathPicture, PathSettings, PathTracer, Surfaces};

/// What the path tracer keeps from picture to picture, made when it is first asked for.
#[derive(Debug, Default)]
pub(super) struct Paths {
    tracer: Option<PathTracer>,
    scene: Option<(Surfaces, TracedScene)>,
}

impl Paths {
    /// Something has moved.
    pub(super) fn forget_places(&mut self) {
        self.scene = None;
    }
}

impl Lab {
    /// Traces the frame's light and ambient light on paths, whatever its method. The whole picture is the result, not a
    /// visibility; [`PathSettings::direct`] gives what the other methods approximate.
    ///
    /// # Errors
    /// As [`PathTracer::render`].
    pub fn path_traced(&mut self, frame: &LabFrame<'_>, settings: &PathSettings) -> Result<PathPicture, RenderError> {
        self.traced(frame, settings, None)
    }

    /// The same; the mean also goes to `target` on the GPU.
    pub(super) fn traced(
        &mut self,
        frame: &LabFrame<'_>,
        settings: &PathSettings,
        target: Option<&wgpu::TextureView>,
    ) -> Result<PathPicture, RenderError> {
        let gpu = &self.gpu;
        let tracer = self.paths.tracer.get_or_insert_with(|| PathTracer::new(gpu));
        let surfaces = settings.surfaces;
        let (_, scene) = match self.paths.scene.take().filter(|(made_of, _)| *made_of == surfaces) {
            Some(kept) => self.paths.scene.insert(kept),
            None => {
                let made = TracedScene::new(gpu, (&self.scene, &self.placements), surfaces)?;
                self.paths.scene.insert((surfaces, made))
            }
        };
        let job = PathJob {
            view: &self.surface.view,
            light: Some(frame.light),
            environment: Environment::Uniform(frame.ambient),
            settings: *settings,
            target,
        };
        tracer.render(gpu, scene, &job)
    }
}

impl From<PathPicture> for LabPicture {
    fn from(traced: PathPicture) -> Self {
        Self {
            size_px: traced.size_px,
            radiance: traced.radiance,
            stages_ms: traced.stages_ms,
        }
    }
}
