//! Whether pictures come from the cameras that the rig says they come from.
//!
//! The markers tell: the scene camera sees them, and a fixed camera that sees any must see them where it stands.

use mirrorball_capture::frame::Frame;

use super::{Camera, Rig, Role};
use crate::{
    pose::Pose,
    resection::{self, Located},
    tag::{Family, Finder, PictureError},
};

/// Distance from its calibrated place, relative to its distance from the markers, at which a fixed camera has moved; ten
/// times what markers of 20 pixels leave open.
const MOVED_RELATIVE: f64 = 0.05;
/// The same at short distances, metres.
const MOVED_M: f64 = 0.02;
/// Angle from its calibrated direction at which a fixed camera has turned, degrees.
const TURNED_DEG: f64 = 3.0;

/// How pictures contradict the rig.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigMismatch {
    /// Two cameras' pictures have each other's size.
    #[error(
        "cameras `{scene}` and `{probe}` are exchanged: a picture of one has the size of the other (`{scene}` has `{}×{}` pixels, \
         `{probe}` `{}×{}`)",
        scene_px[0], scene_px[1], probe_px[0], probe_px[1]
    )]
    SizesExchanged {
        /// The scene camera.
        scene: String,
        /// The fixed camera.
        probe: String,
        /// Columns and rows of the scene camera.
        scene_px: [u32; 2],
        /// Columns and rows of the fixed camera.
        probe_px: [u32; 2],
    },
    /// The fixed camera sees the markers as the scene camera would, which sees none.
    #[error(
        "cameras `{scene}` and `{probe}` are exchanged: none of `{frames}` pictures of `{scene}` shows markers to locate it \
         by, but `{found}` of `{probe}` do, where it does not stand"
    )]
    Exchanged {
        /// The scene camera.
        scene: String,
        /// The fixed camera.
        probe: String,
        /// Pictures of the scene camera.
        frames: usize,
        /// Pictures of the fixed camera with such markers.
        found: usize,
    },
    /// A fixed camera sees the markers, but not from where it stands.
    #[error(
        "fixed camera `{camera}` is `{distance_m:.3} m` and `{angle_deg:.1}°` from its `camera_from_world` \
         (allowed: `{allowed_m:.3} m`, `{TURNED_DEG}°`)"
    )]
    Moved {
        /// The fixed camera.
        camera: String,
        /// Distance between where it is and where the rig file has it, metres.
        distance_m: f64,
        /// Angle between both, degrees.
        angle_deg: f64,
        /// Distance allowed, metres.
        allowed_m: f64,
    },
}

impl RigMismatch {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::SizesExchanged { .. } | Self::Exchanged { .. } => {
                "exchange the two names: in `frames.csv`, or `device` or `card` of the two cameras in `capture.toml`"
            }
            Self::Moved { .. } => "put the camera back, or calibrate the rig again and enter its `camera_from_world`",
        }
    }
}

/// Looks at the first pictures of every camera and compares them with the rig.
pub struct RigCheck<'a> {
    rig: &'a Rig,
    finder: Finder,
    scene: SceneTally,
    probes: Vec<ProbeTally<'a>>,
}

/// Sizes of one camera's pictures.
#[derive(Debug, Clone, Copy, Default)]
struct Sizes {
    n_right: usize,
    /// A size that its pictures should not have.
    wrong_px: Option<[u32; 2]>,
}

impl Sizes {
    /// Takes a picture's size in; gives whether it is right.
    fn add(&mut self, size_px: [u32; 2], camera: &Camera) -> bool {
        let is_right = size_px == camera.intrinsics.size_px;
        if is_right {
            self.n_right += 1;
        } else {
            self.wrong_px = Some(size_px);
        }
        is_right
    }

    /// Whether all pictures so far have the size of `other`.
    fn are_those_of(&self, other: &Camera) -> bool {
        self.n_right == 0 && self.wrong_px.is_none_or(|size_px| size_px == other.intrinsics.size_px)
    }
}

#[derive(Debug, Default)]
struct SceneTally {
    sizes: Sizes,
    located: usize,
}

struct ProbeTally<'a> {
    camera: &'a Camera,
    camera_from_world: Pose,
    sizes: Sizes,
    /// Pictures that locate it where it stands.
    in_place: usize,
    /// Pictures that contradict its place, through its own lens or, if that explains nothing, through the scene camera's.
    contradictions: usize,
    /// The first contradiction through its own lens.
    moved: Option<RigMismatch>,
}

