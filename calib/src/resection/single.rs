//! Where one marker is, from its own corners alone.

use super::{Problem, corner_sigma_px, solve, square_poses};
use crate::camera::Intrinsics;
use crate::pose::Pose;
use crate::rig::Marker;
use crate::tag::Detection;
use solve::{Corner, Loss};

/// Scale of the robust error, in expected deviations, at which all four corners count in full: there is no fifth to tell
/// which of them is wrong.
const ALL_COUNT: f64 = 100.0;

/// A pose that the corners of one marker allow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerPose {
    /// Where the marker is.
    pub camera_from_marker: Pose,
    /// Root mean square distance between where its corners were seen and where the pose puts them, pixels.
    pub reprojection_error_px: f64,
}

/// The poses, two at most, that the picture of one square marker allows; the one that fits better comes first.
///
/// A square that is small or far away looks nearly the same from two sides (Collins and Bartoli 2014): both poses fit then,
/// and only what else is known tells which is true. Of `marker` its side counts, not its place. Nothing comes back when the
/// corners are no picture of a square.
#[must_use]
pub fn marker_poses(detection: &Detection, marker: &Marker, intrinsics: &Intrinsics) -> Vec<MarkerPose> {
    let at_origin = Marker {
        world_from_marker: Pose::identity(),
        ..*marker
    };
    let places = at_origin.corners_world();
    let sigma_px = corner_sigma_px(detection);
    let corners: [Corner; 4] = std::array::from_fn(|i| Corner {
        world: places[i],
        pixel: detection.corners_px[i],
        sigma_px,
    });
    let rays = detection.corners_px.map(|pixel| intrinsics.unproject(pixel));
    let [Some(a), Some(b), Some(c), Some(d)] = rays else {
        return Vec::new();
    };
    let refined = |start| {
        let problem = Problem {
            intrinsics,
            corners: &corners,
            loss: Loss::Huber,
            scale: ALL_COUNT,
        };
        let pose = solve::refine(&problem, start)?.camera_from_world;
        let mut sum = 0.0;
        for corner in &corners {
            sum += solve::residual(intrinsics, &pose, corner)?.length_squared();
        }
        Some(MarkerPose {
            camera_from_marker: pose,
            reprojection_error_px: (sum / 4.0).sqrt(),
        })
    };
    let mut poses: Vec<MarkerPose> = square_poses(&[a, b, c, d], marker.side_m)
        .into_iter()
        .filter_map(refined)
        .collect();
    poses.sort_by(|a, b| a.reprojection_error_px.total_cmp(&b.reprojection_error_px));
    poses
}
