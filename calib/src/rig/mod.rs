//! The rig: its cameras, its markers and the mirror ball, read from `rig.toml`.

pub mod check;
mod draft;
pub mod drift;
mod error;
mod file;
mod parts;

use std::path::Path;

use glam::DVec3;

pub use draft::RigDraft;
pub use error::{Place, RigError};
pub use parts::{PartialCamera, RigParts};

use crate::{camera::Intrinsics, photometry::Photometry, pose::Pose, tag::Family};

/// The rig as calibrated. A value of this type has passed every check: one scene camera, any number of probe cameras, at
/// least one marker, the main marker at the origin, names and ids unique, every number in range.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Id of the marker whose frame is the world.
    pub main_marker: u32,
    /// The scene camera and the probe cameras, if there are any; in the order of the file.
    pub cameras: Vec<Camera>,
    /// All markers, in the order of the file; never empty.
    pub markers: Vec<Marker>,
    /// The mirror ball; always there when no camera has the role [`Role::Fisheye`].
    pub ball: Option<Ball>,
}

/// One camera of the rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name, unique in the rig; recordings refer to it.
    pub name: String,
    /// What the camera is for.
    pub role: Role,
    /// Ray to pixel.
    pub intrinsics: Intrinsics,
    /// Radiance to pixel code.
    pub photometry: Photometry,
    /// Where a fixed camera stands; `None` for the scene camera, which moves.
    pub camera_from_world: Option<Pose>,
}

/// What a camera is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Moves, sees the markers; its picture is augmented.
    Scene,
    /// Fixed, films the mirror ball.
    Ball,
    /// Fixed, films the surroundings through a fisheye lens.
    Fisheye,
}

/// A printed marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Family that the code belongs to.
    pub family: Family,
    /// Number of the code in its family.
    pub id: u32,
    /// Side of the black square in metres.
    pub side_m: f64,
    /// Diffuse reflectance of the white paper around the marker, above 0, at most 1.
    pub white_reflectance: f64,
    /// Where the marker is. Its own frame: origin at its centre, x right and y up as printed, z out of the paper.
    pub world_from_marker: Pose,
}

/// The mirror ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Centre in the world, in metres.
    pub center_m: DVec3,
    /// Radius in metres.
    pub radius_m: f64,
    /// Reflectance for linear red, green and blue at all angles, above 0, at most 1.
    pub reflectance: [f64; 3],
    /// Perceptual roughness, 0 (a mirror) to 1.
    pub roughness: f64,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 3] = [Self::Scene, Self::Ball, Self::Fisheye];

    /// Name, as in rig files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Ball => "ball",
            Self::Fisheye => "fisheye",
        }
    }
}

impl Rig {
    /// Reads the text of a rig file. `file` is its name, for error messages only: nothing is opened.
    ///
    /// # Errors When the text is no TOML, a key is unknown or missing, or a value is not allowed; the error names
    /// file, line, key and what is allowed.
    pub fn from_toml(text: &str, file: &Path) -> Result<Self, RigError> {
        file::read(text, file)
    }

    /// The camera that moves and sees the markers.
    #[must_use]
    pub fn scene_camera(&self) -> &Camera {
        self.cameras
            .iter()
            .find(|camera| camera.role == Role::Scene)
            .expect("a rig has exactly one scene camera")
    }

    /// The first of the fixed cameras that film the light, if the rig has one.
    #[must_use]
    pub fn probe_camera(&self) -> Option<&Camera> {
        self.probe_cameras().next()
    }

    /// The fixed cameras that film the light, through a fisheye lens or on the ball, in the order of the file.
    pub fn probe_cameras(&self) -> impl Iterator<Item = &Camera> {
        self.cameras.iter().filter(|camera| camera.role != Role::Scene)
    }

    /// The camera with this name.
    #[must_use]
    pub fn camera(&self, name: &str) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.name == name)
    }

    /// The marker with this id.
    #[must_use]
    pub fn marker(&self, id: u32) -> Option<&Marker> {
        self.markers.iter().find(|marker| marker.id == id)
    }
}

impl Marker {
    /// The corners of the black square in the world, in metres: bottom-left, bottom-right, top-right, top-left of the
    /// upright marker.
    #[must_use]
    pub fn corners_world(&self) -> [DVec3; 4] {
        let half = 0.5 * self.side_m;
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(x, y)| self.world_from_marker.transform_point(DVec3::new(x, y, 0.0)))
    }
}
