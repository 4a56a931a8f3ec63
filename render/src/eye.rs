//! An eye: one picture with the virtual objects in it, and the passes that make it.
//!
//! Video see-through has one eye, the scene camera itself.

use crate::camera_view::CameraView;
use crate::config::LightConfig;
use crate::environments::Environments;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::near::{NearEye, NearThings};
use crate::passes::camera_depth::CameraDepth;
use crate::passes::composite::Composite;
use crate::passes::direct::{self, ShadowedLight};
use crate::passes::lens_surface::LensSurface;
use crate::passes::real_radiance::RealRadiance;
use crate::passes::receive::Receive;
use crate::passes::shade::{self, Shade, ShadeTarget};
use crate::scene_gpu::SceneBuffers;
use crate::scene_rays::SceneRays;
use crate::scene_shadows::{EyeShadows, EyeSurfaces, SceneShadows};

/// The passes of one picture, in their order.
#[derive(Debug)]
pub struct Eye {
    /// Places and normals of the virtual objects.
    pub virtuals: LensSurface,
    /// Light on the phantoms and on the virtual objects.
    pub light_on: [ShadowedLight; 2],
    /// Light from afar, past all shadows.
    pub shadows: EyeShadows,
    /// Light that near things throw on each other.
    pub near: NearEye,
    /// Ratio by which virtual objects change the light on real ones.
    pub receive: Receive,
    /// Real things as radiance, shadows of the virtual ones on them.
    pub real: RealRadiance,
    /// Hides virtual objects behind real ones.
    pub depth: CameraDepth,
    /// Virtual objects as radiance.
    pub shade: Shade,
    /// The finished picture.
    pub composite: Composite,
}

/// What an eye looks at.
#[derive(Debug, Clone, Copy)]
pub struct EyeInputs<'a> {
    /// Camera, picture and real things.
    pub view: &'a CameraView,
    /// All objects, for rasters.
    pub scene: &'a SceneBuffers,
    /// All objects, for rays.
    pub rays: &'a SceneRays,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Radiance at the probe.
    pub probe_radiance: &'a wgpu::TextureView,
    /// What eyes share of the light between near things.
    pub near: &'a NearThings,
    /// The shadows that eyes share.
    pub shadows: &'a SceneShadows,
    /// How light reaches the objects.
    pub light: LightConfig,
}

impl Eye {
    /// Prepares all passes.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] or [`RenderError::Shadow`] where adapter or shadow method cannot take the scene.
    pub fn new(gpu: &Gpu, inputs: EyeInputs<'_>) -> Result<Self, RenderError> {
        let EyeInputs {
            view,
            scene,
            environments,
            shadows,
            ..
        } = inputs;
        let size_px = view.size_px();
        let virtuals = LensSurface::new(gpu, "lens_surface: virtual objects", (&view.camera, scene), size_px);
        let light_on = [&view.phantoms, &virtuals].map(|surface| ShadowedLight::new(gpu, surface.views()));
        let surfaces = EyeSurfaces {
            surfaces: [&view.phantoms, &virtuals],
            targets: &light_on,
        };
        let eye_shadows = shadows.eye(gpu, (scene, &view.model), surfaces)?;
        let direct = |light| direct::Inputs {
            camera: &view.camera,
            scene,
            environments,
            light,
        };
        let receive = Receive::new(gpu, direct(&light_on[0]), size_px);
        let target = ShadeTarget {
            size_px,
            light: inputs.light,
        };
        let shade = Shade::new(gpu, direct(&light_on[1]), (&gpu.linear_sampler(), target));
        let real = RealRadiance::new(gpu, view, receive.ratio());
        Ok(Self {
            depth: CameraDepth::new(gpu, &view.camera, scene, (size_px, shade::SAMPLES)),
            near: NearEye::new(gpu, inputs, &light_on, &real),
            real,
            composite: Composite::new(gpu, &view.camera, &view.picture, (&shade, &receive), size_px),
            shadows: eye_shadows,
            virtuals,
            light_on,
            receive,
            shade,
        })
    }

    /// Shadows by the method that `shadows` has changed to.
    ///
    /// # Errors
    /// As [`Eye::new`].
    pub fn renew_shadows(
        &mut self,
        gpu: &Gpu,
        (view, scene): (&CameraView, &SceneBuffers),
        shadows: &SceneShadows,
    ) -> Result<(), RenderError> {
        let surfaces = EyeSurfaces {
            surfaces: [&view.phantoms, &self.virtuals],
            targets: &self.light_on,
        };
        self.shadows = shadows.eye(gpu, (scene, &view.model), surfaces)?;
        Ok(())
    }
}