impl<'a> RigCheck<'a> {
    /// A check that has seen nothing yet.
    #[must_use]
    pub fn new(rig: &'a Rig) -> Self {
        let mut families: Vec<Family> = rig.markers.iter().map(|marker| marker.family).collect();
        families.sort();
        families.dedup();
        let probe = |camera: &'a Camera| {
            Some(ProbeTally {
                camera,
                camera_from_world: camera.camera_from_world?,
                sizes: Sizes::default(),
                in_place: 0,
                contradictions: 0,
                moved: None,
            })
        };
        Self {
            rig,
            finder: Finder::new(&families),
            scene: SceneTally::default(),
            probes: rig.probe_cameras().filter_map(probe).collect(),
        }
    }

    /// Takes a picture (8-bit RGB) in; one of a camera that the rig does not have is ignored.
    ///
    /// # Errors
    /// When its bytes are no picture of the size that it says it has. A size that is not its camera's is no error: it says
    /// something.
    pub fn add(&mut self, frame: &Frame) -> Result<(), PictureError> {
        let Some(camera) = self.rig.camera(&frame.meta.camera) else {
            return Ok(());
        };
        let size_px = [frame.size.width, frame.size.height];
        if !self.add_size(&camera.name, size_px) {
            return Ok(());
        }
        let own = self.locate(frame, camera)?;
        if camera.role == Role::Scene {
            self.scene.located += usize::from(own.is_some());
            return Ok(());
        }
        let scene = self.rig.scene_camera();
        let is_like_scene =
            own.is_none() && size_px == scene.intrinsics.size_px && self.locate(frame, scene)?.is_some();
        if let Some(probe) = self.probe(&camera.name) {
            probe.add(own, is_like_scene);
        }
        Ok(())
    }

    /// Takes a picture's columns and rows in, where there is nothing more of it; gives whether they are right.
    pub fn add_size(&mut self, camera: &str, size_px: [u32; 2]) -> bool {
        let Some(camera) = self.rig.camera(camera) else {
            return false;
        };
        match camera.role {
            Role::Scene => self.scene.sizes.add(size_px, camera),
            Role::Ball | Role::Fisheye => self
                .probe(&camera.name)
                .is_some_and(|probe| probe.sizes.add(size_px, camera)),
        }
    }

    /// What the pictures so far say.
    ///
    /// # Errors
    /// How they contradict the rig.
    pub fn verdict(&self) -> Result<(), RigMismatch> {
        let scene = self.rig.scene_camera();
        for probe in &self.probes {
            let sizes = (self.scene.sizes, probe.sizes);
            if sizes.0.wrong_px.or(sizes.1.wrong_px).is_some()
                && sizes.0.are_those_of(probe.camera)
                && sizes.1.are_those_of(scene)
            {
                return Err(RigMismatch::SizesExchanged {
                    scene: scene.name.clone(),
                    probe: probe.camera.name.clone(),
                    scene_px: scene.intrinsics.size_px,
                    probe_px: probe.camera.intrinsics.size_px,
                });
            }
            if probe.contradictions <= probe.in_place {
                continue;
            }
            if self.scene.located == 0 && self.scene.sizes.n_right > 0 {
                return Err(RigMismatch::Exchanged {
                    scene: scene.name.clone(),
                    probe: probe.camera.name.clone(),
                    frames: self.scene.sizes.n_right,
                    found: probe.contradictions,
                });
            }
            if let Some(moved) = &probe.moved {
                return Err(moved.clone());
            }
        }
        Ok(())
    }

    fn probe(&mut self, name: &str) -> Option<&mut ProbeTally<'a>> {
        self.probes.iter_mut().find(|probe| probe.camera.name == name)
    }

    fn locate(&mut self, frame: &Frame, camera: &Camera) -> Result<Option<Located>, PictureError> {
        let size = [frame.size.width as usize, frame.size.height as usize];
        let detections = self.finder.find(&frame.pixels, size, camera)?;
        Ok(resection::locate(&detections, self.rig, &camera.intrinsics).ok())
    }
}

impl ProbeTally<'_> {
    fn add(&mut self, own: Option<Located>, is_like_scene: bool) {
        let Some(located) = own else {
            self.contradictions += usize::from(is_like_scene);
            return;
        };
        let is_from_should = located.camera_from_world * self.camera_from_world.inverse();
        let place_m = located.camera_from_world.inverse().translation;
        let distance_m = place_m.distance(self.camera_from_world.inverse().translation);
        // The angle of a rotation from its trace, 1 + 2 cos.
        let rotation = is_from_should.rotation;
        let trace = rotation.x_axis.x + rotation.y_axis.y + rotation.z_axis.z;
        let angle_deg = (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos().to_degrees();
        let allowed_m = (MOVED_RELATIVE * place_m.length()).max(MOVED_M) + 3.0 * located.position_sigma_m;
        if distance_m <= allowed_m && angle_deg <= TURNED_DEG {
            self.in_place += 1;
            return;
        }
        self.contradictions += 1;
        self.moved.get_or_insert(RigMismatch::Moved {
            camera: self.camera.name.clone(),
            distance_m,
            angle_deg,
            allowed_m,
        });
    }
}
