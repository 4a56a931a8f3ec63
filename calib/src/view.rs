//! A plane to work on around a direction: rays seen through a pinhole that looks that way.

use glam::{DMat3, DVec2, DVec3};

/// A virtual pinhole camera of focal length 1 at the camera's centre, turned to look along a given ray.
///
/// Straight lines in space are straight lines here, whatever the lens, and any lens' picture of something small fits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub(crate) view_from_camera: DMat3,
}

impl View {
    /// The view along the mean of these rays; `None` when they cancel out.
    pub(crate) fn along(rays: &[DVec3]) -> Option<Self> {
        let forward = rays.iter().sum::<DVec3>().try_normalize()?;
        let right = forward.any_orthonormal_vector();
        let down = forward.cross(right);
        Some(Self {
            view_from_camera: DMat3::from_cols(right, down, forward).transpose(),
        })
    }

    /// Where a ray meets the plane z = 1; `None` behind it or at a grazing angle.
    pub(crate) fn plane_from_ray(&self, ray: DVec3) -> Option<DVec2> {
        let seen = self.view_from_camera * ray;
        (seen.z > 1e-3 * seen.length()).then(|| seen.truncate() / seen.z)
    }

    /// The ray, in the camera frame, to a point of the plane z = 1; not normalised.
    pub(crate) fn ray_from_plane(&self, point: DVec2) -> DVec3 {
        self.view_from_camera.transpose() * point.extend(1.0)
    }
}
