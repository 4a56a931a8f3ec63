//! Camera models: what maps a ray to a pixel and back.
//!
//! All work is done on rays, not on the plane `z = 1`, so that lenses beyond 180 degrees are no special case.

mod double_sphere;
mod eucm;
mod fisheye;
mod parameters;
mod perspective;
mod rational;

use glam::{DVec2, DVec3};

pub use parameters::{Jacobians, MAX_PARAMETERS, Model, UnknownModel};

use double_sphere::DoubleSphere;
use eucm::Eucm;
use fisheye::{Fisheye, Law};
use perspective::Perspective;
use rational::Radial;

/// Largest tangent of the angle to the optical axis that a perspective lens may image (89.94 degrees), and largest radius of
/// a picture in focal lengths.
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
    /// Like [`Self::BrownConrady`], with the radial factor divided by a polynomial (OpenCV `calib3d`'s rational model).
    ///
    /// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, likewise for `y'`.
    Rational {
        /// k1, k2, p1, p2, k3, k4, k5, k6, in OpenCV's order.
        coefficients: [f64; 8],
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
    /// Enhanced unified camera model, for lenses of any width (Khomutenko, Garcia and Martinet 2016; Kalibr's
    /// `eucm`).
    ///
    /// With `d = √(β (X² + Y²) + Z²)`, `x' = X / (α d + (1 - α) Z)`, likewise for `y'`.
    Eucm {
        /// 0 (a pinhole) to 1.
        alpha: f64,
        /// Above 0; 1 is the unified model.
        beta: f64,
        /// Angle to the optical axis, in radians, beyond which nothing is imaged; π leaves it to the model's own limit, which
        /// holds in any case.
        max_angle_rad: f64,
    },
    /// Double sphere model, for lenses of any width (Usenko, Demmel and Cremers 2018, equations 40 to 42; Kalibr's `ds`).
    ///
    /// With `d₁ = |(X, Y, Z)|`, `w = ξ d₁ + Z` and `d₂ = √(X² + Y² + w²)`, `x' = X / (α d₂ + (1 - α) w)`, likewise for
    /// `y'`. On the axis one focal length is `1 + ξ` of a pinhole's.
    DoubleSphere {
        /// Above -1, below 1.
        xi: f64,
        /// 0 to 1.
        alpha: f64,
        /// Angle to the optical axis, in radians, beyond which nothing is imaged; π leaves it to the model's own limit, which
        /// holds in any case.
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
    /// monotone (see [`Self::max_radius`]), beyond [`LensModel::max_angle_rad`], or not finite.
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
    /// The distortion is inverted in closed form where there is one, else by a guarded Newton iteration to less than 1e-10
    /// focal lengths.
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
    /// For a perspective lens this is the largest undistorted radius, in focal lengths, up to which the distortion is
    /// monotone: further out the formula folds back into the picture.
    /// For a fisheye it is the tangent of [`LensModel::max_angle_rad`]. Both are cut at 1000.
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
                (self.focal_px * outwards).length() * lens.to_rim(angle)
            }
        }
    }

    /// Largest angle to the optical axis, in radians, that the picture shows.
    ///
    /// The angle grows with the distance from the principal point, so that a corner is the widest; where a corner shows
    /// nothing the end of the lens' image is.
    #[must_use]
    pub fn largest_angle_rad(&self) -> f64 {
        let end = self.lens.max_angle_rad().unwrap_or(self.max_radius().atan());
        let [width, height] = self.size_px.map(f64::from);
        let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
        let angle = |(x, y): (f64, f64)| {
            let ray = self.unproject(DVec2::new(x - 0.5, y - 0.5));
            ray.map_or(end, |ray| ray.angle_between(DVec3::Z))
        };
        corners.map(angle).into_iter().fold(0.0, f64::max)
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
    /// [`Self::max_angle_rad`]; for a perspective lens, more than 1 degree.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        match Optics::of(self) {
            Optics::Perspective(lens) => lens.is_monotone_to(1f64.to_radians().tan().powi(2)),
            Optics::Fisheye(lens) => lens.is_one_to_one(),
        }
    }

    /// Angle to the optical axis, in radians, beyond which a fisheye images nothing; `None` for a perspective lens.
    ///
    /// Never more than the model itself can image one to one where it has such a limit in closed form
    /// ([`Self::Eucm`], [`Self::DoubleSphere`]).
    #[must_use]
    pub fn max_angle_rad(&self) -> Option<f64> {
        match Optics::of(self) {
            Optics::Perspective(_) => None,
            Optics::Fisheye(lens) => Some(lens.max_angle_rad),
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
        let (law, max_angle_rad) = match *lens {
            LensModel::BrownConrady { k1, k2, p1, p2, k3 } => {
                return Self::perspective([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]);
            }
            LensModel::Rational { coefficients } => return Self::perspective(coefficients),
            LensModel::KannalaBrandt { k, max_angle_rad } => (Law::Polynomial(k), max_angle_rad),
            LensModel::Equisolid { max_angle_rad } => (Law::Equisolid, max_angle_rad),
            LensModel::Eucm {
                alpha,
                beta,
                max_angle_rad,
            } => (Law::Eucm(Eucm { alpha, beta }), max_angle_rad),
            LensModel::DoubleSphere {
                xi,
                alpha,
                max_angle_rad,
            } => (Law::DoubleSphere(DoubleSphere { xi, alpha }), max_angle_rad),
        };
        Self::Fisheye(Fisheye::new(law, max_angle_rad))
    }

    fn perspective([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8]) -> Self {
        Self::Perspective(Perspective {
            radial: Radial {
                numerator: [k1, k2, k3],
                denominator: [k4, k5, k6],
            },
            tangential: DVec2::new(p1, p2),
        })
    }
}

#[cfg(test)]
mod tests;
