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
use crate::eye_view::{EyeView, eye_places_m};
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::gpu::types::GpuStrong;
use crate::insets::{Buffer, Insets, Sources};
use crate::light_maps::LightMaps;
use crate::look::sharpness::{Estimate, Sharpness};
use crate::measure::BlindView;
use crate::mode::Mode;
use crate::near::parts::Parts;
use crate::near::{NearInputs, NearThings};
use crate::passes::irradiance::Irradiance;
use crate::passes::local_environment::{self, LocalEnvironment};
use crate::passes::radiance_map::RadianceMap;
use crate::passes::reproject::room_buffer;
use crate::passes::room_mips::RoomMips;
use crate::passes::surroundings::Surroundings;
use crate::probe::meter::StrongLight;
use crate::probe::{Light, LightProbe};
use crate::scene::occluders::Occluders;
use crate::scene::{Kind, Lamp, Object, Scene, bounding_sphere};
use crate::scene_gpu::{PictureBuffers, SceneBuffers};
use crate::scene_rays::SceneRays;
use crate::scene_shadows::SceneShadows;
use crate::shadow::ShadowMethod;
use crate::tracker::{TrackedPose, Tracker};
use crate::whereabouts::Whereabouts;
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
    /// How it was made.
    pub mode: Mode,
    /// Columns and rows, all eyes side by side.
    pub size_px: [u32; 2],
    /// The picture, 8-bit RGBA, rows from the top: encoded as the camera encodes, in VR and optical modes in sRGB.
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
    /// The rig without markers that move.
    pub(crate) rig: Rig,
    /// The rig as it was given.
    pub(crate) given_rig: Rig,
    pub(crate) config: RenderConfig,
    pub(crate) work: Work,
    /// Frame sets that were compared with the rig.
    pub(crate) checked_sets: u32,
    pub(crate) occluders: Occluders,
    pub(crate) tracker: Tracker,
    pub(crate) sharpness: Sharpness,
    pub(crate) probe: LightProbe,
    /// Places that the probe was made for, world, metres.
    pub(crate) interest: Vec<Vec3>,
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
    /// What eyes share of the light between near things.
    pub(crate) near: NearThings,
    /// The pictures that are made, left to right.
    pub(crate) eyes: Vec<Eye>,
    /// Buffers that the picture shows.
    pub(crate) insets: Insets,
    /// Sphere on which real things stand that are no phantoms, uniform.
    pub(crate) room: wgpu::Buffer,
    pub(crate) scene: SceneBuffers,
    pub(crate) rays: SceneRays,
    /// What moves the objects.
    pub(crate) whereabouts: Whereabouts,
    /// Where they are at this frame, world from object, in the order of the scene.
    pub(crate) placements: Vec<Affine3A>,
    /// Virtual lamps.
    pub(crate) lamps: Vec<Lamp>,
    pub(crate) environments: Environments,
}

/// What a node is made from, but for its scene.
#[derive(Debug, Clone)]
pub struct NodeParts {
    /// The device.
    pub gpu: Gpu,
    /// The rig as it was given.
    pub rig: Rig,
    /// The settings.
    pub config: RenderConfig,
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
    pub(crate) surroundings: Surroundings,
    pub(crate) local_environment: LocalEnvironment,
    pub(crate) room_mips: RoomMips,
    pub(crate) light_maps: LightMaps,
    pub(crate) irradiance: Irradiance,
}

