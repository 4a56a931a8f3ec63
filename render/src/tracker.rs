//! Frame to pose: markers found, camera located.

use mirrorball_calib::pose::Pose;
use mirrorball_calib::resection::{MarkerPose, locate, marker_poses};
use mirrorball_calib::rig::{Camera, Marker, Rig};
use mirrorball_calib::tag::{Detection, Family, Finder};
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
    /// The markers of the last frame.
    seen: Vec<Detection>,
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
            seen: Vec::new(),
        }
    }

    /// Locates the camera that took `frame` by the markers of `rig`.
    pub fn locate(&mut self, frame: &Frame, rig: &Rig, camera: &Camera) -> TrackedPose {
        self.seen.clear();
        let size = [frame.size.width as usize, frame.size.height as usize];
        self.seen = match self.finder.find(&frame.pixels, size, camera) {
            Ok(detections) => detections,
            Err(error) => {
                return TrackedPose::Lost {
                    reason: error.to_string(),
                    markers: 0,
                };
            }
        };
        let markers = self.seen.iter().filter(|d| rig.marker(d.id).is_some()).count();
        match locate(&self.seen, rig, &camera.intrinsics) {
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

    /// Where a marker was in the last frame that [`Tracker::locate`] took, camera from marker; `near` is where it is
    /// expected. `None` when it was not seen, or its corners fit no pose.
    #[must_use]
    pub fn locate_marker(&self, marker: &Marker, camera: &Camera, near: &Pose) -> Option<Pose> {
        let is_it = |d: &&Detection| d.id == marker.id && d.family == marker.family;
        let detection = self.seen.iter().find(is_it)?;
        chosen(&marker_poses(detection, marker, &camera.intrinsics), near)
    }
}

/// The pose that fits better; where both fit about as well, the one that is turned less from where the marker was expected.
fn chosen(poses: &[MarkerPose], near: &Pose) -> Option<Pose> {
    /// Poses are about as good when the worse is off by no more than this, in errors of the better and in pixels on top.
    const AS_GOOD: (f64, f64) = (2.0, 0.1);
    /// A marker whose corners are off by more is not where it seems, pixels.
    const MAX_ERROR_PX: f64 = 2.0;
    let best = poses
        .first()
        .filter(|best| best.reprojection_error_px <= MAX_ERROR_PX)?;
    let turn = |pose: &MarkerPose| {
        let difference = pose.camera_from_marker.rotation.transpose() * near.rotation;
        // The trace is 1 + 2 cos of the angle.
        -(difference.x_axis.x + difference.y_axis.y + difference.z_axis.z)
    };
    let limit_px = AS_GOOD.0 * best.reprojection_error_px + AS_GOOD.1;
    poses
        .iter()
        .filter(|pose| pose.reprojection_error_px <= limit_px)
        .min_by(|a, b| turn(a).total_cmp(&turn(b)))
        .map(|pose| pose.camera_from_marker)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};

    #[test]
    fn of_two_poses_that_fit_the_expected_one_is_taken() {
        let tilted = |angle: f64, error_px: f64| MarkerPose {
            camera_from_marker: Pose {
                rotation: DMat3::from_rotation_x(angle),
                translation: DVec3::Z,
            },
            reprojection_error_px: error_px,
        };
        let near = tilted(0.3, 0.0).camera_from_marker;
        let ambiguous = [tilted(-0.4, 0.05), tilted(0.4, 0.1)];
        assert_eq!(chosen(&ambiguous, &near), Some(ambiguous[1].camera_from_marker));
        let clear = [tilted(-0.4, 0.05), tilted(0.4, 1.0)];
        assert_eq!(chosen(&clear, &near), Some(clear[0].camera_from_marker));
        assert_eq!(chosen(&[tilted(0.3, 2.5)], &near), None);
        assert_eq!(chosen(&[], &near), None);
    }
}
