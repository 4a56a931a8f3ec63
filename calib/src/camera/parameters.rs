//! A lens as a list of numbers, and how pixels move with them: what solvers work on.

use std::{fmt, str::FromStr};

use glam::{DVec2, DVec3};

use super::{Intrinsics, LensModel, Optics};

/// Most numbers that any model has: focal lengths, principal point and eight coefficients.
pub const MAX_PARAMETERS: usize = 12;

/// The kind of a lens model, without its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Model {
    /// [`LensModel::BrownConrady`].
    BrownConrady,
    /// [`LensModel::KannalaBrandt`].
    KannalaBrandt,
    /// [`LensModel::Equisolid`].
    Equisolid,
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
    pub const ALL: [Self; 3] = [Self::BrownConrady, Self::KannalaBrandt, Self::Equisolid];

    /// Name, as in rig files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BrownConrady => "brown_conrady",
            Self::KannalaBrandt => "kannala_brandt",
            Self::Equisolid => "equisolid",
        }
    }

    /// Names of the parameters, in the order of [`Intrinsics::parameters`]; the first four are the same for every model.
    #[must_use]
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::BrownConrady => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"],
            Self::KannalaBrandt => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            Self::Equisolid => &["fx", "fy", "cx", "cy"],
        }
    }

    /// Whether the model images points beside and behind the camera.
    #[must_use]
    pub fn is_fisheye(self) -> bool {
        match self {
            Self::BrownConrady => false,
            Self::KannalaBrandt | Self::Equisolid => true,
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
            Self::KannalaBrandt { .. } => Model::KannalaBrandt,
            Self::Equisolid { .. } => Model::Equisolid,
        }
    }

    /// Coefficients, in the order of the rig file's `distortion`.
    #[must_use]
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::BrownConrady { k1, k2, p1, p2, k3 } => vec![k1, k2, p1, p2, k3],
            Self::KannalaBrandt { k, .. } => k.to_vec(),
            Self::Equisolid { .. } => Vec::new(),
        }
    }

    /// The same kind of lens with other coefficients; what is no coefficient, such as the largest angle, stays.
    fn with_coefficients(&self, values: &[f64]) -> Self {
        match *self {
            Self::BrownConrady { .. } => Self::BrownConrady {
                k1: values[0],
                k2: values[1],
                p1: values[2],
                p2: values[3],
                k3: values[4],
            },
            Self::KannalaBrandt { max_angle_rad, .. } => Self::KannalaBrandt {
                k: [values[0], values[1], values[2], values[3]],
                max_angle_rad,
            },
            Self::Equisolid { max_angle_rad } => Self::Equisolid { max_angle_rad },
        }
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
            Optics::Perspective(_) => {
                let DVec2 { x, y } = point_camera.truncate() / point_camera.z;
                let s = x * x + y * y;
                coefficients(0, DVec2::new(x, y) * s);
                coefficients(1, DVec2::new(x, y) * s * s);
                coefficients(2, DVec2::new(2.0 * x * y, s + 2.0 * y * y));
                coefficients(3, DVec2::new(s + 2.0 * x * x, 2.0 * x * y));
                coefficients(4, DVec2::new(x, y) * s * s * s);
            }
            Optics::Fisheye(_) => {
                let outwards = point_camera.truncate().try_normalize().unwrap_or(DVec2::ZERO);
                let angle = point_camera.truncate().length().atan2(point_camera.z);
                for index in 0..self.lens.coefficients().len() {
                    coefficients(index, outwards * angle.powi(3 + 2 * index as i32));
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

    /// Central differences of the pixel by every parameter.
    fn check(intrinsics: &Intrinsics, point: DVec3) {
        let jacobians = intrinsics.project_with_jacobians(point).unwrap();
        let parameters = intrinsics.parameters();
        for index in 0..parameters.len() {
            let step = 1e-6 * parameters[index].abs().max(1.0);
            let moved = |sign: f64| {
                let mut parameters = parameters.clone();
                parameters[index] += sign * step;
                intrinsics.with_parameters(&parameters).project(point).unwrap()
            };
            let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * step);
            for axis in 0..2 {
                let exact = jacobians.by_parameters[axis][index];
                assert!(
                    (numeric[axis] - exact).abs() < 1e-4 * (1.0 + exact.abs()),
                    "{index}: {numeric} {exact}"
                );
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        for lens in [
            LensModel::BrownConrady {
                k1: -0.2,
                k2: 0.05,
                p1: 1e-3,
                p2: -5e-4,
                k3: 0.01,
            },
            LensModel::KannalaBrandt {
                k: [-0.0121, 0.0058, -0.0021, 0.00021],
                max_angle_rad: 1.7,
            },
            LensModel::Equisolid { max_angle_rad: 2.0 },
        ] {
            let intrinsics = Intrinsics {
                size_px: [640, 480],
                focal_px: DVec2::new(605.5, 604.0),
                principal_point_px: DVec2::new(320.9, 238.4),
                lens,
            };
            for point in [DVec3::new(0.3, -0.2, 0.7), DVec3::new(-0.01, 0.4, 1.0), DVec3::Z] {
                check(&intrinsics, point);
            }
        }
    }

    #[test]
    fn names_and_numbers_agree() {
        for model in Model::ALL {
            assert_eq!(model.to_string().parse(), Ok(model));
        }
        let error = "fov".parse::<Model>().unwrap_err();
        assert_eq!(
            error.to_string(),
            "unknown camera model `fov` (allowed: `brown_conrady`, `kannala_brandt`, `equisolid`)"
        );
    }
}