impl RenderNode {
    /// Prepares everything for a rig and a scene.
    ///
    /// # Errors
    /// [`RenderError::NoProbe`] when the rig has no light probe.
    pub fn new(gpu: Gpu, given_rig: Rig, scene: &Scene, config: RenderConfig) -> Result<Self, RenderError> {
        check_limits(&gpu, &given_rig)?;
        let rig = without_moving_markers(&given_rig, scene);
        let optics = ProbeOptics::of_rig(&rig)?;
        // The probe looks past phantoms that move: where they are now is not where they were.
        let occluders = phantoms(scene, &given_rig, |object| !object.movement.moves());
        let interest = points_of_interest(scene, &given_rig);
        let probe = LightProbe::new(&config, &rig, optics, &occluders, &interest);
        let buffers = SceneBuffers::new(&gpu, scene, &given_rig)?;
        let whereabouts = Whereabouts::new(scene, &given_rig);
        let placements = whereabouts.placements().to_vec();
        let rays = SceneRays::new(&gpu, &buffers, &placements)?;
        let environments = Environments::new(&gpu, scene, &given_rig, &phantoms(scene, &given_rig, |_| true));
        let seen = CameraView::new(&gpu, rig.scene_camera(), &buffers);
        let pictures = Pictures::new(&gpu, &rig, config.probe.cube_size);
        let shadows = SceneShadows::new(&gpu, (scene, &buffers), &given_rig, config.shadow)?;
        let passes = Passes::new(&gpu, &config, (&environments, &pictures), (&seen, &probe), &rays);
        let near = near_things(
            &gpu,
            (&seen, &buffers, &placements),
            (&environments, &pictures),
            (&occluders, &probe),
        );
        let room = room_buffer(&gpu, config.probe.room_distance_m);
        let eye_inputs = EyeInputs {
            view: &seen,
            scene: &buffers,
            rays: &rays,
            environments: &environments,
            probe_radiance: &pictures.radiance.view,
            near: &near,
            shadows: &shadows,
            light: config.light,
            protection: config.shadow.protection,
            phantom_edges: config.view.phantom_edges,
            mode: &config.mode,
        };
        let eyes = eyes(&gpu, eye_inputs, &room)?;
        Ok(Self {
            tracker: Tracker::new(&given_rig),
            sharpness: Sharpness::default(),
            timer: Timer::new(&gpu),
            light: None,
            measured: vec![None; rig.cameras.len()],
            ball_place: ball_place(&rig),
            given_light: None,
            light_age: 0,
            blind: None,
            gpu,
            rig,
            given_rig,
            config,
            work: Work::Everything,
            checked_sets: 0,
            occluders,
            probe,
            interest,
            shadows,
            pictures,
            passes,
            seen,
            near,
            eyes,
            insets: Insets::default(),
            room,
            scene: buffers,
            rays,
            whereabouts,
            placements,
            lamps: scene.lamps.clone(),
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

    /// The mode.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.config.mode.name
    }

    /// Shows these buffers from now on, in the first eye's picture; the first [`Insets::MOST`] of them.
    ///
    /// A frame without a pose or without light shows none: its buffers hold nothing of it.
    pub fn show(&mut self, buffers: &[Buffer]) {
        let sources = Sources {
            eye: &self.eyes[0],
            seen: &self.seen,
            environments: &self.environments,
            pictures: &self.pictures,
        };
        self.insets = Insets::new(&self.gpu, buffers, &sources);
    }

    /// The buffers that are shown.
    #[must_use]
    pub fn shown(&self) -> &[Buffer] {
        self.insets.buffers()
    }

    /// Columns and rows of finished pictures, all eyes side by side.
    #[must_use]
    pub fn size_px(&self) -> [u32; 2] {
        let [width, height] = match self.work {
            Work::Everything => self.eyes[0].finish.codes().size_px(),
            Work::LightOnly => return self.seen.size_px(),
        };
        [width * self.eyes.len() as u32, height]
    }

    /// What the node was made from.
    #[must_use]
    pub fn parts(&self) -> NodeParts {
        NodeParts {
            gpu: self.gpu.clone(),
            rig: self.given_rig.clone(),
            config: self.config,
        }
    }

    /// Goes on with what `before`, a node of the same rig, has measured and shows: with the light, with the blur of the
    /// pictures, with the clock and the markers of moving objects, with the buffers that are shown; with the probe where the
    /// phantoms that stand still and the places of the virtual objects are the same, else the light before stays until the
    /// new probe has measured. The node before is of no use afterwards.
    ///
    /// # Errors
    /// As [`RenderNode::set_shadow_method`]; `before` is then as it was.
    pub fn take_over(&mut self, before: &mut Self) -> Result<(), RenderError> {
        if before.shadow_method() != self.shadow_method() {
            self.set_shadow_method(before.shadow_method())?;
        }
        self.work = before.work;
        self.whereabouts.take_over(&before.whereabouts);
        self.checked_sets = before.checked_sets;
        self.light_age = before.light_age;
        self.light = before.light.take();
        self.given_light = before.given_light.take();
        self.ball_place = before.ball_place.take();
        self.blind = before.blind.take();
        let is_same_view =
            self.occluders.triangles() == before.occluders.triangles() && self.interest == before.interest;
        if is_same_view && self.rig == before.rig {
            std::mem::swap(&mut self.probe, &mut before.probe);
            std::mem::swap(&mut self.measured, &mut before.measured);
        }
        std::mem::swap(&mut self.sharpness, &mut before.sharpness);
        let shown = before.shown().to_vec();
        self.show(&shown);
        Ok(())
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

/// The scene camera as the only eye, or the mode's own eyes.
fn eyes(gpu: &Gpu, inputs: EyeInputs<'_>, room: &wgpu::Buffer) -> Result<Vec<Eye>, RenderError> {
    let places_m = eye_places_m(inputs.mode);
    if places_m.is_empty() {
        return Ok(vec![Eye::new(gpu, inputs, None)?]);
    }
    let limits = gpu.device.limits();
    let size_px = inputs.mode.eye_size_px.unwrap_or(inputs.view.size_px());
    let edge_px = size_px[0].max(size_px[1]);
    gpu.within(
        "an edge of an eye's picture in pixels (`mode.eye_size_px`)",
        u64::from(edge_px),
        u64::from(limits.max_texture_dimension_2d),
    )?;
    let own = |&eye_m: &[f64; 3]| EyeView::new(gpu, (inputs.view, room), inputs.scene, (inputs.mode, eye_m));
    places_m
        .iter()
        .map(|eye_m| Eye::new(gpu, inputs, Some(own(eye_m))))
        .collect()
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

impl Pictures {
    /// Room for the probes' pictures, and cubes of light of `cube_size` texels.
    fn new(gpu: &Gpu, rig: &Rig, cube_size: u32) -> Self {
        Self {
            probes: rig
                .cameras
                .iter()
                .map(|camera| (camera.role != Role::Scene).then(|| PictureBuffers::new(gpu, camera)))
                .collect(),
            radiance: CubeTexture::new(gpu, "light: radiance", cube_size),
            far: CubeTexture::new(gpu, "light: room", cube_size),
            behind: CubeTexture::new(gpu, "light: behind the strong lights", cube_size),
            strong: gpu.buffer("light: strong lights", &[<GpuStrong as bytemuck::Zeroable>::zeroed()]),
        }
    }
}

impl Passes {
    fn new(
        gpu: &Gpu,
        config: &RenderConfig,
        (environments, pictures): (&Environments, &Pictures),
        (seen, probe): (&CameraView, &LightProbe),
        rays: &SceneRays,
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
            room_mips: RoomMips::new(gpu, environments),
            surroundings: Surroundings::new(gpu, environments, rays),
            local_environment,
        }
    }
}

/// What eyes share of the light between near things.
fn near_things(
    gpu: &Gpu,
    (view, scene, placements): (&CameraView, &SceneBuffers, &[Affine3A]),
    (environments, pictures): (&Environments, &Pictures),
    (occluders, probe): (&Occluders, &LightProbe),
) -> NearThings {
    let parts = Parts::new(scene, placements, (occluders, probe.optics()));
    let inputs = NearInputs {
        view,
        scene,
        environments,
        probe_radiance: &pictures.radiance.view,
    };
    NearThings::new(gpu, inputs, &parts)
}

fn ball_place(rig: &Rig) -> Option<BallPlace> {
    let ball = rig.ball.as_ref()?;
    let sphere = MirrorBall {
        center_m: ball.center_m,
        radius_m: ball.radius_m,
    };
    Some(BallPlace::new(
        &sphere,
        Vec3::from_array(ball.reflectance.map(|r| r as f32)),
    ))
}

/// The rig with those markers only that stand still.
fn without_moving_markers(rig: &Rig, scene: &Scene) -> Rig {
    let moving = scene.moving_markers();
    let mut rig = rig.clone();
    rig.markers.retain(|marker| !moving.contains(&marker.id));
    rig
}

/// The triangles of the phantoms that are chosen, in the world at the first frame.
fn phantoms(scene: &Scene, rig: &Rig, is_chosen: impl Fn(&Object) -> bool) -> Occluders {
    let mut triangles = Vec::new();
    let chosen = |object: &&Object| object.kind == Kind::Phantom && is_chosen(object);
    for object in scene.objects.iter().filter(chosen) {
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

/// Places that light is wanted for: the middles of the virtual objects, wherever they go, and a little above.
fn points_of_interest(scene: &Scene, rig: &Rig) -> Vec<Vec3> {
    let around = |object: &Object| {
        let corners = object.mesh.vertices.iter().map(|v| Vec3::from(v.position));
        let base = object.world_from_placement(rig);
        let stops = match &object.movement.motion {
            Some(motion) => motion
                .stops_s()
                .iter()
                .map(|&s| base * motion.placement_from_object(s))
                .collect(),
            None => vec![base],
        };
        stops
            .iter()
            .map(|placement| bounding_sphere(corners.clone(), placement))
            .flat_map(|(center_m, radius_m)| [center_m, center_m + Vec3::Z * radius_m])
            .collect::<Vec<Vec3>>()
    };
    scene.virtual_objects().flat_map(|(_, object)| around(object)).collect()
}
