//! The render node: everything that lasts from frame to frame.

use glam::{Affine3A, Vec3};
use mirrorball_calib::rig::check::RigCheck;
use mirrorball_calib::rig::{Camera, Rig, Role};
use mirrorball_capture::frame::{Frame, FrameSet};

use crate::ball_place::BallPlace;
use crate::camera_view::CameraView;
use crate::config::RenderConfig;
use crate::environments::{CubeTexture, Environments};
use crate::error::RenderError;
use crate::eye::{Eye, EyeInputs};
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::gpu::types::GpuStrong;
use crate::light_maps::LightMaps;
use crate::look::sharpness::{Estimate, Sharpness};
use crate::measure::BlindView;
use crate::passes::irradiance::Irradiance;
use crate::passes::local_environment::{self, LocalEnvironment};
use crate::passes::radiance_map::RadianceMap;
use crate::probe::meter::StrongLight;
use crate::probe::{Light, LightProbe};
use crate::scene::occluders::Occluders;
use crate::scene::{Kind, Scene};
use crate::scene_gpu::{PictureBuffers, SceneBuffers};
use crate::scene_rays::SceneRays;
use crate::scene_shadows::SceneShadows;
use crate::shadow::ShadowMethod;
use crate::tracker::{TrackedPose, Tracker};
use mirrorball_calib::probe::ProbeOptics;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::mirror_ball::MirrorBall;
use mirrorball_calib::probe::radiance::luminance;

/// A finished frame.
#[derive(Debug, Clone)]
pub struct RenderedFrame {
    /// Sequence number of the scene camera's frame.
    pub sequence: u64,
    /// Its time stamp, nanoseconds.
    pub timestamp_ns: u64,
    /// Where the scene camera was.
    pub pose: TrackedPose,
    /// The light it was rendered with; `None` before any was measured: the picture is the camera's own then.
    pub light: Option<LightReport>,
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// The picture, 8-bit RGBA, rows from the top, encoded as the camera encodes.
    pub rgba: Vec<u8>,
    /// Milliseconds: `track`, `look`, `light`, `draw` and `total` by the clock, then every pass by the GPU under its own name.
    pub stages_ms: Vec<(&'static str, f64)>,
}

/// What a node does with frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// Light and pictures.
    Everything,
    /// Pose and light; the pictures come back as the camera took them.
    LightOnly,
}

/// What is known about the light of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LightReport {
    /// Frames since the light was last measured; 0 for this very frame.
    pub age_frames: u64,
    /// The camera that showed nothing of the light when it was last looked at, and why.
    pub blind: Option<(String, BlindView)>,
    /// Readings off papers and off patches of phantoms.
    pub readings: [usize; 2],
    /// Median relative difference between the papers' readings and what explains them.
    pub residual: f32,
    /// Distance in metres that the ball's outline moved the ball by; `None` without a ball.
    pub ball_shift_m: Option<f64>,
    /// The strong lights.
    pub strong: Vec<StrongReport>,
}

/// A strong light: a lamp, a window, a bright ceiling.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrongReport {
    /// Unit direction from the probe, weighted by radiance, world frame.
    pub direction: Vec3,
    /// Distance from the probe, metres.
    pub distance_m: f32,
    /// Standard deviation of the distance's logarithm; infinite where nothing tells it.
    pub distance_sigma: f32,
    /// Irradiance that it gives a surface at the probe that faces it, linear RGB.
    pub irradiance: Vec3,
    /// Solid angle, steradians.
    pub area_sr: f32,
}

