//! A lens as a list of numbers, and how pixels move with them: what solvers work on.

use std::{f64::consts::PI, fmt, str::FromStr};

use glam::{DVec2, DVec3};

use super::{Intrinsics, LensModel, Optics, perspective::Perspective};

/// Most numbers that any model has: focal lengths, principal point and eight coefficients.
pub const MAX_PARAMETERS: usize = 12;

/// The kind of a lens model, without its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Model {
    /// [`LensModel::BrownConrady`].
    BrownConrady,
    /// [`LensModel::Rational`].
    Rational,
    /// [`LensModel::KannalaBrandt`].
    KannalaBrandt,
    /// [`LensModel::Equisolid`].
    Equisolid,
    /// [`LensModel::Eucm`].
    Eucm,
    /// [`LensModel::DoubleSphere`].
    DoubleSphere,
}

/// There is no lens model of this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown camera model `{found}` (allowed: {allowed})")]
pub struct UnknownModel {
    /// The name.
    pub found: String,
    /// All names.
    pub allowed: String,
}

/// A pixel, how it moves with the point that it shows, and how with the lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jacobians {
    /// Where the point appears, in pixels.
    pub pixel: DVec2,
    /// Gradients of the pixel's x and y with respect to the point in the camera frame, in pixels per metre.
    pub by_point: [DVec3; 2],
    /// Derivatives of the pixel's x and y with respect to [`Intrinsics::parameters`]; zero from their number on.
    pub by_parameters: [[f64; MAX_PARAMETERS]; 2],
}

impl Model {
    /// Every model.
    pub const ALL: [Self; 6] = [
        Self::BrownConrady,
        Self::Rational,
        Self::KannalaBrandt,
        Self::Equisolid,
        Self::Eucm,
        Self::DoubleSphere,
    ];

    /// Name, as in rig files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BrownConrady => "brown_conrady",
            Self::Rational => "rational",
            Self::KannalaBrandt => "kannala_brandt",
            Self::Equisolid => "equisolid",
            Self::Eucm => "eucm",
            Self::DoubleSphere => "double_sphere",
        }
    }

    /// Names of the parameters, in the order of [`Intrinsics::parameters`]; the first four are the same for every model.
    #[must_use]
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::BrownConrady => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"],
            Self::Rational => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            Self::KannalaBrandt => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            Self::Equisolid => &["fx", "fy", "cx", "cy"],
            Self::Eucm => &["fx", "fy", "cx", "cy", "alpha", "beta"],
            Self::DoubleSphere => &["fx", "fy", "cx", "cy", "xi", "alpha"],
        }
    }

    /// Whether the model images points beside and behind the camera.
    #[must_use]
    pub fn is_fisheye(self) -> bool {
        match self {
            Self::BrownConrady | Self::Rational => false,
            Self::KannalaBrandt | Self::Equisolid | Self::Eucm | Self::DoubleSphere => true,
        }
    }

    /// All names, for messages.
    #[must_use]
    pub fn names() -> String {
        Self::ALL.map(|model| format!("`{model}`")).join(", ")
    }
}

impl fmt::Display for Model {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Model {
    type Err = UnknownModel;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let model = Self::ALL.into_iter().find(|model| model.name() == name);
        model.ok_or_else(|| UnknownModel {
            found: name.to_owned(),
            allowed: Self::names(),
        })
    }
}

impl LensModel {
    /// The kind of this lens.
    #[must_use]
    pub fn model(&self) -> Model {
        match self {
            Self::BrownConrady { .. } => Model::BrownConrady,
            Self::Rational { .. } => Model::Rational,
            Self::KannalaBrandt { .. } => Model::KannalaBrandt,
            Self::Equisolid { .. } => Model::Equisolid,
            Self::Eucm { .. } => Model::Eucm,
            Self::DoubleSphere { .. } => Model::DoubleSphere,
        }
    }

