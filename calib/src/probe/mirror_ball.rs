//! Where on a mirror ball a light is seen: exact reflection in a sphere at finite distance, for a light at finite distance.
//!
//! The common map (half vector of a distant camera) is wrong by a median of 3.7° for a 100 mm ball at 0.5 m, and a light
//! 1 m away is seen up to 2° off from where the ball's centre would see it.
//! Both vanish when the reflection is solved in the plane through camera, ball centre and light.

use glam::DVec3;

/// A mirror ball in the world frame, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MirrorBall {
    /// Centre.
    pub center_m: DVec3,
    /// Radius, above 0.
    pub radius_m: f64,
}

/// A point on the ball that mirrors a light into the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glint {
    /// The point on the ball, world frame.
    pub point_m: DVec3,
    /// Cosine between the ball's normal there and the direction to the camera, 0 at the outline, 1 at the middle.
    pub view_cosine: f64,
}

impl MirrorBall {
    /// Finds the point where a camera at `camera_m` sees the light that stands at `distance_m` from the ball's centre
    /// towards the unit vector `direction`, or `None` where the ball itself hides it.
    ///
    /// The problem is Alhazen's; with θ the angle of the glint from the camera's direction and φ that of the light, the
    /// angles of incidence and reflection are atan2(a sin θ, a cos θ - 1) and the same for b and φ - θ, a and b being the
    /// distances over the radius. Their difference rises with θ, so Newton's method from the middle finds the one root.
    #[must_use]
    pub fn glint(&self, camera_m: DVec3, direction: DVec3, distance_m: f64) -> Option<Glint> {
        let to_camera = camera_m - self.center_m;
        let a = to_camera.length() / self.radius_m;
        let b = distance_m / self.radius_m;
        if a <= 1.0 || b <= 1.0 {
            return None;
        }
        let forward = to_camera.normalize();
        let across = direction - forward * direction.dot(forward);
        let phi = f64::atan2(across.length(), direction.dot(forward));
        let sideways = across
            .try_normalize()
            .unwrap_or_else(|| forward.any_orthonormal_vector());
        let theta = glint_angle(a, b, phi);
        if a * theta.cos() <= 1.0 {
            return None;
        }
        let normal = forward * theta.cos() + sideways * theta.sin();
        let incidence = f64::atan2(a * theta.sin(), a * theta.cos() - 1.0);
        (incidence < std::f64::consts::FRAC_PI_2).then(|| Glint {
            point_m: self.center_m + normal * self.radius_m,
            view_cosine: incidence.cos(),
        })
    }

    /// The point of the ball's outline, as a camera at `camera_m` sees it, that is nearest to the visible `point_m`.
    ///
    /// On the outline the ray touches the ball, so its normal n has `n · to_camera = radius`.
    #[must_use]
    pub fn outline_beside(&self, camera_m: DVec3, point_m: DVec3) -> DVec3 {
        let to_camera = camera_m - self.center_m;
        let forward = to_camera.normalize();
        let cosine = (self.radius_m / to_camera.length()).min(1.0);
        let sideways = (point_m - self.center_m)
            .reject_from_normalized(forward)
            .try_normalize()
            .unwrap_or_else(|| forward.any_orthonormal_vector());
        self.center_m + self.radius_m * (forward * cosine + sideways * (1.0 - cosine * cosine).sqrt())
    }

    /// Direction (unit, world frame) that the ball shows to a camera at `camera_m` looking along the unit vector `ray`,
    /// and the point of reflection; `None` when the ray misses the ball.
    #[must_use]
    pub fn reflect(&self, camera_m: DVec3, ray: DVec3) -> Option<(DVec3, DVec3)> {
        let from_center = camera_m - self.center_m;
        let half_b = from_center.dot(ray);
        let discriminant = half_b * half_b - from_center.length_squared() + self.radius_m * self.radius_m;
        if discriminant < 0.0 {
            return None;
        }
        let along = -half_b - discriminant.sqrt();
        if along <= 0.0 {
            return None;
        }
        let point = camera_m + ray * along;
        let normal = (point - self.center_m) / self.radius_m;
        Some((ray - normal * (2.0 * ray.dot(normal)), point))
    }
}

/// Newton's method on the difference of the two angles; `a`, `b` above 1, `phi` in 0 ..= π.
fn glint_angle(a: f64, b: f64, phi: f64) -> f64 {
    let angle = |d: f64, t: f64| f64::atan2(d * t.sin(), d * t.cos() - 1.0);
    let slope = |d: f64, t: f64| (d * d - d * t.cos()) / (d * d - 2.0 * d * t.cos() + 1.0);
    let mut theta = 0.5 * phi;
    for _ in 0..8 {
        let difference = angle(a, theta) - angle(b, phi - theta);
        let step = difference / (slope(a, theta) + slope(b, phi - theta)).max(0.1);
        theta = (theta - step).clamp(0.0, phi);
    }
    theta
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn glint_and_reflect_are_inverse(
            x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0, distance in 0.3f64..5.0, camera in 0.15f64..2.0,
        ) {
            let ball = MirrorBall { center_m: DVec3::new(0.2, 0.1, 0.05), radius_m: 0.04 };
            let direction = DVec3::new(x, y, z);
            prop_assume!(direction.length() > 0.1);
            let direction = direction.normalize();
            let camera_m = ball.center_m + DVec3::new(0.3, -0.5, 0.6).normalize() * camera;
            if let Some(glint) = ball.glint(camera_m, direction, distance) {
                let ray = (glint.point_m - camera_m).normalize();
                // Grazing rays multiply rounding, so ask for the exact answer away from the rim.
                prop_assume!(glint.view_cosine > 0.05);
                let (out, point) = ball.reflect(camera_m, ray).unwrap();
                let light = ball.center_m + direction * distance;
                prop_assert!((point - glint.point_m).length() < 1e-6);
                prop_assert!(out.dot((light - point).normalize()) > 1.0 - 1e-9);
            }
        }
    }

    #[test]
    fn a_light_behind_the_ball_is_hidden() {
        let ball = MirrorBall {
            center_m: DVec3::ZERO,
            radius_m: 0.05,
        };
        let camera_m = DVec3::new(0.0, 0.0, 0.5);
        assert!(ball.glint(camera_m, DVec3::NEG_Z, 2.0).is_none());
        assert!(
            ball.glint(camera_m, DVec3::Z, 2.0)
                .is_some_and(|g| (g.view_cosine - 1.0).abs() < 1e-12)
        );
    }

    #[test]
    fn a_camera_inside_the_ball_sees_nothing() {
        let ball = MirrorBall {
            center_m: DVec3::ZERO,
            radius_m: 0.05,
        };
        assert!(ball.glint(DVec3::new(0.0, 0.0, 0.01), DVec3::Z, 2.0).is_none());
    }
}
