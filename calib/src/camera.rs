//! Camera models: what maps a ray to a pixel and back.
//!
//! All work is done on rays, not on the plane `z = 1`, so that lenses beyond 180 degrees are no special case.

use glam::{DVec2, DVec3};

/// Largest tangent of the angle to the optical axis that a [`LensModel::BrownConrady`] lens may image (89.94 degrees).
///
/// A lens without distortion has no limit of its own; this one keeps [`Intrinsics::max_radius`] finite.
const MAX_TANGENT: f64 = 1e3;

/// Largest angular radius, relative to depth, at which the fisheye formulas are replaced by their limit on the axis.
const AXIS_RATIO: f64 = 1e-9;

/// Residual, in normalised image units, below which the inverse of a distortion counts as found.
const INVERSE_TOLERANCE: f64 = 1e-12;

/// Iterations after which the inverse of a distortion is given up.
const INVERSE_ITERATIONS: usize = 60;

/// What maps a ray in the camera frame (x right, y down, z forward) to a pixel (integers are pixel centres).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Width and height of the picture in pixels.
    pub size_px: [u32; 2],
    /// Focal lengths along x and y in pixels.
    pub focal_px: DVec2,
    /// Where the optical axis meets the picture, in pixels; (0, 0) is the centre of the top-left pixel.
    pub principal_point_px: DVec2,
    /// Distortion of the lens.
    pub lens: LensModel,
}

/// Distortion of a lens, in OpenCV's terms and with OpenCV's coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LensModel {
    /// Radial and tangential distortion of a perspective lens (Brown 1971, Conrady 1919; OpenCV `calib3d`).
    ///
    /// With `x = X/Z`, `y = Y/Z`, `r² = x² + y²`:
    /// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and likewise for `y'`.
    BrownConrady {
        /// Radial coefficient of r².
        k1: f64,
        /// Radial coefficient of r⁴.
        k2: f64,
        /// First tangential coefficient.
        p1: f64,
        /// Second tangential coefficient.
        p2: f64,
        /// Radial coefficient of r⁶.
        k3: f64,
    },
    /// Fisheye lens (Kannala and Brandt 2006, radial part; OpenCV `fisheye`).
    ///
    /// With θ the angle to the optical axis, the distance from the principal point is
    /// `θ (1 + k[0] θ² + k[1] θ⁴ + k[2] θ⁶ + k[3] θ⁸)` focal lengths.
    KannalaBrandt {
        /// Coefficients of θ², θ⁴, θ⁶ and θ⁸.
        k: [f64; 4],
        /// Angle to the optical axis, in radians, beyond which nothing is imaged.
        max_angle_rad: f64,
    },
}

/// A pixel and how it moves with the point that it shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Where the point appears, in pixels.
    pub pixel: DVec2,
    /// Gradients of the pixel's x and of its y with respect to the point in the camera frame, in pixels per metre.
    pub gradient: [DVec3; 2],
}

impl Intrinsics {
    /// Maps a point in the camera frame, in metres, to its pixel.
    ///
    /// `None` for a point that the lens does not image: behind a perspective camera, where the distortion is no longer
    /// monotone (see [`Self::max_radius`]), beyond a fisheye's `max_angle_rad`, or not finite.
    /// The pixel may lie outside the picture.
    #[must_use]
    pub fn project(&self, point_camera: DVec3) -> Option<DVec2> {
        if !point_camera.is_finite() {
            return None;
        }
        let distorted = match self.lens {
            LensModel::BrownConrady { .. } => {
                let lens = Perspective::new(&self.lens)?;
                lens.distort(lens.plane_point(point_camera)?)
            }
            LensModel::KannalaBrandt { k, max_angle_rad } => {
                let rho = point_camera.truncate().length();
                let angle = rho.atan2(point_camera.z);
                if angle > max_angle_rad || (rho == 0.0 && point_camera.z <= 0.0) {
                    return None;
                }
                if rho <= AXIS_RATIO * point_camera.z.abs() && point_camera.z > 0.0 {
                    point_camera.truncate() / point_camera.z
                } else {
                    point_camera.truncate() * (fisheye_radius(&k, angle) / rho)
                }
            }
        };
        let pixel = self.focal_px * distorted + self.principal_point_px;
        pixel.is_finite().then_some(pixel)
    }

