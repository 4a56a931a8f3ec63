//! An eye: one picture with the virtual objects in it, and the passes that make it.
//!
//! Video see-through has one eye, the scene camera itself.

use crate::camera_view::CameraView;
use crate::config::{LightConfig, PhantomEdges, Protection};
use crate::environments::Environments;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::passes::camera_depth::CameraDepth;
use crate::passes::composite::Composite;
use crate::passes::direct::{self, ShadowedLight};
use crate::passes::lens_surface::LensSurface;
use crate::passes::phantom_edge::PhantomEdge;
use crate::passes::protect::{BrightLight, Protect};
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
    /// Bright lights on the phantoms, by themselves.
    pub bright: BrightLight,
    /// Finds shadows of real things that the scene does not know, if asked to.
    pub protect: Option<Protect>,
    /// Ratio by which virtual objects change the light on real ones.
    pub receive: Receive,
    /// Real things as radiance, shadows of the virtual ones on them.
    pub real: RealRadiance,
    /// Hides virtual objects behind real ones.
    pub depth: CameraDepth,
    /// Virtual objects as radiance.
    pub shade: Shade,
    /// Puts the edges of phantoms before virtual objects where the picture has them, if asked to.
    pub edges: Option<PhantomEdge>,
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
    /// The shadows that eyes share.
    pub shadows: &'a SceneShadows,
    /// How light reaches the objects.
    pub light: LightConfig,
    /// Whether unknown shadows are looked for.
    pub protection: Protection,
    /// Where phantoms end.
    pub phantom_edges: PhantomEdges,
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
        let bright = BrightLight::new(gpu, size_px);
        let is_protected = inputs.protection == Protection::Found;
        let surfaces = EyeSurfaces {
            surfaces: [&view.phantoms, &virtuals],
            targets: &light_on,
            bright: is_protected.then_some(&bright),
        };
        let eye_shadows = shadows.eye(gpu, (scene, &view.model), surfaces)?;
        let direct = |light| direct::Inputs {
            camera: &view.camera,
            scene,
            environments,
            light,
        };
        let receive = Receive::new(gpu, direct(&light_on[0]), &bright, size_px);
        let protect = is_protected.then(|| Protect::new(gpu, direct(&light_on[0]), (view, receive.frame()), &bright));
        let target = ShadeTarget {
            size_px,
            light: inputs.light,
        };
        let shade = Shade::new(gpu, direct(&light_on[1]), (&gpu.linear_sampler(), target));
        let edges = match inputs.phantom_edges {
            PhantomEdges::Mesh => None,
            PhantomEdges::Picture => Some(PhantomEdge::new(gpu, view, virtuals.views().place, shade.radiance())),
        };
        Ok(Self {
            edges,
            depth: CameraDepth::new(gpu, &view.camera, scene, (size_px, shade::SAMPLES)),
            real: RealRadiance::new(gpu, view, receive.ratio()),
            composite: Composite::new(gpu, &view.camera, &view.picture, (&shade, &receive), size_px),
            shadows: eye_shadows,
            virtuals,
            light_on,
            bright,
            protect,
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
            bright: self.protect.as_ref().map(|_| &self.bright),
        };
        self.bright.clear(gpu);
        self.shadows = shadows.eye(gpu, (scene, &view.model), surfaces)?;
        Ok(())
    }
}
