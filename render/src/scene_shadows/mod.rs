//! Light from afar on the phantoms and on the virtual objects, past the shadows of both, by any method.
//!
//! Every method gives the same two pictures for each of the two surfaces: irradiance past the real things alone, and past all
//! objects. [`crate::passes::receive`] takes their ratio, [`crate::passes::shade`] the second.

mod dome;
mod key;
mod path;

use glam::{Affine3A, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::{Camera, Rig};

use crate::config::ShadowConfig;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::passes::direct::ShadowedLight;
use crate::passes::lens_surface::LensSurface;
use crate::passes::protect::BrightLight;
use crate::probe::Light;
use crate::scene::{Kind, Scene, Vertex};
use crate::scene_gpu::SceneBuffers;
use crate::shadow::casters::Casters;
use crate::shadow::shadow_view::{Sphere, enclosing};
use crate::shadow::{Family, ShadowMethod};
pub(crate) use dome::dome_light;
use dome::{DomeShadows, SharedMaps};
use key::KeyShadows;
use path::PathShadows;

/// The phantoms' shadow maps reach this far around the virtual objects, metres.
const RECEIVER_MARGIN_M: f32 = 0.1;

/// Things that cast or receive: the real ones, the virtual ones.
#[derive(Debug)]
struct Things {
    phantoms: Casters,
    virtuals: Casters,
    everything: Casters,
}

/// Spheres around parts of the scene, world.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    virtuals: Sphere,
    everything: Sphere,
}

impl Bounds {
    /// What the phantoms' shadow maps cover: the virtual objects and the ground around them.
    fn receivers(&self) -> Sphere {
        Sphere {
            radius_m: 1.3 * self.virtuals.radius_m + RECEIVER_MARGIN_M,
            ..self.virtuals
        }
    }
}

/// What the shadows of one scene share, whoever looks at them.
#[derive(Debug)]
pub struct SceneShadows {
    config: ShadowConfig,
    things: Things,
    bounds: Bounds,
    /// For dome methods.
    maps: Option<SharedMaps>,
}

/// The shadows in one eye's pictures.
#[derive(Debug)]
pub struct EyeShadows(Passes);

#[derive(Debug)]
enum Passes {
    Dome(Box<DomeShadows>),
    Key(Box<KeyShadows>),
    Path(Box<PathShadows>),
}

/// What the shadows of a frame come from.
#[derive(Debug, Clone, Copy)]
pub struct ShadowFrame<'a> {
    /// The scene on the GPU.
    pub scene: &'a SceneBuffers,
    /// The light.
    pub light: &'a Light,
    /// Where it was measured, world, metres.
    pub probe_m: Vec3,
    /// Whether objects have moved since the last frame.
    pub is_moved: bool,
}

/// The two surfaces that an eye sees, with what is to be filled for each: phantoms, virtual objects.
#[derive(Debug, Clone, Copy)]
pub struct EyeSurfaces<'a> {
    /// Their places and normals.
    pub surfaces: [&'a LensSurface; 2],
    /// The light on them.
    pub targets: &'a [ShadowedLight; 2],
    /// Where the bright lights on the phantoms go by themselves, if anybody asks: methods that count their rays fill it.
    pub bright: Option<&'a BrightLight>,
}

impl SceneShadows {
    /// Shadows of a scene.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] or [`RenderError::Shadow`] where the adapter or the method cannot take the scene.
    pub fn new(
        gpu: &Gpu,
        (scene, buffers): (&Scene, &SceneBuffers),
        rig: &Rig,
        config: ShadowConfig,
    ) -> Result<Self, RenderError> {
        let placements: Vec<Affine3A> = scene.objects.iter().map(|o| o.world_from_object(rig)).collect();
        let casters = |chosen: &dyn Fn(Kind) -> bool| {
            Casters::new(gpu, buffers, (scene, &placements), |i| chosen(scene.objects[i].kind))
        };
        let things = Things {
            phantoms: casters(&|kind| kind == Kind::Phantom),
            virtuals: casters(&|kind| kind == Kind::Virtual),
            everything: casters(&|_| true),
        };
        let bounds = things.bounds();
        let maps = shared_maps(gpu, (&things, &bounds, buffers), &config)?;
        Ok(Self {
            config,
            things,
            bounds,
            maps,
        })
    }