/// The render node.
#[derive(Debug)]
pub struct RenderNode {
    pub(crate) gpu: Gpu,
    pub(crate) rig: Rig,
    pub(crate) config: RenderConfig,
    pub(crate) work: Work,
    /// Frame sets that were compared with the rig.
    pub(crate) checked_sets: u32,
    pub(crate) occluders: Occluders,
    pub(crate) tracker: Tracker,
    pub(crate) sharpness: Sharpness,
    pub(crate) probe: LightProbe,
    pub(crate) light: Option<Light>,
    /// Per camera of the rig, the last frame that was taken into the light.
    pub(crate) measured: Vec<Option<MeasuredFrame>>,
    /// The mirror ball, if the rig has one.
    pub(crate) ball_place: Option<BallPlace>,
    /// A map in place of the measured light.
    pub(crate) given_light: Option<Cube<Vec3>>,
    /// Frames since the light was last measured.
    pub(crate) light_age: u64,
    /// The camera that last showed nothing of the light, and why.
    pub(crate) blind: Option<(String, BlindView)>,
    pub(crate) timer: Timer,
    pub(crate) shadows: SceneShadows,
    pub(crate) pictures: Pictures,
    pub(crate) passes: Passes,
    /// What the scene camera sees.
    pub(crate) seen: CameraView,
    /// The pictures that are made.
    pub(crate) eyes: Vec<Eye>,
    pub(crate) scene: SceneBuffers,
    pub(crate) rays: SceneRays,
    /// Where the objects stand, world from object, in the order of the scene.
    pub(crate) placements: Vec<Affine3A>,
    pub(crate) environments: Environments,
}

/// A probe frame that was taken in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MeasuredFrame {
    pub(crate) sequence: u64,
    pub(crate) timestamp_ns: u64,
    /// Whether the scene camera's pose was known, so that papers could be read.
    pub(crate) with_pose: bool,
}

/// Pictures of the fixed cameras and light cubes on the GPU.
#[derive(Debug)]
pub(crate) struct Pictures {
    /// Of every camera of the rig that stands still.
    pub(crate) probes: Vec<Option<PictureBuffers>>,
    pub(crate) radiance: CubeTexture,
    pub(crate) far: CubeTexture,
    pub(crate) behind: CubeTexture,
    pub(crate) strong: wgpu::Buffer,
}

/// The passes that all eyes share, in their order.
#[derive(Debug)]
pub(crate) struct Passes {
    pub(crate) radiance_map: RadianceMap,
    pub(crate) local_environment: LocalEnvironment,
    pub(crate) light_maps: LightMaps,
    pub(crate) irradiance: Irradiance,
}

impl RenderNode {
    /// Prepares everything for a rig and a scene.
    ///
    /// # Errors
    /// [`RenderError::NoProbe`] when the rig has no light probe.
    pub fn new(gpu: Gpu, rig: Rig, scene: &Scene, config: RenderConfig) -> Result<Self, RenderError> {
        check_limits(&gpu, &rig)?;
        let optics = ProbeOptics::of_rig(&rig)?;
        let occluders = phantoms(scene, &rig);
        let probe = LightProbe::new(&config, &rig, optics, &occluders, &points_of_interest(scene, &rig));
        let buffers = SceneBuffers::new(&gpu, scene, &rig)?;
        let placements: Vec<Affine3A> = scene.objects.iter().map(|o| o.world_from_object(&rig)).collect();
        let rays = SceneRays::new(&gpu, &buffers, &placements)?;
        let environments = Environments::new(&gpu, scene, &rig, &occluders);
        let seen = CameraView::new(&gpu, rig.scene_camera(), &buffers);
        let cube_size = config.probe.cube_size;
        let pictures = Pictures {
            probes: rig
                .cameras
                .iter()
                .map(|camera| (camera.role != Role::Scene).then(|| PictureBuffers::new(&gpu, camera)))
                .collect(),
            radiance: CubeTexture::new(&gpu, "light: radiance", cube_size),
            far: CubeTexture::new(&gpu, "light: room", cube_size),
            behind: CubeTexture::new(&gpu, "light: behind the strong lights", cube_size),
            strong: gpu.buffer("light: strong lights", &[<GpuStrong as bytemuck::Zeroable>::zeroed()]),
        };
        let shadows = SceneShadows::new(&gpu, (scene, &buffers), &rig, config.shadow)?;
        let passes = Passes::new(&gpu, &config, (&environments, &pictures), (&seen, &probe));
        let eye = Eye::new(
            &gpu,
            EyeInputs {
                view: &seen,
                scene: &buffers,
                rays: &rays,
                environments: &environments,
                probe_radiance: &pictures.radiance.view,
                shadows: &shadows,
                light: config.light,
            },
        )?;
        Ok(Self {
            tracker: Tracker::new(&rig),
            sharpness: Sharpness::default(),
            timer: Timer::new(&gpu),
            light: None,
            measured: vec![None; rig.cameras.len()],
            ball_place: rig.ball.as_ref().map(|ball| {
                let sphere = MirrorBall {
                    center_m: ball.center_m,
                    radius_m: ball.radius_m,
                };
                BallPlace::new(&sphere, Vec3::from_array(ball.reflectance.map(|r| r as f32)))
            }),
            given_light: None,
            light_age: 0,
            blind: None,
            gpu,
            rig,
            config,
            work: Work::Everything,
            checked_sets: 0,
            occluders,
            probe,
            shadows,
            pictures,
            passes,
            seen,
            eyes: vec![eye],
            scene: buffers,
            rays,
            placements,
            environments,
        })
    }