    /// Maps a point like [`Self::project`] and adds the Jacobian of the pixel with respect to the point.
    #[must_use]
    pub fn project_with_gradient(&self, point_camera: DVec3) -> Option<Projection> {
        let pixel = self.project(point_camera)?;
        let gradient = match self.lens {
            LensModel::BrownConrady { .. } => {
                let lens = Perspective::new(&self.lens)?;
                lens.gradient(point_camera)
            }
            LensModel::KannalaBrandt { k, .. } => fisheye_gradient(&k, point_camera),
        };
        let gradient = [gradient[0] * self.focal_px.x, gradient[1] * self.focal_px.y];
        Some(Projection { pixel, gradient })
    }

    /// Maps a pixel to the unit ray in the camera frame that it looks along; the inverse of [`Self::project`].
    ///
    /// The distortion is inverted by a guarded Newton iteration to less than 1e-10 focal lengths.
    /// `None` for a pixel that no ray maps to: outside the lens' image, or not finite.
    #[must_use]
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        if !pixel.is_finite() {
            return None;
        }
        let distorted = (pixel - self.principal_point_px) / self.focal_px;
        match self.lens {
            LensModel::BrownConrady { .. } => {
                let undistorted = Perspective::new(&self.lens)?.undistort(distorted)?;
                Some(undistorted.extend(1.0).normalize())
            }
            LensModel::KannalaBrandt { k, max_angle_rad } => {
                let radius = distorted.length();
                let angle = fisheye_angle(&k, max_angle_rad, radius)?;
                let direction = distorted.try_normalize().unwrap_or(DVec2::ZERO);
                Some((direction * angle.sin()).extend(angle.cos()))
            }
        }
    }

    /// Largest tangent of the angle to the optical axis that the lens images one to one; always finite.
    ///
    /// For [`LensModel::BrownConrady`] this is the largest undistorted radius, in focal lengths, up to which the
    /// distortion is monotone: further out the formula folds back into the picture.
    /// For [`LensModel::KannalaBrandt`] it is the tangent of `max_angle_rad`. Both are cut at 1000.
    #[must_use]
    pub fn max_radius(&self) -> f64 {
        match self.lens {
            LensModel::BrownConrady { .. } => Perspective::new(&self.lens).map_or(0.0, |lens| lens.max_radius()),
            LensModel::KannalaBrandt { max_angle_rad, .. } => {
                if max_angle_rad < MAX_TANGENT.atan() {
                    max_angle_rad.tan().max(0.0)
                } else {
                    MAX_TANGENT
                }
            }
        }
    }

    /// Whether the pixel lies in the picture, whose area is `[-0.5, width - 0.5] × [-0.5, height - 0.5]`.
    #[must_use]
    pub fn contains(&self, pixel: DVec2) -> bool {
        let size = DVec2::new(f64::from(self.size_px[0]), f64::from(self.size_px[1]));
        pixel.cmpge(DVec2::splat(-0.5)).all() && pixel.cmple(size - 0.5).all()
    }
}

impl LensModel {
    /// Whether the lens maps a neighbourhood of the optical axis one to one: for a fisheye, everything up to
    /// `max_angle_rad`; for a perspective lens, more than 1 degree.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        match *self {
            Self::BrownConrady { .. } => {
                Perspective::new(self).is_some_and(|lens| lens.is_monotone_to(1f64.to_radians().tan().powi(2)))
            }
            Self::KannalaBrandt { k, max_angle_rad } => {
                const STEPS: u32 = 4096;
                let monotone =
                    (0..=STEPS).all(|i| fisheye_slope(&k, max_angle_rad * f64::from(i) / f64::from(STEPS)) > 0.0);
                max_angle_rad > 0.0 && max_angle_rad <= std::f64::consts::PI && monotone
            }
        }
    }
}

/// The coefficients of a Brown-Conrady lens.
///
/// The Jacobian of this distortion is symmetric, so the distortion is the gradient of a potential. Where the Jacobian
/// is positive definite on a disc the potential is convex and the distortion one to one. Its eigenvalues are those of
/// the radial part, `f = 1 + k1 s + k2 s² + k3 s³` and `1 + 3 k1 s + 5 k2 s² + 7 k3 s³` with `s = r²`, changed by at
/// most `6 r |p|`, which is at most `3 |p| (1 + s)`. Both bounds are cubics in s, which are easily checked on an
/// interval.
struct Perspective {
    radial: [f64; 3],
    tangential: DVec2,
}

