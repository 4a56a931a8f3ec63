//! An eye: one picture with the virtual objects in it, and the passes that make it.
//!
//! Video see-through has one eye, the scene camera itself. In all other modes an eye has a view of its own.

use mirrorball_calib::pose::Pose;

use crate::camera_view::CameraView;
use crate::codes::Codes;
use crate::config::{LightConfig, ModeConfig, PhantomEdges, PhantomsInVr, Protection};
use crate::environments::Environments;
use crate::error::RenderError;
use crate::eye_view::EyeView;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::gpu::types::GpuNoise;
use crate::mode::Surround;
use crate::near::{NearEye, NearThings};
use crate::passes::camera_depth::CameraDepth;
use crate::passes::composite::Composite;
use crate::passes::direct::{self, ShadowedLight};
use crate::passes::display::{self, Display};
use crate::passes::lamp_light::LampLight;
use crate::passes::lamp_receive::LampReceive;
use crate::passes::lens_surface::LensSurface;
use crate::passes::look_blur::LookBlur;
use crate::passes::phantom_edge::PhantomEdge;
use crate::passes::protect::{BrightLight, Protect};
use crate::passes::real_radiance::RealRadiance;
use crate::passes::receive::Receive;
use crate::passes::shade::{self, Shade, ShadeTarget};
use crate::scene_gpu::SceneBuffers;
use crate::scene_rays::SceneRays;
use crate::scene_shadows::{EyeShadows, EyeSurfaces, SceneShadows};
use crate::traced::Traced;

/// How a picture is finished.
#[derive(Debug)]
pub enum Finish {
    /// Into the camera's picture.
    Picture(Box<Composite>),
    /// For a display without one.
    Display(Box<Display>),
}

impl Finish {
    /// What finishes pictures of `view` in a mode; it reads what `inputs` has, or the picture in place of its real things.
    fn new(gpu: &Gpu, mode: &ModeConfig, view: &CameraView, inputs: display::Inputs<'_>) -> Self {
        let size_px = view.size_px();
        match mode.name.surround() {
            Surround::Picture => {
                let changes = (inputs.shade, inputs.receive);
                let composite = Composite::new(gpu, &view.camera, &view.picture, changes, size_px);
                Self::Picture(Box::new(composite))
            }
            Surround::Backdrop | Surround::Nothing => {
                Self::Display(Box::new(Display::new(gpu, inputs, (mode, size_px))))
            }
        }
    }

    /// The finished picture.
    #[must_use]
    pub fn codes(&self) -> &Codes {
        match self {
            Self::Picture(composite) => composite.codes(),
            Self::Display(display) => display.codes(),
        }
    }

    /// The noise that the pixels of the next picture get where they are not the camera's own; a display has none.
    pub fn set_noise(&self, gpu: &Gpu, noise: &GpuNoise) {
        match self {
            Self::Picture(composite) => composite.set_noise(gpu, noise),
            Self::Display(_) => {}
        }
    }

    /// Mixes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        match self {
            Self::Picture(composite) => composite.record(encoder, timer),
            Self::Display(display) => display.record(encoder, timer),
        }
    }
}

/// What hides virtual objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Hiding {
    /// Phantoms.
    Phantoms,
    /// Nothing: no real thing is shown.
    Nothing,
}

impl Hiding {
    /// What hides them in a mode.
    fn by(mode: &ModeConfig) -> Self {
        match (mode.name.surround(), mode.phantoms) {
            (Surround::Backdrop, PhantomsInVr::LeftOut) => Self::Nothing,
            (Surround::Backdrop, PhantomsInVr::Grey) | (Surround::Picture | Surround::Nothing, _) => Self::Phantoms,
        }
    }
}

/// The passes of one picture, in their order.
#[derive(Debug)]
pub struct Eye {
    /// What it sees of the real things; `None` for the scene camera itself.
    pub own: Option<EyeView>,
    /// Places and normals of the virtual objects.
    pub virtuals: LensSurface,
    /// Light on the phantoms and on the virtual objects.
    pub light_on: [ShadowedLight; 2],
    /// Light from afar, past all shadows.
    pub shadows: EyeShadows,
    /// Light of virtual lamps on either.
    pub lamps: [LampLight; 2],
    /// Real things in its own view, without virtual shadows; `None` for the scene camera itself, whose eyes share them.
    pub own_unshadowed: Option<RealRadiance>,
    /// Light that near things throw on each other.
    pub near: NearEye,
    /// Bright lights on the phantoms, by themselves.
    pub bright: BrightLight,
    /// Finds shadows of real things that the scene does not know, if asked to.
    pub protect: Option<Protect>,
    /// Ratio by which virtual objects change the light on real ones.
    pub receive: Receive,
    /// Light of virtual lamps on real things.
    pub lamp_receive: LampReceive,
    /// Real things as radiance, shadows of the virtual ones on them.
    pub real: RealRadiance,
    /// What rays from the virtual objects find.
    pub traced: Traced,
    /// Hides virtual objects behind real ones.
    pub depth: CameraDepth,
    /// Virtual objects as radiance.
    pub shade: Shade,
    /// The camera's blur on virtual objects and on their shadows.
    pub look: LookBlur,
    /// Puts the edges of phantoms before virtual objects where the picture has them, if asked to.
    pub edges: Option<PhantomEdge>,
    /// The finished picture.
    pub finish: Finish,
    hiding: Hiding,
}