    /// The shadows in the pictures of an eye: `camera`'s.
    ///
    /// # Errors
    /// As [`SceneShadows::new`].
    pub fn eye(
        &self,
        gpu: &Gpu,
        (buffers, camera): (&SceneBuffers, &Camera),
        surfaces: EyeSurfaces<'_>,
    ) -> Result<EyeShadows, RenderError> {
        let passes = match &self.maps {
            Some(maps) => Passes::Dome(Box::new(DomeShadows::new(gpu, maps, surfaces)?)),
            None if self.config.method.family() == Family::Path => {
                Passes::Path(Box::new(PathShadows::new(gpu, &self.things, surfaces)?))
            }
            None => Passes::Key(Box::new(KeyShadows::new(
                gpu,
                (buffers, camera),
                surfaces,
                &self.config,
            )?)),
        };
        Ok(EyeShadows(passes))
    }

    /// The method in use.
    #[must_use]
    pub fn method(&self) -> ShadowMethod {
        self.config.method
    }

    /// Changes the method; on failure the one in use stays. Eyes must be asked for anew.
    ///
    /// # Errors
    /// As [`SceneShadows::new`].
    pub fn set_method(&mut self, gpu: &Gpu, buffers: &SceneBuffers, method: ShadowMethod) -> Result<(), RenderError> {
        let config = ShadowConfig { method, ..self.config };
        self.maps = shared_maps(gpu, (&self.things, &self.bounds, buffers), &config)?;
        self.config = config;
        Ok(())
    }

    /// Moves the objects: one placement per object of the scene, world from object.
    pub fn place(&mut self, placements: &[Affine3A]) {
        for things in [
            &mut self.things.phantoms,
            &mut self.things.virtuals,
            &mut self.things.everything,
        ] {
            things.place(placements);
        }
        self.bounds = self.things.bounds();
    }

    /// Changes an object's shape: the vertices of its mesh, in its own frame; to be followed by [`SceneShadows::place`].
    pub fn bend(&mut self, gpu: &Gpu, object: usize, moved: &[Vertex]) {
        for things in [
            &mut self.things.phantoms,
            &mut self.things.virtuals,
            &mut self.things.everything,
        ] {
            things.bend(object, moved);
        }
        if let Some(maps) = &mut self.maps {
            maps.bend(gpu, object, moved);
        }
    }

    /// Draws what all eyes share.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        frame: &ShadowFrame<'_>,
    ) {
        if let Some(maps) = &mut self.maps {
            maps.record(gpu, encoder, timer, (frame, &self.bounds));
        }
    }

    /// Draws the shadows and the light in an eye's picture, taken from `camera_from_world`; its surfaces have been drawn
    /// and submitted.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where the method cannot serve this light.
    pub fn record_eye(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (eye, frame, camera_from_world): (&mut EyeShadows, &ShadowFrame<'_>, &Pose),
    ) -> Result<(), RenderError> {
        match (&mut eye.0, &self.maps) {
            (Passes::Dome(dome), Some(maps)) => {
                dome.record(gpu, encoder, timer, maps);
                Ok(())
            }
            (Passes::Key(key), _) => key.record(gpu, encoder, timer, (frame, &self.things, camera_from_world)),
            (Passes::Path(path), _) => path.record(gpu, encoder, timer, (frame, &self.things)),
            // An eye that was made before the method changed shows the light as it was.
            (Passes::Dome(_), None) => Ok(()),
        }
    }
}

impl Things {
    fn bounds(&self) -> Bounds {
        let virtuals = self.virtuals.bounds();
        Bounds {
            virtuals,
            everything: enclosing(&[virtuals, self.everything.bounds()]).unwrap_or(virtuals),
        }
    }
}

fn shared_maps(
    gpu: &Gpu,
    (things, bounds, buffers): (&Things, &Bounds, &SceneBuffers),
    config: &ShadowConfig,
) -> Result<Option<SharedMaps>, RenderError> {
    match config.method.family() {
        Family::Dome => SharedMaps::new(gpu, (things, bounds, buffers), config).map(Some),
        Family::Path | Family::Key => Ok(None),
    }
}