    /// Coefficients, in the order of the rig file's `distortion`.
    #[must_use]
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::BrownConrady { k1, k2, p1, p2, k3 } => vec![k1, k2, p1, p2, k3],
            Self::Rational { coefficients } => coefficients.to_vec(),
            Self::KannalaBrandt { k, .. } => k.to_vec(),
            Self::Equisolid { .. } => Vec::new(),
            Self::Eucm { alpha, beta, .. } => vec![alpha, beta],
            Self::DoubleSphere { xi, alpha, .. } => vec![xi, alpha],
        }
    }

    /// The lens of a model with these coefficients, in the order of [`Self::coefficients`]; `None` when their number is not the
    /// model's. They are not checked otherwise: ask [`Self::is_usable`].
    ///
    /// `max_angle_rad` is the angle beyond which nothing is imaged; a perspective lens has none.
    #[must_use]
    pub fn from_coefficients(model: Model, values: &[f64], max_angle_rad: f64) -> Option<Self> {
        Some(match (model, values) {
            (Model::BrownConrady, &[k1, k2, p1, p2, k3]) => Self::BrownConrady { k1, k2, p1, p2, k3 },
            (Model::Rational, &[..]) => Self::Rational {
                coefficients: values.try_into().ok()?,
            },
            (Model::KannalaBrandt, &[k1, k2, k3, k4]) => Self::KannalaBrandt {
                k: [k1, k2, k3, k4],
                max_angle_rad,
            },
            (Model::Equisolid, &[]) => Self::Equisolid { max_angle_rad },
            (Model::Eucm, &[alpha, beta]) => Self::Eucm {
                alpha,
                beta,
                max_angle_rad,
            },
            (Model::DoubleSphere, &[xi, alpha]) => Self::DoubleSphere {
                xi,
                alpha,
                max_angle_rad,
            },
            _ => return None,
        })
    }

    /// The same kind of lens with other coefficients; what is no coefficient, such as the largest angle, stays.
    fn with_coefficients(&self, values: &[f64]) -> Self {
        let max_angle_rad = match *self {
            Self::BrownConrady { .. } | Self::Rational { .. } => PI,
            Self::KannalaBrandt { max_angle_rad, .. }
            | Self::Equisolid { max_angle_rad }
            | Self::Eucm { max_angle_rad, .. }
            | Self::DoubleSphere { max_angle_rad, .. } => max_angle_rad,
        };
        let count = self.model().parameter_names().len() - 4;
        Self::from_coefficients(self.model(), &values[..count], max_angle_rad).expect("as many as the model has")
    }
}

impl Intrinsics {
    /// The numbers that describe the lens: focal lengths and principal point in pixels, then the coefficients; see
    /// [`Model::parameter_names`].
    #[must_use]
    pub fn parameters(&self) -> Vec<f64> {
        let (focal, centre) = (self.focal_px, self.principal_point_px);
        let mut parameters = vec![focal.x, focal.y, centre.x, centre.y];
        parameters.extend(self.lens.coefficients());
        parameters
    }

    /// The same camera with other numbers. They are not checked: ask [`LensModel::is_usable`].
    ///
    /// # Panics
    /// When there are fewer of them than the model has.
    #[must_use]
    pub fn with_parameters(&self, parameters: &[f64]) -> Self {
        Self {
            size_px: self.size_px,
            focal_px: DVec2::new(parameters[0], parameters[1]),
            principal_point_px: DVec2::new(parameters[2], parameters[3]),
            lens: self.lens.with_coefficients(&parameters[4..]),
        }
    }

    /// Maps a point like [`Self::project`] and says how the pixel moves with the point and with the lens.
    #[must_use]
    pub fn project_with_jacobians(&self, point_camera: DVec3) -> Option<Jacobians> {
        let projection = self.project_with_gradient(point_camera)?;
        let plane = (projection.pixel - self.principal_point_px) / self.focal_px;
        let mut by_parameters = [[0.0; MAX_PARAMETERS]; 2];
        for axis in 0..2 {
            by_parameters[axis][axis] = plane[axis];
            by_parameters[axis][2 + axis] = 1.0;
        }
        let mut coefficients = |index: usize, derivative: DVec2| {
            for axis in 0..2 {
                by_parameters[axis][4 + index] = self.focal_px[axis] * derivative[axis];
            }
        };
        match Optics::of(&self.lens) {
            Optics::Perspective(lens) => {
                let plane = point_camera.truncate() / point_camera.z;
                let radial = lens.radial.by_coefficients(plane.length_squared());
                let [k1, k2, k3, k4, k5, k6] = radial.map(|derivative| plane * derivative);
                let [p1, p2] = Perspective::by_tangential(plane);
                let in_order = [k1, k2, p1, p2, k3, k4, k5, k6];
                let count = self.lens.model().parameter_names().len() - 4;
                for (index, &derivative) in in_order[..count].iter().enumerate() {
                    coefficients(index, derivative);
                }
            }
            Optics::Fisheye(lens) => {
                let outwards = point_camera.truncate().try_normalize().unwrap_or(DVec2::ZERO);
                let angle = point_camera.truncate().length().atan2(point_camera.z);
                for (index, derivative) in lens.by_coefficients(angle).into_iter().enumerate() {
                    coefficients(index, outwards * derivative);
                }
            }
        }
        Some(Jacobians {
            pixel: projection.pixel,
            by_point: projection.gradient,
            by_parameters,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_agree() {
        for model in Model::ALL {
            assert_eq!(model.to_string().parse(), Ok(model));
        }
        let error = "fov".parse::<Model>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "unknown camera model `fov` (allowed: `brown_conrady`, `rational`, `kannala_brandt`, `equisolid`, `eucm`, \
             `double_sphere`)"
        );
    }
}
