//! Pose of a flat board from the rays towards its corners, wherever they point.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};

use crate::pose::Pose;

/// Fewest corners that determine a pose with something left to check it.
pub(super) const MIN_CORNERS: usize = 6;

/// Part of the corners that must lie along their rays, not behind the camera.
const IN_FRONT: f64 = 0.9;

/// Where a board is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlanarPose {
    /// The pose that fits the rays.
    pub(super) camera_from_board: Pose,
    /// Whether the camera sees the printed side. A picture that was mirrored shows the back.
    pub(super) from_the_front: bool,
}

/// The pose that brings corners on the plane z = 0 of the board, in metres, onto unit rays.
///
/// Every corner p and its ray d give `d × (H (p, 1)) = 0`, H = [r1 r2 t] up to a factor: the homography of Zhang (2000, "A
/// flexible new technique for camera calibration") on rays in place of pixels of a plane z = 1, so directions beside and
/// behind the camera are no special case. Its sign is the one that puts corners along their rays and not opposite to them.
/// `None` when there are too few corners, on a line, or no pose fits.
pub(super) fn planar_pose(points: &[DVec2], rays: &[DVec3]) -> Option<PlanarPose> {
    if points.len() < MIN_CORNERS {
        return None;
    }
    let count = points.len() as f64;
    let centre = points.iter().sum::<DVec2>() / count;
    let spread = (points.iter().map(|p| p.distance_squared(centre)).sum::<f64>() / count).sqrt();
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (point, ray) in points.iter().zip(rays) {
        let p = ((*point - centre) / spread).extend(1.0).to_array();
        // d × h, h = sum of columns times p: each row of the cross product.
        for row in [[0.0, -ray.z, ray.y], [ray.z, 0.0, -ray.x], [-ray.y, ray.x, 0.0]] {
            let equation = SVector::<f64, 9>::from_fn(|i, _| row[i % 3] * p[i / 3]);
            normal += equation * equation.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let mut sorted: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    // A second null vector: corners on a line, or rays that are all one.
    if sorted[1] < 1e-12 * sorted[8] {
        return None;
    }
    let h: Vec<f64> = eigen.eigenvectors.column(smallest).iter().copied().collect();
    let column = |i: usize| DVec3::new(h[3 * i], h[3 * i + 1], h[3 * i + 2]);
    let (first, second, third) = (column(0) / spread, column(1) / spread, column(2));
    let third = third - first * centre.x - second * centre.y;
    let along = points
        .iter()
        .zip(rays)
        .map(|(p, ray)| ray.dot(first * p.x + second * p.y + third));
    let ahead = along.filter(|a| *a > 0.0).count() as f64 / count;
    let sign = if ahead > 0.5 { 1.0 } else { -1.0 };
    if ahead.max(1.0 - ahead) < IN_FRONT {
        return None;
    }
    let scale = sign * 2.0 / (first.length() + second.length());
    let (first, second) = (first * scale, second * scale);
    let pose = Pose {
        rotation: nearest_rotation(DMat3::from_cols(first, second, first.cross(second)))?,
        translation: third * scale,
    };
    pose.is_finite().then(|| PlanarPose {
        camera_from_board: pose,
        from_the_front: pose.inverse().translation.z > 0.0,
    })
}

/// The rotation nearest to a matrix (Kabsch 1976).
fn nearest_rotation(matrix: DMat3) -> Option<DMat3> {
    let columns = matrix.to_cols_array();
    let svd = SMatrix::<f64, 3, 3>::from_column_slice(&columns).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let rotation = DMat3::from_cols_slice(rotation.as_slice());
    (rotation.determinant() > 0.0).then_some(rotation)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::pose::Twist;

    fn points() -> Vec<DVec2> {
        (0..20)
            .map(|i| DVec2::new(f64::from(i % 5) * 0.1, f64::from(i / 5) * 0.1))
            .collect()
    }

    proptest! {
        #[test]
        fn exact_rays_give_the_pose_in_any_direction(
            x in -0.6f64..0.6, y in -0.6f64..0.6, z in -3.0f64..3.0,
            angle in 0.0f64..3.1, about in 0.0f64..6.2, distance in 0.3f64..2.0,
        ) {
            // The board faces the camera from `towards`, then is tilted.
            let towards = DVec3::new(angle.sin() * about.cos(), angle.sin() * about.sin(), angle.cos());
            let facing = DMat3::from_quat(glam::DQuat::from_rotation_arc(DVec3::Z, -towards));
            let tilt = Pose::exp(Twist { rotation: DVec3::new(x, y, z), translation: DVec3::ZERO }).rotation;
            let pose = Pose { rotation: facing * tilt, translation: towards * distance };
            let centred: Vec<DVec2> = points().iter().map(|p| *p - DVec2::new(0.2, 0.15)).collect();
            let rays: Vec<DVec3> = centred.iter().map(|p| pose.transform_point(p.extend(0.0)).normalize()).collect();
            let found = planar_pose(&centred, &rays).expect("a pose");
            prop_assert!(found.camera_from_board.angle_to(&pose) < 1e-5);
            prop_assert!(found.camera_from_board.translation.distance(pose.translation) < 1e-5 * distance);
            prop_assert!(found.from_the_front);
            // Seen in a mirror the same corners show the board's back.
            let mirrored: Vec<DVec3> = rays.iter().map(|d| DVec3::new(-d.x, d.y, d.z)).collect();
            prop_assert!(!planar_pose(&centred, &mirrored).expect("a pose").from_the_front);
        }
    }

    #[test]
    fn corners_on_a_line_have_no_pose() {
        let points: Vec<DVec2> = (0..8).map(|i| DVec2::new(f64::from(i), 0.0)).collect();
        let rays: Vec<DVec3> = points.iter().map(|p| p.extend(5.0).normalize()).collect();
        assert_eq!(planar_pose(&points, &rays), None);
    }
}