impl Perspective {
    /// `None` for a lens of another kind.
    fn new(lens: &LensModel) -> Option<Self> {
        match *lens {
            LensModel::BrownConrady { k1, k2, p1, p2, k3 } => Some(Self {
                radial: [k1, k2, k3],
                tangential: DVec2::new(p1, p2),
            }),
            LensModel::KannalaBrandt { .. } => None,
        }
    }

    /// The point on the plane z = 1, or `None` where the lens does not image it.
    fn plane_point(&self, point: DVec3) -> Option<DVec2> {
        if point.z <= 0.0 {
            return None;
        }
        let plane = point.truncate() / point.z;
        let radius_squared = plane.length_squared();
        (radius_squared <= MAX_TANGENT * MAX_TANGENT && self.is_monotone_to(radius_squared)).then_some(plane)
    }

    /// Whether the distortion is one to one on the disc of this squared radius.
    fn is_monotone_to(&self, radius_squared: f64) -> bool {
        let [k1, k2, k3] = self.radial;
        let bound = 3.0 * self.tangential.length();
        positive_to([1.0 - bound, k1 - bound, k2, k3], radius_squared)
            && positive_to([1.0 - bound, 3.0 * k1 - bound, 5.0 * k2, 7.0 * k3], radius_squared)
    }

