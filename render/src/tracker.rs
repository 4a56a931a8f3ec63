//! Frame to pose: markers found, camera located.

use mirrorball_calib::pose::Pose;
use mirrorball_calib::resection::locate;
use mirrorball_calib::rig::{Camera, Rig};
use mirrorball_calib::tag::{Family, Finder};
use mirrorball_capture::frame::Frame;

/// Where the scene camera was, or why that is not known.
#[derive(Debug, Clone, PartialEq)]
pub enum TrackedPose {
    /// The markers agree.
    Found {
        /// World to camera.
        camera_from_world: Pose,
        /// Root mean square over the corners used, pixels.
        reprojection_error_px: f64,
        /// Markers used.
        markers: usize,
    },
    /// No pose.
    Lost {
        /// Why, in words for the user.
        reason: String,
        /// Markers of the rig that were seen all the same.
        markers: usize,
    },
}

impl TrackedPose {
    /// The pose, if there is one.
    #[must_use]
    pub fn camera_from_world(&self) -> Option<&Pose> {
        match self {
            Self::Found { camera_from_world, .. } => Some(camera_from_world),
            Self::Lost { .. } => None,
        }
    }
}

/// Finds the rig's markers frame by frame; deterministic.
#[derive(Debug)]
pub struct Tracker {
    finder: Finder,
}

impl Tracker {
    /// A tracker for the marker families of a rig.
    #[must_use]
    pub fn new(rig: &Rig) -> Self {
        let mut families: Vec<Family> = Vec::new();
        for marker in &rig.markers {
            if !families.contains(&marker.family) {
                families.push(marker.family);
            }
        }
        Self {
            finder: Finder::new(&families),
        }
    }

    /// Locates the camera that took `frame`.
    pub fn locate(&mut self, frame: &Frame, rig: &Rig, camera: &Camera) -> TrackedPose {
        let size = [frame.size.width as usize, frame.size.height as usize];
        let detections = match self.finder.find(&frame.pixels, size, camera) {
            Ok(detections) => detections,
            Err(error) => {
                return TrackedPose::Lost {
                    reason: error.to_string(),
                    markers: 0,
                };
            }
        };
        let markers = detections.iter().filter(|d| rig.marker(d.id).is_some()).count();
        match locate(&detections, rig, &camera.intrinsics) {
            Ok(located) => TrackedPose::Found {
                camera_from_world: located.camera_from_world,
                reprojection_error_px: located.reprojection_error_px,
                markers: located.markers,
            },
            Err(no_pose) => TrackedPose::Lost {
                reason: no_pose.to_string(),
                markers,
            },
        }
    }
}
