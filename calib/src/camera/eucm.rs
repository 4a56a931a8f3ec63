//! Enhanced unified camera model (Khomutenko, Garcia and Martinet 2016, "An Enhanced Unified Camera Model").
//!
//! A point is projected onto the ellipsoid `z² + β (x² + y²) = 1`, then through a centre that lies behind its middle by
//! `α / (1 - α)`. With β = 1 it is the unified model of Geyer and Daniilidis (2000).

/// Coefficients of the model.
pub(super) struct Eucm {
    /// 0 (a pinhole) to 1; other values are continued by the same formulas.
    pub(super) alpha: f64,
    /// Above 0: stretches the ellipsoid.
    pub(super) beta: f64,
}

impl Eucm {
    /// `d = √(β sin² θ + cos² θ)` and the denominator `D = α d + (1 - α) cos θ` of the paper's projection.
    fn parts(&self, angle: f64) -> (f64, f64) {
        let (sine, cosine) = angle.sin_cos();
        let distance = (self.beta * sine * sine + cosine * cosine).sqrt();
        (distance, self.alpha * distance + (1.0 - self.alpha) * cosine)
    }

    /// Distance from the principal point, in focal lengths, at an angle to the axis: `sin θ / D`.
    pub(super) fn radius(&self, angle: f64) -> f64 {
        angle.sin() / self.parts(angle).1
    }

    /// Derivative of [`Self::radius`] by the angle: `(1 - α + α cos θ / d) / D²`.
    pub(super) fn slope(&self, angle: f64) -> f64 {
        let (distance, denominator) = self.parts(angle);
        (1.0 - self.alpha + self.alpha * angle.cos() / distance) / (denominator * denominator)
    }

    /// Derivatives of [`Self::radius`] by α and β.
    pub(super) fn by_coefficients(&self, angle: f64) -> [f64; 2] {
        let (sine, cosine) = angle.sin_cos();
        let (distance, denominator) = self.parts(angle);
        let scale = -sine / (denominator * denominator);
        [
            scale * (distance - cosine),
            scale * self.alpha * sine * sine / (2.0 * distance),
        ]
    }

    /// Radius at which the picture ends: for α > 1/2 where it folds back, `1 / √(β (2α - 1))`, else infinite.
    pub(super) fn largest_radius(&self) -> f64 {
        let fold = self.beta * (2.0 * self.alpha - 1.0);
        if fold > 0.0 { fold.sqrt().recip() } else { f64::INFINITY }
    }

    /// The angle at a radius of at most [`Self::largest_radius`] (inverse of [`Self::radius`], in closed form).
    ///
    /// With `q = √(1 - (2α - 1) β r²)` the paper's ray is `(r, m)` with `m = (1 - β α² r²) / (α q + 1 - α)`, which is
    /// `(α q - (1 - α)) / (2α - 1)`; each form is taken where it does not lose digits.
    pub(super) fn angle(&self, radius: f64) -> f64 {
        let Self { alpha, beta } = *self;
        let square = beta * radius * radius;
        let fold = 2.0 * alpha - 1.0;
        let root = (1.0 - fold * square).max(0.0).sqrt();
        let depth = if alpha > 0.75 {
            (alpha * root - (1.0 - alpha)) / fold
        } else {
            (1.0 - alpha * alpha * square) / (alpha * root + 1.0 - alpha)
        };
        radius.atan2(depth)
    }

    /// Whether the coefficients describe a lens at all.
    pub(super) fn is_valid(&self) -> bool {
        self.alpha.is_finite() && self.beta.is_finite() && self.beta > 0.0
    }
}