/// What an eye looks at.
#[derive(Debug, Clone, Copy)]
pub struct EyeInputs<'a> {
    /// What the scene camera sees.
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
    /// What stands around them.
    pub mode: &'a ModeConfig,
    /// Whether unknown shadows are looked for.
    pub protection: Protection,
    /// Where phantoms end.
    pub phantom_edges: PhantomEdges,
}

impl Eye {
    /// Prepares all passes for the scene camera itself or for an eye with its `own` view.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] or [`RenderError::Shadow`] where adapter or shadow method cannot take the scene.
    pub fn new(gpu: &Gpu, inputs: EyeInputs<'_>, own: Option<EyeView>) -> Result<Self, RenderError> {
        let EyeInputs { scene, shadows, .. } = inputs;
        let view = own.as_ref().map_or(inputs.view, |own| &own.view);
        let of_eye = EyeInputs { view, ..inputs };
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
            environments: inputs.environments,
            light,
        };
        let receive = Receive::new(gpu, direct(&light_on[0]), &bright, size_px);
        let protect = is_protected.then(|| Protect::new(gpu, direct(&light_on[0]), (view, receive.frame()), &bright));
        let lamp_receive = LampReceive::new(gpu, view, (&light_on[0], &receive), scene.n_lamps);
        let lamps = [(&view.phantoms, &light_on[0]), (&virtuals, &light_on[1])]
            .map(|(surface, light)| LampLight::new(gpu, (scene, inputs.rays), (surface.views(), light)));
        let own_unshadowed = own.as_ref().map(|own| RealRadiance::unshadowed(gpu, &own.view));
        let unshadowed = own_unshadowed.as_ref().unwrap_or(&inputs.near.unshadowed);
        let real = RealRadiance::new(gpu, view, [receive.ratio(), receive.added()]);
        let traced = Traced::new(gpu, of_eye, &virtuals, (&real, &receive));
        let target = ShadeTarget {
            size_px,
            light: inputs.light,
            traced: traced.views(),
        };
        let shade = Shade::new(gpu, direct(&light_on[1]), (&gpu.linear_sampler(), target));
        let near = NearEye::new(gpu, of_eye, (&light_on, &bright), [&real, unshadowed]);
        let of_display = display::Inputs {
            camera: &view.camera,
            shade: &shade,
            receive: &receive,
            real: unshadowed,
            light: &light_on[0],
            probe_radiance: inputs.probe_radiance,
        };
        let finish = Finish::new(gpu, inputs.mode, view, of_display);
        Ok(Self {
            edges: edges(gpu, of_eye, &virtuals, &shade),
            depth: CameraDepth::new(gpu, &view.camera, scene, (size_px, shade::SAMPLES)),
            look: LookBlur::new(gpu, &[shade.radiance(), receive.ratio(), receive.added()], size_px),
            near,
            own_unshadowed,
            real,
            traced,
            finish,
            hiding: Hiding::by(inputs.mode),
            shadows: eye_shadows,
            virtuals,
            light_on,
            lamps,
            bright,
            protect,
            receive,
            lamp_receive,
            shade,
            own,
        })
    }

    /// Where the eye is when the scene camera is at `camera_from_world`.
    #[must_use]
    pub fn from_world(&self, camera_from_world: &Pose) -> Pose {
        self.own
            .as_ref()
            .map_or(*camera_from_world, |own| own.eye_from_camera * *camera_from_world)
    }

    /// Draws what hides virtual objects.
    pub fn record_depth(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: &SceneBuffers) {
        match self.hiding {
            Hiding::Phantoms => self.depth.record(encoder, timer, scene),
            Hiding::Nothing => self.depth.record_empty(encoder, timer),
        }
    }

    /// Empties what the finished picture reads: no virtual object, and no change of light.
    pub fn record_nothing(&self, encoder: &mut wgpu::CommandEncoder) {
        Gpu::clear(
            encoder,
            &[self.shade.radiance(), self.receive.ratio(), self.receive.added()],
        );
    }

    /// Shadows by the method that `shadows` has changed to.
    ///
    /// # Errors
    /// As [`Eye::new`].
    pub fn renew_shadows(
        &mut self,
        gpu: &Gpu,
        (seen, scene): (&CameraView, &SceneBuffers),
        shadows: &SceneShadows,
    ) -> Result<(), RenderError> {
        let view = self.own.as_ref().map_or(seen, |own| &own.view);
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

/// The pass for the edges of phantoms before `virtuals` in the eye's picture, where the picture has a say in them.
fn edges(gpu: &Gpu, inputs: EyeInputs<'_>, virtuals: &LensSurface, shade: &Shade) -> Option<PhantomEdge> {
    match (inputs.mode.name.surround(), inputs.phantom_edges) {
        // Before a backdrop phantoms are left out, or drawn as far as their meshes reach.
        (Surround::Backdrop, _) | (Surround::Picture | Surround::Nothing, PhantomEdges::Mesh) => None,
        (Surround::Picture | Surround::Nothing, PhantomEdges::Picture) => {
            let places = virtuals.views().place;
            Some(PhantomEdge::new(gpu, inputs.view, places, shade.radiance()))
        }
    }
}
