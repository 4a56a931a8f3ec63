//! A rig that is not finished: what has been measured so far.

use std::path::Path;

use super::{Ball, Marker, Rig, RigError, Role, file};
use crate::{camera::Intrinsics, photometry::Photometry, pose::Pose};

/// What a rig file holds while the rig is being calibrated. Every part that is there has passed the checks that a [`Rig`]'s
/// must pass, and names and ids are unique; any part may be missing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RigParts {
    /// Id of the marker whose frame is the world.
    pub main_marker: Option<u32>,
    /// Cameras, in the order of the file.
    pub cameras: Vec<PartialCamera>,
    /// Markers, in the order of the file.
    pub markers: Vec<Marker>,
    /// The mirror ball.
    pub ball: Option<Ball>,
}

/// A camera of which not everything need be known.
#[derive(Debug, Clone, PartialEq)]
pub struct PartialCamera {
    /// Name, unique in the rig.
    pub name: String,
    /// What the camera is for.
    pub role: Role,
    /// Width and height of its pictures in pixels.
    pub size_px: [u32; 2],
    /// Ray to pixel.
    pub intrinsics: Option<Intrinsics>,
    /// Radiance to pixel code.
    pub photometry: Option<Photometry>,
    /// Where a fixed camera stands.
    pub camera_from_world: Option<Pose>,
}

impl RigParts {
    /// Reads what there is of a rig file. `file` is its name, for error messages only: nothing is opened.
    ///
    /// # Errors
    /// As [`Rig::from_toml`], but for what is missing.
    pub fn from_toml(text: &str, file: &Path) -> Result<Self, RigError> {
        file::read_parts(text, file)
    }

    /// The camera with this name.
    #[must_use]
    pub fn camera(&self, name: &str) -> Option<&PartialCamera> {
        self.cameras.iter().find(|camera| camera.name == name)
    }
}

impl From<&Rig> for RigParts {
    fn from(rig: &Rig) -> Self {
        let cameras = rig.cameras.iter().map(|camera| PartialCamera {
            name: camera.name.clone(),
            role: camera.role,
            size_px: camera.intrinsics.size_px,
            intrinsics: Some(camera.intrinsics),
            photometry: Some(camera.photometry.clone()),
            camera_from_world: camera.camera_from_world,
        });
        Self {
            main_marker: Some(rig.main_marker),
            cameras: cameras.collect(),
            markers: rig.markers.clone(),
            ball: rig.ball,
        }
    }
}
