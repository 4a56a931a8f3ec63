//! Perspective lenses: radial and tangential distortion of the picture on the plane z = 1.

use glam::{DVec2, DVec3};

use super::{INVERSE_ITERATIONS, INVERSE_TOLERANCE, MAX_TANGENT, rational::Radial};

/// A lens whose distortion is a function of the point on the plane z = 1.
///
/// The Jacobian of this distortion is symmetric, so the distortion is the gradient of a potential. Where the Jacobian
/// is positive definite on a disc the potential is convex and the distortion one to one. Its eigenvalues are those of
/// the radial part, `f` and `f + 2 s df/ds` with `s = r²`, changed by at most `6 r |p|`, which is at most
/// `3 |p| (1 + s)`.
pub(super) struct Perspective {
    pub(super) radial: Radial,
    /// p1, p2.
    pub(super) tangential: DVec2,
}

impl Perspective {
    /// The point on the plane z = 1, or `None` where the lens does not image it.
    pub(super) fn plane_point(&self, point: DVec3) -> Option<DVec2> {
        if point.z <= 0.0 {
            return None;
        }
        let plane = point.truncate() / point.z;
        let radius_squared = plane.length_squared();
        (radius_squared <= MAX_TANGENT * MAX_TANGENT && self.is_monotone_to(radius_squared)).then_some(plane)
    }

    /// Whether the distortion is one to one on the disc of this squared radius.
    pub(super) fn is_monotone_to(&self, radius_squared: f64) -> bool {
        self.radial.exceeds(3.0 * self.tangential.length(), radius_squared)
    }

    /// Largest undistorted radius, in focal lengths, up to which the distortion is one to one.
    pub(super) fn max_radius(&self) -> f64 {
        let whole = MAX_TANGENT * MAX_TANGENT;
        if self.is_monotone_to(whole) {
            return MAX_TANGENT;
        }
        let (mut low, mut high) = (0.0, whole);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if self.is_monotone_to(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low.sqrt()
    }

    /// Distorted coordinates of a point on the plane z = 1.
    pub(super) fn distort(&self, plane: DVec2) -> DVec2 {
        let DVec2 { x, y } = plane;
        let DVec2 { x: p1, y: p2 } = self.tangential;
        let s = plane.length_squared();
        let radial = self.radial.value(s);
        DVec2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// The symmetric Jacobian of [`Self::distort`]: d x'/dx, d x'/dy (= d y'/dx), d y'/dy.
    fn jacobian(&self, plane: DVec2) -> [f64; 3] {
        let DVec2 { x, y } = plane;
        let DVec2 { x: p1, y: p2 } = self.tangential;
        let s = plane.length_squared();
        let radial = self.radial.value(s);
        let slope = 2.0 * self.radial.slope(s);
        [
            radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
            radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        ]
    }

    /// Gradients of the distorted coordinates with respect to a point in space.
    pub(super) fn gradient(&self, point: DVec3) -> [DVec3; 2] {
        let plane = point.truncate() / point.z;
        let [xx, xy, yy] = self.jacobian(plane);
        let row = |row: DVec2| (row / point.z).extend(-row.dot(plane) / point.z);
        [row(DVec2::new(xx, xy)), row(DVec2::new(xy, yy))]
    }

    /// The point on the plane z = 1 that has these distorted coordinates, by Newton's method with step halving; the potential is convex on the disc, so this cannot circle.
    pub(super) fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        let inside = |plane: DVec2| {
            let s = plane.length_squared();
            s <= MAX_TANGENT * MAX_TANGENT && self.is_monotone_to(s)
        };
        let mut plane = distorted;
        if !inside(plane) {
            plane *= 0.999 * self.max_radius() / plane.length();
        }
        let mut residual = self.distort(plane) - distorted;
        for _ in 0..INVERSE_ITERATIONS {
            if residual.length() <= INVERSE_TOLERANCE * distorted.length().max(1.0) {
                break;
            }
            let [xx, xy, yy] = self.jacobian(plane);
            let determinant = xx * yy - xy * xy;
            let step = DVec2::new(yy * residual.x - xy * residual.y, xx * residual.y - xy * residual.x) / determinant;
            let shorter = (0..40)
                .map(|halvings| plane - step * 0.5f64.powi(halvings))
                .find_map(|candidate| {
                    let change = self.distort(candidate) - distorted;
                    (inside(candidate) && change.length() < residual.length()).then_some((candidate, change))
                });
            let Some((next, change)) = shorter else { break };
            (plane, residual) = (next, change);
        }
        (residual.length() < 1e-10).then_some(plane)
    }

    /// Derivatives of the distorted coordinates by p1, p2.
    pub(super) fn by_tangential(plane: DVec2) -> [DVec2; 2] {
        let DVec2 { x, y } = plane;
        let s = plane.length_squared();
        [
            DVec2::new(2.0 * x * y, s + 2.0 * y * y),
            DVec2::new(s + 2.0 * x * x, 2.0 * x * y),
        ]
    }
}
