//! Shadows without cameras: a scene of virtual objects, a pinhole view, one light that can be moved, ambient light from
//! everywhere, and any shadow method.

mod dome_lights;
pub mod lamp;
pub mod meshes;
mod paths;
pub mod scenes;
pub mod shading;
pub mod show;
pub mod tone;
pub mod toys;
pub mod window;

use glam::{Affine3A, Vec3, Vec4};

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::scene::Scene;
use crate::scene_gpu::{IndexRange, SceneBuffers};
use crate::shadow::casters::Casters;
use crate::shadow::dome::{DomeCasters, DomeGather, DomeMaps, DomeSight, MapsJob};
use crate::shadow::key::{Job, KeyShadow};
use crate::shadow::light::ShadowLight;
use crate::shadow::path::PathSettings;
use crate::shadow::surface::{Surface, SurfacePass};
use crate::shadow::view::View;
use crate::shadow::{Family, ShadowMethod};
use mirrorball_calib::lights::LightTracker;
use paths::Paths;
use shading::Shading;

/// Edge of a one-light method's shadow map where nothing else is asked for, texels.
pub const MAP_SIZE: u32 = 1024;

/// Edge of a map of a dome, texels.
const DOME_MAP_SIZE: u32 = 256;

/// A scene on the GPU with all that is needed to draw it.
#[derive(Debug)]
pub struct Lab {
    gpu: Gpu,
    scene: Scene,
    placements: Vec<Affine3A>,
    buffers: SceneBuffers,
    everything: IndexRange,
    casters: Casters,
    surface_pass: SurfacePass,
    surface: Surface,
    light_buffer: wgpu::Buffer,
    visibility: wgpu::Texture,
    visibility_view: wgpu::TextureView,
    shading: Shading,
    timer: Timer,
    key: Option<(ShadowMethod, u32, Box<dyn KeyShadow>)>,
    paths: Paths,
    dome: Option<(ShadowMethod, LabDome)>,
    tracker: LightTracker,
    /// Whether objects or camera have moved since the last picture.
    is_moved: bool,
}

/// The passes of a dome method.
#[derive(Debug)]
struct LabDome {
    maps: DomeMaps,
    sight: DomeSight,
    gather: DomeGather,
}

/// A finished picture.
#[derive(Debug, Clone, PartialEq)]
pub struct LabPicture {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// Linear radiance, rows from the top; w: 1 where there is a surface.
    pub radiance: Vec<Vec4>,
    /// Milliseconds per pass, measured by the GPU.
    pub stages_ms: Vec<(&'static str, f64)>,
}

/// What is drawn.
#[derive(Debug, Clone, Copy)]
pub struct LabFrame<'a> {
    /// How shadows are drawn.
    pub method: ShadowMethod,
    /// Edge of shadow maps, texels.
    pub map_size: u32,
    /// The light.
    pub light: &'a ShadowLight,
    /// Radiance of the light that comes from everywhere alike, linear RGB.
    pub ambient: Vec3,
    /// Depth maps of a dome refreshed at most per picture, once all are drawn; the seeds' rule is 1.
    pub refreshes_max: usize,
}

impl Lab {
    /// Uploads a scene of virtual objects at `placements`, all of which cast and receive shadows.
    ///
    /// # Errors
    /// As [`SceneBuffers::placed`].
    pub fn new(gpu: Gpu, scene: Scene, placements: Vec<Affine3A>, view: &View) -> Result<Self, RenderError> {
        let buffers = SceneBuffers::placed(&gpu, &scene, &placements, f32::INFINITY)?;
        let all: Vec<usize> = (0..scene.objects.len()).collect();
        let everything = buffers.range(&gpu, "lab: everything", &all);
        let casters = Casters::new(&gpu, &buffers, (&scene, &placements), |_| true);
        let surface_pass = SurfacePass::new(&gpu);
        let surface = surface_pass.surface(&gpu, view, &buffers);
        let visibility = gpu.target("lab: visibility", TextureShape::plain(view.size_px), RADIANCE_FORMAT);
        let visibility_view = visibility.create_view(&wgpu::TextureViewDescriptor::default());
        let light_buffer = gpu.buffer(
            "lab: light",
            &[<crate::shadow::light::GpuShadowLight as bytemuck::Zeroable>::zeroed()],
        );
        let shading = Shading::new(&gpu, &surface, (&light_buffer, &visibility_view));
        Ok(Self {
            timer: Timer::new(&gpu),
            gpu,
            scene,
            placements,
            buffers,
            everything,
            casters,
            surface_pass,
            surface,
            light_buffer,
            visibility,
            visibility_view,
            shading,
            key: None,
            paths: Paths::default(),
            dome: None,
            tracker: dome_lights::stable_tracker(),
            is_moved: true,
        })
    }

    /// The graphics device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What casts shadows, where it stands now.
    #[must_use]
    pub fn casters(&self) -> &Casters {
        &self.casters
    }

    /// Moves the objects: one placement per object, world from object.
    pub fn place(&mut self, placements: &[Affine3A]) {
        self.placements.clear();
        self.placements.extend_from_slice(placements);
        self.buffers.place(&self.gpu, placements);
        self.casters.place(placements);
        self.paths.forget_places();
        self.is_moved = true;
    }

