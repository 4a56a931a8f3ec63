//! Fisheye lenses: the angle to the optical axis becomes a distance from the principal point.

use glam::{DVec2, DVec3};

use super::{INVERSE_ITERATIONS, INVERSE_TOLERANCE, MAX_TANGENT, double_sphere::DoubleSphere, eucm::Eucm};

/// Largest angular radius, relative to depth, at which the formulas are replaced by their limit on the axis.
const AXIS_RATIO: f64 = 1e-9;

/// A lens of rotational symmetry that may see beyond 90 degrees.
pub(super) struct Fisheye {
    law: Law,
    /// Nothing is imaged beyond.
    pub(super) max_angle_rad: f64,
}

/// Distance from the principal point, in focal lengths, by the angle θ to the axis.
pub(super) enum Law {
    /// `θ (1 + k[0] θ² + k[1] θ⁴ + k[2] θ⁶ + k[3] θ⁸)`.
    Polynomial([f64; 4]),
    /// `2 sin(θ/2)`.
    Equisolid,
    Eucm(Eucm),
    DoubleSphere(DoubleSphere),
}

impl Fisheye {
    /// A lens that images nothing beyond an angle, in radians, nor beyond what its law can image one to one.
    pub(super) fn new(law: Law, max_angle_rad: f64) -> Self {
        let own = match &law {
            Law::Polynomial(_) | Law::Equisolid => max_angle_rad,
            Law::Eucm(eucm) => eucm.angle(eucm.largest_radius().min(MAX_TANGENT)),
            Law::DoubleSphere(spheres) => spheres.angle(spheres.largest_radius().min(MAX_TANGENT)),
        };
        Self {
            law,
            max_angle_rad: max_angle_rad.min(own),
        }
    }

    /// Distance from the principal point, in focal lengths, at this angle to the axis.
    pub(super) fn radius(&self, angle: f64) -> f64 {
        match &self.law {
            Law::Polynomial(k) => {
                let s = angle * angle;
                angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
            }
            Law::Equisolid => 2.0 * (0.5 * angle).sin(),
            Law::Eucm(eucm) => eucm.radius(angle),
            Law::DoubleSphere(spheres) => spheres.radius(angle),
        }
    }

    /// Derivative of [`Self::radius`] by the angle.
    fn slope(&self, angle: f64) -> f64 {
        match &self.law {
            Law::Polynomial(k) => {
                let s = angle * angle;
                1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
            }
            Law::Equisolid => (0.5 * angle).cos(),
            Law::Eucm(eucm) => eucm.slope(angle),
            Law::DoubleSphere(spheres) => spheres.slope(angle),
        }
    }

    /// Derivatives of [`Self::radius`] by the coefficients, in their order; zero from their number on.
    pub(super) fn by_coefficients(&self, angle: f64) -> [f64; 4] {
        let [first, second] = match &self.law {
            Law::Polynomial(_) => return [3, 5, 7, 9].map(|power| angle.powi(power)),
            Law::Equisolid => [0.0; 2],
            Law::Eucm(eucm) => eucm.by_coefficients(angle),
            Law::DoubleSphere(spheres) => spheres.by_coefficients(angle),
        };
        [first, second, 0.0, 0.0]
    }

    /// Distance, in focal lengths, from the picture of a point at this angle to the end of the picture; beyond the end minus
    /// the angle that is missing.
    pub(super) fn to_rim(&self, angle: f64) -> f64 {
        if angle > self.max_angle_rad {
            return self.max_angle_rad - angle;
        }
        self.radius(self.max_angle_rad) - self.radius(angle)
    }

    /// Whether everything up to the largest angle has a pixel of its own.
    pub(super) fn is_one_to_one(&self) -> bool {
        const STEPS: u32 = 4096;
        let is_one_to_one = match &self.law {
            Law::Polynomial(_) | Law::Equisolid => {
                (0..=STEPS).all(|i| self.slope(self.max_angle_rad * f64::from(i) / f64::from(STEPS)) > 0.0)
            }
            Law::Eucm(eucm) => eucm.is_valid(),
            Law::DoubleSphere(spheres) => spheres.is_valid(),
        };
        self.max_angle_rad > 0.0 && self.max_angle_rad <= std::f64::consts::PI && is_one_to_one
    }

    /// Normalised picture coordinates of a point; `None` for one that the lens does not image.
    pub(super) fn distort(&self, point: DVec3) -> Option<DVec2> {
        let rho = point.truncate().length();
        let angle = rho.atan2(point.z);
        if angle > self.max_angle_rad || (rho == 0.0 && point.z <= 0.0) {
            return None;
        }
        Some(if is_on_axis(rho, point.z) {
            point.truncate() * (self.slope(0.0) / point.z)
        } else {
            point.truncate() * (self.radius(angle) / rho)
        })
    }

    /// The unit ray to these normalised picture coordinates.
    pub(super) fn ray(&self, distorted: DVec2) -> Option<DVec3> {
        let angle = self.angle(distorted.length())?;
        let direction = distorted.try_normalize().unwrap_or(DVec2::ZERO);
        Some((direction * angle.sin()).extend(angle.cos()))
    }

    /// Gradients of the normalised picture coordinates with respect to the point.
    pub(super) fn gradient(&self, point: DVec3) -> [DVec3; 2] {
        let DVec3 { x, y, z } = point;
        let rho = point.truncate().length();
        if is_on_axis(rho, z) {
            let scale = self.slope(0.0) / z;
            return [
                DVec3::new(scale, 0.0, -x * scale / z),
                DVec3::new(0.0, scale, -y * scale / z),
            ];
        }
        let angle = rho.atan2(z);
        let scale = self.radius(angle) / rho;
        // Derivatives of the angle by rho and by z.
        let distance_squared = point.length_squared();
        let slope = self.slope(angle);
        let scale_by_rho = (slope * z / distance_squared - scale) / rho;
        let scale_by_z = -slope / distance_squared;
        let (a, b) = (x / rho, y / rho);
        [
            DVec3::new(scale + x * a * scale_by_rho, x * b * scale_by_rho, x * scale_by_z),
            DVec3::new(y * a * scale_by_rho, scale + y * b * scale_by_rho, y * scale_by_z),
        ]
    }

    /// Inverse of [`Self::radius`]: in closed form, or for the polynomial by Newton's method inside a shrinking bracket.
    fn angle(&self, radius: f64) -> Option<f64> {
        let end = self.radius(self.max_angle_rad);
        if radius > end + INVERSE_TOLERANCE {
            return None;
        }
        match &self.law {
            Law::Polynomial(_) => self.polynomial_angle(radius),
            Law::Equisolid => Some(2.0 * (0.5 * radius.min(end)).asin()),
            Law::Eucm(eucm) => Some(eucm.angle(radius.min(end))),
            Law::DoubleSphere(spheres) => Some(spheres.angle(radius.min(end))),
        }
    }

    fn polynomial_angle(&self, radius: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, self.max_angle_rad);
        let mut angle = radius.min(self.max_angle_rad);
        for _ in 0..INVERSE_ITERATIONS {
            let residual = self.radius(angle) - radius;
            if residual.abs() <= 1e-15 {
                break;
            }
            if residual > 0.0 {
                high = angle;
            } else {
                low = angle;
            }
            let newton = angle - residual / self.slope(angle);
            angle = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
        }
        ((self.radius(angle) - radius).abs() < 1e-10).then_some(angle)
    }
}

fn is_on_axis(rho: f64, z: f64) -> bool {
    rho <= AXIS_RATIO * z.abs() && z > 0.0
}
