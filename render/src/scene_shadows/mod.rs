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
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::passes::direct::ShadowedLight;
use crate::passes::lens_surface::LensSurface;
use crate::probe::Light;
use crate::scene::{Kind, Scene};
use crate::scene_gpu::SceneBuffers;
use crate::shadow::casters::Casters;
use crate::shadow::shadow_view::{Sphere, enclosing};
use crate::shadow::{Family, ShadowMethod};
use dome::DomeShadows;
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

/// The shadows of one scene in one camera's pictures.
#[derive(Debug)]
pub struct SceneShadows {
    method: ShadowMethod,
    config: ShadowConfig,
    things: Things,
    bounds: Bounds,
    phantoms: LensSurface,
    virtuals: LensSurface,
    light_on: [ShadowedLight; 2],
    passes: Passes,
    camera: Camera,
}

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
    /// The camera's pose.
    pub camera_from_world: &'a Pose,
}

impl SceneShadows {
    /// Shadows in pictures of the rig's scene camera, whose description is in the uniform buffer `camera`.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] or [`RenderError::Shadow`] where the adapter or the method cannot take the scene.
    pub fn new(
        gpu: &Gpu,
        (scene, buffers): (&Scene, &SceneBuffers),
        (rig, camera): (&Rig, &wgpu::Buffer),
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
        let bounds = Bounds {
            virtuals: things.virtuals.bounds(),
            everything: enclosing(&[things.virtuals.bounds(), things.everything.bounds()])
                .unwrap_or(things.virtuals.bounds()),
        };
        let size_px = rig.scene_camera().intrinsics.size_px;
        let surface = |label| LensSurface::new(gpu, label, (camera, buffers), size_px);
        let (phantoms, virtuals) = (
            surface("lens_surface: phantoms"),
            surface("lens_surface: virtual objects"),
        );
        let light_on = [&phantoms, &virtuals].map(|surface| {
            let target = |label| {
                let texture = gpu.target(label, TextureShape::plain(size_px), RADIANCE_FORMAT);
                texture.create_view(&wgpu::TextureViewDescriptor::default())
            };
            ShadowedLight {
                without: target("light past real things"),
                with_virtual: target("light past all things"),
                place: surface.views().place.clone(),
                normal: surface.views().normal.clone(),
            }
        });
        let surfaces = Surfaces {
            surfaces: [&phantoms, &virtuals],
            targets: &light_on,
        };
        let passes = Passes::new(
            gpu,
            (&things, &bounds, buffers),
            (surfaces, rig.scene_camera()),
            &config,
        )?;
        Ok(Self {
            method: config.method,
            passes,
            config,
            things,
            bounds,
            phantoms,
            virtuals,
            light_on,
            camera: rig.scene_camera().clone(),
        })
    }

    /// The method in use.
    #[must_use]
    pub fn method(&self) -> ShadowMethod {
        self.method
    }

    /// Changes the method; on failure the one in use stays.
    ///
    /// # Errors
    /// As [`SceneShadows::new`].
    pub fn set_method(&mut self, gpu: &Gpu, buffers: &SceneBuffers, method: ShadowMethod) -> Result<(), RenderError> {
        let config = ShadowConfig { method, ..self.config };
        let surfaces = Surfaces {
            surfaces: [&self.phantoms, &self.virtuals],
            targets: &self.light_on,
        };
        self.passes = Passes::new(
            gpu,
            (&self.things, &self.bounds, buffers),
            (surfaces, &self.camera),
            &config,
        )?;
        (self.method, self.config) = (method, config);
        Ok(())
    }

    /// Light from afar on the phantoms.
    #[must_use]
    pub fn on_phantoms(&self) -> &ShadowedLight {
        &self.light_on[0]
    }

    /// Light from afar on the virtual objects.
    #[must_use]
    pub fn on_virtuals(&self) -> &ShadowedLight {
        &self.light_on[1]
    }

    /// Draws surfaces, shadows and light.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where the method cannot serve this light.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        frame: &ShadowFrame<'_>,
    ) -> Result<(), RenderError> {
        if let Passes::Path(path) = &mut self.passes {
            let mut first = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("surfaces"),
            });
            let scene = frame.scene;
            self.phantoms.record(&mut first, timer, (scene, &scene.phantoms));
            self.virtuals.record(&mut first, timer, (scene, &scene.virtuals));
            gpu.queue.submit([first.finish()]);
            return path.record(gpu, encoder, timer, frame);
        }
        self.phantoms
            .record(encoder, timer, (frame.scene, &frame.scene.phantoms));
        self.virtuals
            .record(encoder, timer, (frame.scene, &frame.scene.virtuals));
        match &mut self.passes {
            Passes::Dome(dome) => {
                dome.record(gpu, encoder, timer, (frame, &self.bounds, self.method));
                Ok(())
            }
            Passes::Key(key) => key.record(gpu, encoder, timer, (frame, &self.things)),
            Passes::Path(_) => Ok(()),
        }
    }
}

/// The two surfaces with what is to be filled for each: phantoms, virtual objects.
#[derive(Debug, Clone, Copy)]
struct Surfaces<'a> {
    surfaces: [&'a LensSurface; 2],
    targets: &'a [ShadowedLight; 2],
}

impl Passes {
    fn new(
        gpu: &Gpu,
        (things, bounds, buffers): (&Things, &Bounds, &SceneBuffers),
        (surfaces, camera): (Surfaces<'_>, &Camera),
        config: &ShadowConfig,
    ) -> Result<Self, RenderError> {
        match config.method.family() {
            Family::Dome => {
                let dome = DomeShadows::new(gpu, (things, bounds, buffers), surfaces, config)?;
                Ok(Self::Dome(Box::new(dome)))
            }
            Family::Path => Ok(Self::Path(Box::new(PathShadows::new(gpu, things, surfaces)?))),
            Family::Key => {
                let key = KeyShadows::new(gpu, (buffers, camera), surfaces, config)?;
                Ok(Self::Key(Box::new(key)))
            }
        }
    }
}