    /// The node, doing this with frames from now on.
    #[must_use]
    pub fn with_work(self, work: Work) -> Self {
        Self { work, ..self }
    }

    /// The node, lit from now on by a map (linear radiance, world frame, infinitely far away) instead of what it measures.
    #[must_use]
    pub fn with_light(self, radiance: Cube<Vec3>) -> Self {
        Self {
            given_light: Some(radiance),
            ..self
        }
    }

    /// The shadow method in use.
    #[must_use]
    pub fn shadow_method(&self) -> ShadowMethod {
        self.shadows.method()
    }

    /// Changes the shadow method; on failure the one in use stays.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] or [`RenderError::TooLarge`] where the method cannot take this scene on this adapter.
    pub fn set_shadow_method(&mut self, method: ShadowMethod) -> Result<(), RenderError> {
        let before = self.shadows.method();
        self.shadows.set_method(&self.gpu, &self.scene, method)?;
        let mut renew = |shadows: &SceneShadows| {
            self.eyes
                .iter_mut()
                .try_for_each(|eye| eye.renew_shadows(&self.gpu, (&self.seen, &self.scene), shadows))
        };
        if let Err(error) = renew(&self.shadows) {
            self.shadows.set_method(&self.gpu, &self.scene, before)?;
            renew(&self.shadows)?;
            return Err(error);
        }
        Ok(())
    }

    /// Name of the graphics adapter.
    #[must_use]
    pub fn adapter_name(&self) -> &str {
        &self.gpu.name
    }

    /// The graphics device, for a window that shows the pictures.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The light as last measured.
    #[must_use]
    pub fn light(&self) -> Option<&Light> {
        self.light.as_ref()
    }

    /// How blurred the scene camera's pictures are; `None` before that was measured, or with `look.sharpness = "off"`.
    #[must_use]
    pub fn sharpness(&self) -> Option<Estimate> {
        self.sharpness.estimate()
    }

    /// What is known about the light now; `None` before any was measured.
    #[must_use]
    pub fn light_report(&self) -> Option<LightReport> {
        let light = self.light.as_ref()?;
        Some(LightReport {
            age_frames: self.light_age,
            blind: self.blind.clone(),
            readings: [light.meter.papers, light.meter.patches],
            residual: light.meter.residual,
            ball_shift_m: self.ball_place.as_ref().map(|place| place.shift_m().length()),
            strong: light.meter.lights.iter().map(|of| strong_report(light, of)).collect(),
        })
    }

    /// The light at each virtual object as the renderer uses it there: name and radiance cube.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn local_light(&self) -> Result<Vec<(String, Cube<Vec3>)>, RenderError> {
        self.environments.read(&self.gpu)
    }

    /// Looks at the first frame sets for cameras that are exchanged or have moved.
    pub(crate) fn check_rig(&mut self, set: &FrameSet) -> Result<(), RenderError> {
        /// A set in which the markers cannot be seen tells nothing, so a few are asked.
        const CHECKED_SETS: u32 = 3;
        if self.checked_sets >= CHECKED_SETS || self.rig.probe_camera().is_none() {
            return Ok(());
        }
        self.checked_sets += 1;
        let mut check = RigCheck::new(&self.rig);
        for frame in &set.frames {
            // A picture of the wrong size is refused with its own error, where it is used.
            let _ = check.add(frame);
        }
        Ok(check.verdict()?)
    }

    /// The scene camera's frame of a set, checked against the rig.
    pub(crate) fn scene_frame<'a>(&self, set: &'a FrameSet) -> Result<&'a Frame, RenderError> {
        let camera = self.rig.scene_camera();
        let frame = set.camera(&camera.name).ok_or_else(|| RenderError::NoSceneFrame {
            camera: camera.name.clone(),
        })?;
        check_size(frame, camera)?;
        Ok(frame)
    }
}