    fn max_radius(&self) -> f64 {
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

    fn distort(&self, plane: DVec2) -> DVec2 {
        let DVec2 { x, y } = plane;
        let DVec2 { x: p1, y: p2 } = self.tangential;
        let s = plane.length_squared();
        let radial = 1.0 + s * (self.radial[0] + s * (self.radial[1] + s * self.radial[2]));
        DVec2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// The symmetric Jacobian of [`Self::distort`]: d x'/dx, d x'/dy (= d y'/dx), d y'/dy.
    fn jacobian(&self, plane: DVec2) -> [f64; 3] {
        let DVec2 { x, y } = plane;
        let DVec2 { x: p1, y: p2 } = self.tangential;
        let [k1, k2, k3] = self.radial;
        let s = plane.length_squared();
        let radial = 1.0 + s * (k1 + s * (k2 + s * k3));
        let slope = 2.0 * (k1 + s * (2.0 * k2 + s * 3.0 * k3));
        [
            radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
            radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        ]
    }

    fn gradient(&self, point: DVec3) -> [DVec3; 2] {
        let plane = point.truncate() / point.z;
        let [xx, xy, yy] = self.jacobian(plane);
        let row = |row: DVec2| (row / point.z).extend(-row.dot(plane) / point.z);
        [row(DVec2::new(xx, xy)), row(DVec2::new(xy, yy))]
    }

    /// Newton's method with step halving; the potential is convex on the disc, so this cannot circle.
    fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
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
}

/// Whether the cubic with these coefficients, constant first, is positive on `[0, end]`.
fn positive_to(coefficients: [f64; 4], end: f64) -> bool {
    let [c0, c1, c2, c3] = coefficients;
    let value = |s: f64| c0 + s * (c1 + s * (c2 + s * c3));
    if !(c0 > 0.0 && value(end) > 0.0) {
        return false;
    }
    // The extrema: 3 c3 s² + 2 c2 s + c1 = 0, solved without cancellation.
    let discriminant = c2 * c2 - 3.0 * c3 * c1;
    if discriminant <= 0.0 {
        return true;
    }
    let q = -(c2 + discriminant.sqrt().copysign(c2));
    [q / (3.0 * c3), c1 / q]
        .into_iter()
        .all(|s| !(s > 0.0 && s < end) || value(s) > 0.0)
}

/// Distance from the principal point, in focal lengths, at this angle to the axis.
fn fisheye_radius(k: &[f64; 4], angle: f64) -> f64 {
    let s = angle * angle;
    angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
}

/// Derivative of [`fisheye_radius`] by the angle.
fn fisheye_slope(k: &[f64; 4], angle: f64) -> f64 {
    let s = angle * angle;
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
}

/// Inverse of [`fisheye_radius`]: Newton's method, kept inside a shrinking bracket.
fn fisheye_angle(k: &[f64; 4], max_angle: f64, radius: f64) -> Option<f64> {
    let end = fisheye_radius(k, max_angle);
    if radius > end + INVERSE_TOLERANCE {
        return None;
    }
    let (mut low, mut high) = (0.0, max_angle);
    let mut angle = radius.min(max_angle);
    for _ in 0..INVERSE_ITERATIONS {
        let residual = fisheye_radius(k, angle) - radius;
        if residual.abs() <= 1e-15 {
            break;
        }
        if residual > 0.0 {
            high = angle;
        } else {
            low = angle;
        }
        let newton = angle - residual / fisheye_slope(k, angle);
        angle = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
    }
    ((fisheye_radius(k, angle) - radius).abs() < 1e-10).then_some(angle)
}

/// Gradients of the normalised picture coordinates of a fisheye with respect to the point.
fn fisheye_gradient(k: &[f64; 4], point: DVec3) -> [DVec3; 2] {
    let DVec3 { x, y, z } = point;
    let rho = point.truncate().length();
    if rho <= AXIS_RATIO * z.abs() && z > 0.0 {
        return [
            DVec3::new(1.0 / z, 0.0, -x / (z * z)),
            DVec3::new(0.0, 1.0 / z, -y / (z * z)),
        ];
    }
    let angle = rho.atan2(z);
    let scale = fisheye_radius(k, angle) / rho;
    // Derivatives of the angle by rho and by z.
    let distance_squared = point.length_squared();
    let slope = fisheye_slope(k, angle);
    let scale_by_rho = (slope * z / distance_squared - scale) / rho;
    let scale_by_z = -slope / distance_squared;
    let (a, b) = (x / rho, y / rho);
    [
        DVec3::new(scale + x * a * scale_by_rho, x * b * scale_by_rho, x * scale_by_z),
        DVec3::new(y * a * scale_by_rho, scale + y * b * scale_by_rho, y * scale_by_z),
    ]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use super::*;

    fn with_lens(lens: LensModel) -> Intrinsics {
        Intrinsics {
            size_px: [640, 480],
            focal_px: DVec2::new(605.5, 604.0),
            principal_point_px: DVec2::new(320.9, 238.4),
            lens,
        }
    }

    fn perspective() -> impl Strategy<Value = Intrinsics> {
        let small = -0.002f64..0.002;
        (-0.35f64..0.2, -0.1f64..0.15, small.clone(), small, -0.05f64..0.05)
            .prop_map(|(k1, k2, p1, p2, k3)| with_lens(LensModel::BrownConrady { k1, k2, p1, p2, k3 }))
    }

    fn fisheye() -> impl Strategy<Value = Intrinsics> {
        (
            -0.03f64..0.03,
            -0.008f64..0.01,
            -0.003f64..0.003,
            -0.0004f64..0.0004,
            0.8f64..1.75,
        )
            .prop_map(|(a, b, c, d, max_angle_rad)| {
                with_lens(LensModel::KannalaBrandt {
                    k: [a, b, c, d],
                    max_angle_rad,
                })
            })
            .prop_filter("one to one", |intrinsics| intrinsics.lens.is_usable())
    }

    fn ray(angle: f64, turn: f64) -> DVec3 {
        DVec3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos())
    }

    /// Central differences; the third derivatives of these lenses are below 1e4 px per metre³, so h = 1e-5 is good to
    /// 1e-5.
    fn check_gradient(intrinsics: &Intrinsics, point: DVec3) {
        let projection = intrinsics.project_with_gradient(point).expect("visible");
        let step = 1e-5 * point.length();
        for axis in DVec3::AXES {
            let ahead = intrinsics.project(point + axis * step);
            let behind = intrinsics.project(point - axis * step);
            let (Some(ahead), Some(behind)) = (ahead, behind) else {
                continue;
            };
            let numeric = (ahead - behind) / (2.0 * step);
            let exact = DVec2::new(projection.gradient[0].dot(axis), projection.gradient[1].dot(axis));
            assert!(
                numeric.distance(exact) < 1e-5 * (1.0 + exact.length()),
                "{numeric} {exact} at {point}"
            );
        }
    }

    proptest! {
        #[test]
        fn perspective_round_trip(
            lens in perspective(), part in 0.0f64..0.98, turn in 0.0..2.0 * PI, distance in 0.1f64..10.0,
        ) {
            let direction = ray((part * lens.max_radius().min(3.0)).atan(), turn);
            let pixel = lens.project(direction * distance).expect("inside the one to one region");
            let back = lens.unproject(pixel).expect("a pixel that a ray maps to");
            prop_assert!(back.distance(direction) < 1e-8, "{} {}", back, direction);
            check_gradient(&lens, direction * distance);
        }

        #[test]
        fn fisheye_round_trip(
            lens in fisheye(), part in 0.0f64..0.999, turn in 0.0..2.0 * PI, distance in 0.1f64..10.0,
        ) {
            let LensModel::KannalaBrandt { max_angle_rad, .. } = lens.lens else { panic!("a fisheye") };
            let direction = ray(part * max_angle_rad, turn);
            let pixel = lens.project(direction * distance).expect("within the largest angle");
            let back = lens.unproject(pixel).expect("a pixel that a ray maps to");
            prop_assert!(back.distance(direction) < 1e-9, "{} {}", back, direction);
            check_gradient(&lens, direction * distance);
        }

        #[test]
        fn unprojected_pixels_project_back(lens in perspective(), x in -50.0f64..700.0, y in -50.0f64..530.0) {
            let pixel = DVec2::new(x, y);
            if let Some(ray) = lens.unproject(pixel) {
                prop_assert!((ray.length() - 1.0).abs() < 1e-12);
                let back = lens.project(ray).expect("a ray of the lens");
                prop_assert!(back.distance(pixel) < 1e-6, "{} {}", back, pixel);
            }
        }

        #[test]
        fn nothing_panics(lens in perspective(), x: f64, y: f64, z: f64) {
            let _ = lens.project_with_gradient(DVec3::new(x, y, z));
            let _ = lens.unproject(DVec2::new(x, y));
        }
    }

    #[test]
    fn the_largest_radius_is_where_the_formula_folds_back() {
        // r (1 - 0.3 r²) has its maximum at r² = 1 / 0.9.
        let lens = with_lens(LensModel::BrownConrady {
            k1: -0.3,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        });
        let largest = (1.0f64 / 0.9).sqrt();
        assert!((lens.max_radius() - largest).abs() < 1e-9);
        assert!(lens.project(DVec3::new(largest * 0.999, 0.0, 1.0)).is_some());
        assert_eq!(lens.project(DVec3::new(largest * 1.001, 0.0, 1.0)), None);
        let beyond = lens.principal_point_px.x + 1.001 * lens.focal_px.x * largest * 2.0 / 3.0;
        assert_eq!(lens.unproject(DVec2::new(beyond, lens.principal_point_px.y)), None);
    }

    #[test]
    fn a_lens_without_distortion_is_a_pinhole() {
        let lens = with_lens(LensModel::BrownConrady {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        });
        assert_eq!(lens.max_radius(), MAX_TANGENT);
        let pixel = lens.project(DVec3::new(0.1, -0.2, 0.5)).expect("in front");
        assert!(pixel.distance(DVec2::new(320.9 + 605.5 * 0.2, 238.4 - 604.0 * 0.4)) < 1e-12);
    }

    #[test]
    fn what_is_behind_the_camera_or_not_finite_is_not_seen() {
        let lens = with_lens(LensModel::BrownConrady {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        });
        for point in [DVec3::NEG_Z, DVec3::ZERO, DVec3::X, DVec3::NAN, DVec3::INFINITY] {
            assert_eq!(lens.project(point), None, "{point}");
        }
        assert_eq!(lens.unproject(DVec2::new(f64::NAN, 0.0)), None);
    }

    #[test]
    fn a_fisheye_sees_behind_itself_up_to_its_largest_angle() {
        let max_angle_rad = 92.5f64.to_radians();
        let lens = with_lens(LensModel::KannalaBrandt {
            k: [-0.0121, 0.0058, -0.0021, 0.00021],
            max_angle_rad,
        });
        assert!(lens.lens.is_usable());
        assert!(lens.project(ray(92.4f64.to_radians(), 1.0)).is_some());
        assert_eq!(lens.project(ray(92.6f64.to_radians(), 1.0)), None);
        assert_eq!(lens.project(DVec3::Z * 2.0), Some(lens.principal_point_px));
        assert_eq!(lens.project(DVec3::NEG_Z), None);
    }
}