    /// Moves the camera; the picture keeps its size.
    pub fn set_view(&mut self, view: &View) {
        self.surface.set_view(&self.gpu, view);
        self.is_moved = true;
    }

    /// Draws a picture and leaves it on the GPU; returns milliseconds per pass. The path tracer takes
    /// [`PathSettings::default`]; [`Lab::path_traced`] takes others.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where the method cannot serve, [`RenderError::Gpu`] when the device is lost.
    pub fn draw(&mut self, frame: &LabFrame<'_>) -> Result<Vec<(&'static str, f64)>, RenderError> {
        self.prepare(frame)?;
        let gpu = &self.gpu;
        gpu.write(&self.light_buffer, &[frame.light.to_gpu()]);
        let is_dome = self.dome.is_some();
        self.shading.write(gpu, frame.ambient, is_dome);
        self.timer.start_frame();
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("lab") });
        let inputs = (&self.surface, &self.buffers, &self.everything);
        self.surface_pass.record(&mut encoder, &mut self.timer, inputs);
        match (&mut self.key, &mut self.dome) {
            (_, Some((method, dome))) => {
                let bounds = self.casters.bounds();
                let plan = dome_lights::plan(*method, (frame.light, frame.ambient), bounds, &mut self.tracker);
                let job = MapsJob {
                    lights: &plan.lights,
                    receivers: bounds,
                    everything: bounds,
                    is_moved: self.is_moved,
                    refreshes_max: frame.refreshes_max,
                };
                let timer = &mut self.timer;
                let refreshed = dome.maps.record(gpu, &mut encoder, timer, &job);
                dome.sight.record(gpu, &mut encoder, timer, (&dome.maps, refreshed));
                let from = method.unshaded_from();
                dome.gather
                    .record(gpu, &mut encoder, timer, (&dome.maps, plan.unshaded, from));
            }
            (Some((_, _, method)), None) => {
                let job = Job {
                    surface: &self.surface,
                    scene: &self.buffers,
                    casters: &self.casters,
                    receivers: &self.casters,
                    light: frame.light,
                    light_buffer: &self.light_buffer,
                    visibility: &self.visibility_view,
                };
                method.record(gpu, &mut encoder, &mut self.timer, &job)?;
            }
            (None, None) => self.shading.clear(&mut encoder, &self.visibility_view),
        }
        self.shading.record(&mut encoder, &mut self.timer);
        self.timer.record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        self.is_moved = false;
        gpu.wait("drawing the shadow scene")?;
        let mut stages_ms = self.timer.read_ms(gpu)?;
        if frame.method.family() == Family::Path {
            let target = self.shading.radiance_view();
            let picture = self.traced(frame, &PathSettings::default(), Some(&target))?;
            stages_ms.extend(picture.stages_ms);
        }
        Ok(stages_ms)
    }

    /// Makes the passes of the frame's method, unless they are the last frame's.
    fn prepare(&mut self, frame: &LabFrame<'_>) -> Result<(), RenderError> {
        let (method, map_size) = (frame.method, frame.map_size);
        if method.family() == Family::Dome {
            self.key = None;
            if self.dome.as_ref().is_none_or(|(m, _)| *m != method) {
                self.dome = Some((method, self.new_dome(method)?));
            }
            return Ok(());
        }
        self.dome = None;
        if self.key.as_ref().is_none_or(|(m, s, _)| (*m, *s) != (method, map_size)) {
            self.key = method
                .key_shadow(&self.gpu, map_size)?
                .map(|passes| (method, map_size, passes));
        }
        Ok(())
    }

    fn new_dome(&self, method: ShadowMethod) -> Result<LabDome, RenderError> {
        let (gpu, surface) = (&self.gpu, self.surface.views());
        let texel_m = 2.0 * self.casters.bounds().radius_m / DOME_MAP_SIZE as f32;
        let casters = DomeCasters::new(gpu, &self.casters, texel_m)?;
        let mode = method.ray_mode();
        let maps = DomeMaps::new(gpu, &self.buffers, casters, [method.dome_lights(), DOME_MAP_SIZE])?;
        let sight = DomeSight::new(gpu, surface, &maps, mode)?;
        let gather = DomeGather::new(gpu, surface, (&maps, &sight), (&self.visibility_view, mode));
        Ok(LabDome { maps, sight, gather })
    }

    /// Draws a picture and reads it back.
    ///
    /// # Errors
    /// As [`Lab::draw`].
    pub fn picture(&mut self, frame: &LabFrame<'_>) -> Result<LabPicture, RenderError> {
        let stages_ms = self.draw(frame)?;
        Ok(LabPicture {
            size_px: self.surface.view.size_px,
            radiance: self.shading.read(&self.gpu)?,
            stages_ms,
        })
    }

    /// The share of the light that the last picture's method let arrive, per pixel, rows from the top.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn visibility(&self) -> Result<Vec<f32>, RenderError> {
        let texels = self.gpu.read_half(&self.visibility)?;
        Ok(texels.iter().map(|texel| texel.x).collect())
    }

    /// Places of the last picture's surfaces, world, metres; w: 1 where there is one.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn places(&self) -> Result<Vec<Vec4>, RenderError> {
        self.gpu.read_float(&self.surface.place_texture)
    }
}
