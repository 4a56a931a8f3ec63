//! Double sphere model (Usenko, Demmel and Cremers 2018, "The Double Sphere Camera Model").
//!
//! A point is projected onto a unit sphere, from there onto a second one whose centre lies ξ further back, then through a
//! centre as in the unified model. Seen from the second sphere's centre a point at the angle θ to the axis stands at
//! `φ = atan2(sin θ, ξ + cos θ)`, so the model is the unified one of φ.

use super::eucm::Eucm;

/// Coefficients of the model.
pub(super) struct DoubleSphere {
    /// Above -1, below 1: distance of the two spheres' centres.
    pub(super) xi: f64,
    /// 0 to 1, as in the unified model; other values are continued by the same formulas.
    pub(super) alpha: f64,
}

impl DoubleSphere {
    /// Depth `w = ξ + cos θ` and distance `d₂ = √(sin² θ + w²)` from the second centre, and the denominator
    /// `D = α d₂ + (1 - α) w` (equations 40 to 42 for a point at distance 1).
    fn parts(&self, angle: f64) -> (f64, f64, f64) {
        let (sine, cosine) = angle.sin_cos();
        let depth = self.xi + cosine;
        let distance = sine.hypot(depth);
        (depth, distance, self.alpha * distance + (1.0 - self.alpha) * depth)
    }

    /// Distance from the principal point, in focal lengths, at an angle to the axis: `sin θ / D`.
    pub(super) fn radius(&self, angle: f64) -> f64 {
        angle.sin() / self.parts(angle).2
    }

    /// Derivative of [`Self::radius`] by the angle: `(1 + ξ cos θ) (1 - α + α w / d₂) / D²`.
    pub(super) fn slope(&self, angle: f64) -> f64 {
        let (depth, distance, denominator) = self.parts(angle);
        let unified = 1.0 - self.alpha + self.alpha * depth / distance;
        (1.0 + self.xi * angle.cos()) * unified / (denominator * denominator)
    }

    /// Derivatives of [`Self::radius`] by ξ and α.
    pub(super) fn by_coefficients(&self, angle: f64) -> [f64; 2] {
        let (depth, distance, denominator) = self.parts(angle);
        let scale = -angle.sin() / (denominator * denominator);
        [
            scale * (self.alpha * depth / distance + 1.0 - self.alpha),
            scale * (distance - depth),
        ]
    }

    /// Radius at which the picture ends: for α > 1/2 where it folds back, `1 / √(2α - 1)` (the paper's bound for unprojection), else infinite.
    pub(super) fn largest_radius(&self) -> f64 {
        self.unified().largest_radius()
    }

    /// The angle at a radius of at most [`Self::largest_radius`]: the unified model gives φ, the sine rule in the
    /// triangle of the two centres and the point gives `θ = φ + asin(ξ sin φ)`.
    ///
    /// At the largest radius this is the widest angle that has a pixel of its own. The paper's equation 44 for that angle
    /// is not the inverse of that bound: for ξ > 0 it cuts some of the picture, for ξ < 0 it may leave too much.
    pub(super) fn angle(&self, radius: f64) -> f64 {
        let from_second = self.unified().angle(radius);
        from_second + (self.xi * from_second.sin()).asin()
    }

    /// Whether the coefficients describe a lens at all.
    pub(super) fn is_valid(&self) -> bool {
        self.alpha.is_finite() && self.xi.abs() < 1.0
    }

    fn unified(&self) -> Eucm {
        Eucm {
            alpha: self.alpha,
            beta: 1.0,
        }
    }
}
