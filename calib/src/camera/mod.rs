//! Camera models: what maps a ray to a pixel and back.
//!
//! All work is done on rays, not on the plane `z = 1`, so that lenses beyond 180 degrees are no special case.

mod fisheye;
mod parameters;

use glam::{DVec2, DVec3};

pub use parameters::{Jacobians, MAX_PARAMETERS, Model, UnknownModel};

use fisheye::Fisheye;

/// Largest tangent of the angle to the optical axis that a [`LensModel::BrownConrady`] lens may image (89.94 degrees).
///
/// A lens without distortion has no limit of its own; this one keeps [`Intrinsics::max_radius`] finite.
const MAX_TANGENT: f64 = 1e3;

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

/// Distortion of a lens, where OpenCV knows it in OpenCV's terms and with OpenCV's coefficients.
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
    /// Fisheye lens that gives equal solid angles equal areas (Miyamoto 1964, "Fish eye lens").
    ///
    /// With θ the angle to the optical axis, the distance from the principal point is `2 sin(θ/2)` focal lengths.
    Equisolid {
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
        let distorted = match Optics::of(&self.lens) {
            Optics::Perspective(lens) => lens.distort(lens.plane_point(point_camera)?),
            Optics::Fisheye(lens) => lens.distort(point_camera)?,
        };
        let pixel = self.focal_px * distorted + self.principal_point_px;
        pixel.is_finite().then_some(pixel)
    }

    /// Maps a point like [`Self::project`] and adds the Jacobian of the pixel with respect to the point.
    #[must_use]
    pub fn project_with_gradient(&self, point_camera: DVec3) -> Option<Projection> {
        let pixel = self.project(point_camera)?;
        let gradient = match Optics::of(&self.lens) {
            Optics::Perspective(lens) => lens.gradient(point_camera),
            Optics::Fisheye(lens) => lens.gradient(point_camera),
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
        match Optics::of(&self.lens) {
            Optics::Perspective(lens) => Some(lens.undistort(distorted)?.extend(1.0).normalize()),
            Optics::Fisheye(lens) => lens.ray(distorted),
        }
    }

    /// Largest tangent of the angle to the optical axis that the lens images one to one; always finite.
    ///
    /// For [`LensModel::BrownConrady`] this is the largest undistorted radius, in focal lengths, up to which the
    /// distortion is monotone: further out the formula folds back into the picture.
    /// For a fisheye it is the tangent of `max_angle_rad`. Both are cut at 1000.
    #[must_use]
    pub fn max_radius(&self) -> f64 {
        match Optics::of(&self.lens) {
            Optics::Perspective(lens) => lens.max_radius(),
            Optics::Fisheye(lens) if lens.max_angle_rad < MAX_TANGENT.atan() => lens.max_angle_rad.tan().max(0.0),
            Optics::Fisheye(_) => MAX_TANGENT,
        }
    }

    /// Distance in pixels from the picture of a point in the camera frame to the end of a fisheye's round picture, along
    /// the radius; infinite for a perspective lens, negative for what the lens does not image.
    #[must_use]
    pub fn distance_to_rim_px(&self, point_camera: DVec3) -> f64 {
        match Optics::of(&self.lens) {
            Optics::Perspective(_) => f64::INFINITY,
            Optics::Fisheye(lens) => {
                let outwards = point_camera.truncate().try_normalize().unwrap_or(DVec2::X);
                let angle = point_camera.angle_between(DVec3::Z);
                (self.focal_px * outwards).length() * (lens.radius(lens.max_angle_rad) - lens.radius(angle))
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
        match Optics::of(self) {
            Optics::Perspective(lens) => lens.is_monotone_to(1f64.to_radians().tan().powi(2)),
            Optics::Fisheye(lens) => lens.is_one_to_one(),
        }
    }
}

/// The formulas behind a [`LensModel`].
enum Optics {
    Perspective(Perspective),
    Fisheye(Fisheye),
}

impl Optics {
    fn of(lens: &LensModel) -> Self {
        match *lens {
            LensModel::BrownConrady { k1, k2, p1, p2, k3 } => Self::Perspective(Perspective {
                radial: [k1, k2, k3],
                tangential: DVec2::new(p1, p2),
            }),
            LensModel::KannalaBrandt { k, max_angle_rad } => Self::Fisheye(Fisheye {
                law: fisheye::Law::Polynomial(k),
                max_angle_rad,
            }),
            LensModel::Equisolid { max_angle_rad } => Self::Fisheye(Fisheye {
                law: fisheye::Law::Equisolid,
                max_angle_rad,
            }),
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

    fn equisolid() -> impl Strategy<Value = Intrinsics> {
        (0.3f64..3.1).prop_map(|max_angle_rad| with_lens(LensModel::Equisolid { max_angle_rad }))
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
            lens in prop_oneof![fisheye(), equisolid()], part in 0.0f64..0.999, turn in 0.0..2.0 * PI,
            distance in 0.1f64..10.0,
        ) {
            let max_angle_rad = match lens.lens {
                LensModel::KannalaBrandt { max_angle_rad, .. } | LensModel::Equisolid { max_angle_rad } => max_angle_rad,
                LensModel::BrownConrady { .. } => panic!("a fisheye"),
            };
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

    #[test]
    fn equal_solid_angles_have_equal_areas_in_an_equisolid_lens() {
        let lens = with_lens(LensModel::Equisolid { max_angle_rad: 2.0 });
        // Area of the zone between two angles over its solid angle 2π (cos a - cos b) is f².
        for (a, b) in [(0.0f64, 0.1f64), (0.7, 0.8), (1.8, 1.99)] {
            let radius = |angle: f64| {
                let pixel = lens.project(ray(angle, 0.0)).expect("inside") - lens.principal_point_px;
                pixel.x / lens.focal_px.x
            };
            let area = PI * (radius(b).powi(2) - radius(a).powi(2));
            let solid_angle = 2.0 * PI * (a.cos() - b.cos());
            assert!((area / solid_angle - 1.0).abs() < 1e-12);
        }
        assert!((lens.project(ray(1.0, 0.0)).expect("inside").x - (320.9 + 605.5 * 2.0 * 0.5f64.sin())).abs() < 1e-9);
    }

    #[test]
    fn the_rim_of_a_fisheye_is_as_far_as_its_picture_says() {
        for lens in [
            LensModel::Equisolid { max_angle_rad: 1.6 },
            LensModel::KannalaBrandt {
                k: [-0.0121, 0.0058, -0.0021, 0.00021],
                max_angle_rad: 1.6,
            },
        ] {
            let lens = with_lens(lens);
            let point = 0.7 * ray(1.2, 0.8);
            let rim = lens.project(ray(1.6 - 1e-12, 0.8)).expect("inside");
            let apart = lens.project(point).expect("inside").distance(rim);
            assert!((lens.distance_to_rim_px(point) - apart).abs() < 1e-6);
            assert!(lens.distance_to_rim_px(ray(1.7, 0.3)) < 0.0);
        }
        let perspective = with_lens(LensModel::BrownConrady {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        });
        assert_eq!(perspective.distance_to_rim_px(DVec3::Z), f64::INFINITY);
    }
}
