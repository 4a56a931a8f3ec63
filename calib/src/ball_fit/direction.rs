//! What the uncertainty of centre and radius means for the direction that a pixel of the ball shows.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix3x4, Matrix4};

use super::BallFit;
use crate::{camera::Intrinsics, pose::Pose, probe::mirror_ball::MirrorBall};

/// Cells of the map along either side.
pub const CELLS: usize = 48;
/// Cosine between normal and view beyond which the ball's picture is used: the light probe's own limit
/// ([`Trust::min_view_cosine`](crate::probe::Trust)).
pub const MIN_VIEW_COSINE: f64 = 0.1;

/// Standard deviations of the reflected direction over the ball's face in one picture: the root mean square angle between
/// the direction reported for a pixel and the true one, from the covariance of centre and radius.
#[derive(Debug, Clone, PartialEq)]
pub struct DirectionMap {
    /// The square of the picture that the map covers: its top-left corner, pixels.
    pub origin_px: DVec2,
    /// Its side, pixels.
    pub side_px: f64,
    /// [`CELLS`]² values, rows from the top, degrees; NaN where the ball is not, or not used.
    pub sigma_deg: Vec<f64>,
    /// In the middle of the ball, degrees.
    pub center_deg: f64,
}

/// Figures of directions over the used part of the ball's face, each pixel counting alike, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectionFigures {
    /// In the middle of the ball.
    pub center: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// At the rim of the used part.
    pub rim: f64,
}

impl DirectionMap {
    /// The map of a camera that looks at the ball; `None` where the ball is not before it.
    #[must_use]
    pub fn new(fit: &BallFit, intrinsics: &Intrinsics, camera_from_world: &Pose) -> Option<Self> {
        let center = camera_from_world.transform_point(fit.ball.center_m);
        let middle = intrinsics.project(center)?;
        let tangent = fit.ball.radius_m / center.length();
        // A tenth more than the ball: its outline is no circle and off centre.
        let half_px = 1.1 * intrinsics.focal_px.max_element() * tangent * center.length() / center.z;
        let origin_px = middle - half_px;
        let side_px = 2.0 * half_px;
        let sigma_at = |pixel: DVec2| {
            let ray = intrinsics.contains(pixel).then(|| intrinsics.unproject(pixel))??;
            sigma_rad(fit, camera_from_world, ray).map(f64::to_degrees)
        };
        let sigma_deg = (0..CELLS * CELLS).map(|index| {
            let cell = DVec2::new((index % CELLS) as f64, (index / CELLS) as f64) + 0.5;
            sigma_at(origin_px + cell * (side_px / CELLS as f64)).unwrap_or(f64::NAN)
        });
        Some(Self {
            origin_px,
            side_px,
            sigma_deg: sigma_deg.collect(),
            center_deg: sigma_rad(fit, camera_from_world, center.normalize())?.to_degrees(),
        })
    }

    /// Its figures; `None` where no cell shows the ball.
    #[must_use]
    pub fn figures(&self) -> Option<DirectionFigures> {
        let mut values: Vec<f64> = self.sigma_deg.iter().copied().filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            values
                .get((share * (values.len() - 1) as f64).round() as usize)
                .copied()
        };
        if values.is_empty() {
            return None;
        }
        Some(DirectionFigures {
            center: self.center_deg,
            median: at(0.5)?,
            p95: at(0.95)?,
            rim: at(1.0)?,
        })
    }
}

/// Root mean square error of the direction along a ray of the camera; `None` off the used part of the ball.
fn sigma_rad(fit: &BallFit, camera_from_world: &Pose, ray: DVec3) -> Option<f64> {
    let world_from_camera = camera_from_world.inverse();
    let (camera_m, ray) = (world_from_camera.translation, world_from_camera.transform_vector(ray));
    used_direction(&fit.ball, camera_m, ray)?;
    let covariance: &Matrix4<f64> = &fit.covariance_m2;
    let mut jacobian = Matrix3x4::zeros();
    // Small against the flattest depth of the ball under a ray that is used.
    let step_m = 1e-5 * fit.ball.radius_m;
    for parameter in 0..4 {
        let at = |by: f64| {
            let mut ball = fit.ball;
            match parameter {
                0..3 => ball.center_m[parameter] += by,
                _ => ball.radius_m += by,
            }
            ball.reflect(camera_m, ray).map(|(direction, _)| direction)
        };
        let slope = (at(step_m)? - at(-step_m)?) / (2.0 * step_m);
        jacobian.set_column(parameter, &nalgebra::Vector3::new(slope.x, slope.y, slope.z));
    }
    // The direction moves in the plane across it: the trace is the mean squared angle.
    Some((jacobian * covariance * jacobian.transpose()).trace().max(0.0).sqrt())
}

/// Direction that a ray of a camera at `camera_m` shows by way of the ball; `None` off the used part.
#[must_use]
pub fn used_direction(ball: &MirrorBall, camera_m: DVec3, ray: DVec3) -> Option<DVec3> {
    let (direction, point) = ball.reflect(camera_m, ray)?;
    let cosine = (point - ball.center_m).dot(-ray) / ball.radius_m;
    (cosine >= MIN_VIEW_COSINE).then_some(direction)
}