fn strong_report(light: &Light, of: &StrongLight) -> StrongReport {
    let (mut direction, mut irradiance, mut area_sr) = (Vec3::ZERO, Vec3::ZERO, 0.0);
    for &texel in &of.texels {
        let texel_sr = light.far.solid_angle(texel);
        let radiance = light.far.texels()[texel];
        direction += light.far.direction(texel) * luminance(radiance) * texel_sr;
        irradiance += radiance * texel_sr;
        area_sr += texel_sr;
    }
    StrongReport {
        direction: direction.normalize_or(Vec3::Z),
        distance_m: of.distance_m,
        distance_sigma: of.distance_sigma,
        irradiance,
        area_sr,
    }
}

/// Refuses what the adapter cannot hold and lenses that cannot be drawn through.
fn check_limits(gpu: &Gpu, rig: &Rig) -> Result<(), RenderError> {
    /// Beyond this a vertex behind the image plane can still be in the picture.
    const WIDEST_RAD: f64 = 80.0 * std::f64::consts::PI / 180.0;
    let limits = gpu.device.limits();
    for camera in &rig.cameras {
        let [width, height] = camera.intrinsics.size_px.map(u64::from);
        gpu.within(
            "a picture edge in pixels",
            width.max(height),
            u64::from(limits.max_texture_dimension_2d),
        )?;
        gpu.within(
            "a picture in bytes",
            4 * width * height,
            limits.max_storage_buffer_binding_size,
        )?;
    }
    let camera = rig.scene_camera();
    let angle = camera.intrinsics.largest_angle_rad();
    if camera.intrinsics.lens.model().is_fisheye() && angle > WIDEST_RAD {
        return Err(RenderError::LensTooWide {
            camera: camera.name.clone(),
            angle_deg: angle.to_degrees(),
        });
    }
    Ok(())
}

pub(crate) fn check_size(frame: &Frame, camera: &Camera) -> Result<(), RenderError> {
    let found = [frame.size.width, frame.size.height];
    if found == camera.intrinsics.size_px && frame.pixels.len() == 3 * frame.size.pixels() {
        return Ok(());
    }
    Err(RenderError::FrameSize {
        camera: camera.name.clone(),
        sequence: frame.meta.sequence,
        found,
        expected: camera.intrinsics.size_px,
    })
}

impl Passes {
    fn new(
        gpu: &Gpu,
        config: &RenderConfig,
        (environments, pictures): (&Environments, &Pictures),
        (seen, probe): (&CameraView, &LightProbe),
    ) -> Self {
        let sampler = gpu.linear_sampler();
        let local_environment = LocalEnvironment::new(
            gpu,
            environments,
            local_environment::Inputs {
                camera: &seen.camera,
                response: &seen.picture.response,
                picture: &seen.picture.view,
                camera_places: seen.phantoms.views().place,
                probe_radiance: &pictures.radiance.view,
                far_faces: &pictures.far.faces,
                behind_radiance: &pictures.behind.view,
                strong: &pictures.strong,
                sampler: &sampler,
            },
        );
        Self {
            radiance_map: RadianceMap::new(gpu, probe.near_m()),
            light_maps: LightMaps::new(gpu, environments, &config.light, (&seen.camera, &sampler)),
            irradiance: Irradiance::new(gpu, environments),
            local_environment,
        }
    }
}

/// The phantoms' triangles in the world.
fn phantoms(scene: &Scene, rig: &Rig) -> Occluders {
    let mut triangles = Vec::new();
    for object in scene.objects.iter().filter(|o| o.kind == Kind::Phantom) {
        let world_from_object = object.world_from_object(rig);
        for triangle in object.mesh.indices.chunks_exact(3) {
            triangles.push([0, 1, 2].map(|i| {
                let vertex = &object.mesh.vertices[triangle[i] as usize];
                world_from_object.transform_point3(Vec3::from(vertex.position))
            }));
        }
    }
    Occluders::new(triangles)
}

/// Places that light is wanted for: the middles of the virtual objects and a little above.
fn points_of_interest(scene: &Scene, rig: &Rig) -> Vec<Vec3> {
    scene
        .virtual_objects()
        .flat_map(|(_, object)| {
            let (center_m, radius_m) = object.bounding_sphere(rig);
            [center_m, center_m + Vec3::Z * radius_m]
        })
        .collect()
}
