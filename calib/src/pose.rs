//! Rigid transforms, named `a_from_b`: they map coordinates in frame b to coordinates in frame a.

use std::ops::Mul;

use glam::{DMat3, DVec3};

/// Largest deviation of `R Rᵀ` from the identity, per element, that a pose read from a file may have.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// Angle, in radians, below which the exponential map uses its Taylor series.
const SMALL_ANGLE_RAD: f64 = 1e-4;

/// A rigid transform `a_from_b`: a rotation, then a translation in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Proper rotation; its columns are the axes of b, seen in a.
    pub rotation: DMat3,
    /// Origin of b in a, in metres.
    pub translation: DVec3,
}

/// A small motion: an element of the Lie algebra se(3).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Rotation vector in radians.
    pub rotation: DVec3,
    /// Translational part in metres.
    pub translation: DVec3,
}

/// Why twelve numbers are not a pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("element `{value}` in row `{row}`, column `{column}` is not a finite number")]
    NotFinite {
        /// Row, from 0.
        row: usize,
        /// Column, from 0; 3 is the translation.
        column: usize,
        /// What was found.
        value: f64,
    },
    /// The left 3×3 block is not a rotation.
    #[error(
        "the 3×3 block is no rotation: R Rᵀ differs from the identity by `{deviation:.2e}` (allowed: at most `1e-3`)"
    )]
    NotOrthonormal {
        /// Largest element of |R Rᵀ - 1|.
        deviation: f64,
    },
    /// The left 3×3 block mirrors.
    #[error("the 3×3 block mirrors: its determinant is `{determinant:.3}` (allowed: 1)")]
    Mirrored {
        /// Determinant found.
        determinant: f64,
    },
}

impl Pose {
    /// The transform that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
        }
    }

    /// Reads three rows `[r00, r01, r02, t]`; the rotation is made exactly orthonormal.
    ///
    /// # Errors
    /// When a number is not finite or the 3×3 block is not a proper rotation within 1e-3.
    pub fn from_rows(rows: &[[f64; 4]; 3]) -> Result<Self, PoseError> {
        for (row, values) in rows.iter().enumerate() {
            for (column, &value) in values.iter().enumerate() {
                if !value.is_finite() {
                    return Err(PoseError::NotFinite { row, column, value });
                }
            }
        }
        let axis = |column: usize| DVec3::new(rows[0][column], rows[1][column], rows[2][column]);
        let block = DMat3::from_cols(axis(0), axis(1), axis(2));
        let difference = block * block.transpose() - DMat3::IDENTITY;
        let deviation = difference
            .to_cols_array()
            .into_iter()
            .fold(0.0, |worst: f64, x| worst.max(x.abs()));
        if deviation > ORTHONORMAL_TOLERANCE {
            return Err(PoseError::NotOrthonormal { deviation });
        }
        let determinant = block.determinant();
        if determinant < 0.0 {
            return Err(PoseError::Mirrored { determinant });
        }
        Ok(Self {
            rotation: orthonormalized(block),
            translation: axis(3),
        })
    }

    /// The 4×4 matrix, row by row; its last row is 0 0 0 1.
    #[must_use]
    pub fn to_rows4(&self) -> [[f64; 4]; 4] {
        let row = |i: usize| {
            let r = self.rotation.row(i);
            [r.x, r.y, r.z, self.translation[i]]
        };
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Maps a point, in metres.
    #[must_use]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Maps a direction or a difference of points.
    #[must_use]
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// Angle, in radians, of the rotation that takes this pose's axes to the other's; 0 to π.
    #[must_use]
    pub fn angle_to(&self, other: &Self) -> f64 {
        rotation_vector(&(self.rotation.transpose() * other.rotation)).length()
    }

    /// The motion that this twist describes, carried on for one unit of time (Barfoot 2017, eq. 7.86).
    #[must_use]
    pub fn exp(twist: Twist) -> Self {
        let angle = twist.rotation.length();
        let cross = cross_matrix(twist.rotation);
        let square = cross * cross;
        let (a, b, c) = series(angle);
        let rotation = DMat3::IDENTITY + cross * a + square * b;
        let left_jacobian = DMat3::IDENTITY + cross * b + square * c;
        Self {
            rotation,
            translation: left_jacobian * twist.translation,
        }
    }

    /// The twist whose [`Self::exp`] is this pose; its rotation is at most π long.
    #[must_use]
    pub fn log(&self) -> Twist {
        let rotation = rotation_vector(&self.rotation);
        let cross = cross_matrix(rotation);
        let (_, b, c) = series(rotation.length());
        let left_jacobian = DMat3::IDENTITY + cross * b + cross * cross * c;
        Twist {
            rotation,
            translation: left_jacobian.inverse() * self.translation,
        }
    }

    /// The same pose with the rotation made orthonormal to machine precision; products of many poses drift.
    #[must_use]
    pub fn orthonormalized(&self) -> Self {
        Self {
            rotation: orthonormalized(self.rotation),
            translation: self.translation,
        }
    }

    /// Whether all twelve numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }
}

impl Mul for Pose {
    type Output = Self;

    /// `a_from_b * b_from_c = a_from_c`.
    fn mul(self, b_from_c: Self) -> Self {
        Self {
            rotation: self.rotation * b_from_c.rotation,
            translation: self.transform_point(b_from_c.translation),
        }
    }
}

/// sin θ / θ, (1 - cos θ) / θ², (θ - sin θ) / θ³, by Taylor series near 0.
fn series(angle: f64) -> (f64, f64, f64) {
    let s = angle * angle;
    if angle < SMALL_ANGLE_RAD {
        return (1.0 - s / 6.0, 0.5 - s / 24.0, 1.0 / 6.0 - s / 120.0);
    }
    let half = (0.5 * angle).sin() / (0.5 * angle);
    (
        angle.sin() / angle,
        0.5 * half * half,
        (angle - angle.sin()) / (s * angle),
    )
}

/// The matrix with `cross_matrix(v) * w = v × w`.
fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, v.z, -v.y),
        DVec3::new(-v.z, 0.0, v.x),
        DVec3::new(v.y, -v.x, 0.0),
    )
}

/// The rotation vector of a rotation, through its quaternion, so that angles near 0 and near π are both exact.
fn rotation_vector(rotation: &DMat3) -> DVec3 {
    let quaternion = glam::DQuat::from_mat3(rotation).normalize();
    let quaternion = if quaternion.w < 0.0 { -quaternion } else { quaternion };
    let axis = DVec3::new(quaternion.x, quaternion.y, quaternion.z);
    let sine = axis.length();
    if sine < 1e-12 {
        return axis * 2.0;
    }
    axis * (2.0 * sine.atan2(quaternion.w) / sine)
}

/// The nearest rotation, by Newton's iteration for the polar decomposition (Higham 1986).
fn orthonormalized(block: DMat3) -> DMat3 {
    // Convergence is quadratic: from 1e-3 three steps reach machine precision.
    (0..5).fold(block, |rotation, _| (rotation + rotation.inverse().transpose()) * 0.5)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn vector(size: f64) -> impl Strategy<Value = DVec3> {
        (-size..size, -size..size, -size..size).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn pose() -> impl Strategy<Value = Pose> {
        (vector(1.8), vector(2.0)).prop_map(|(rotation, translation)| Pose::exp(Twist { rotation, translation }))
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        let rotation = (a.rotation - b.rotation)
            .to_cols_array()
            .into_iter()
            .fold(0.0, |worst: f64, x| worst.max(x.abs()));
        rotation.max(a.translation.distance(b.translation))
    }

    proptest! {
        #[test]
        fn inverse_undoes(a in pose(), point in vector(3.0)) {
            prop_assert!(distance(&(a * a.inverse()), &Pose::identity()) < 1e-13);
            prop_assert!(a.inverse().transform_point(a.transform_point(point)).distance(point) < 1e-13);
        }

        #[test]
        fn composition_is_application(a in pose(), b in pose(), point in vector(3.0)) {
            let both = (a * b).transform_point(point);
            prop_assert!(both.distance(a.transform_point(b.transform_point(point))) < 1e-13);
        }

        #[test]
        fn log_undoes_exp(rotation in vector(1.8), translation in vector(2.0), scale in 0.0f64..1.0) {
            let twist = Twist { rotation: rotation * scale.powi(8), translation };
            prop_assume!(twist.rotation.length() < 3.1);
            let back = Pose::exp(twist).log();
            prop_assert!(back.rotation.distance(twist.rotation) < 1e-9, "{:?} {:?}", back, twist);
            prop_assert!(back.translation.distance(twist.translation) < 1e-9, "{:?} {:?}", back, twist);
        }

        #[test]
        fn rows_round_trip(a in pose()) {
            let [x, y, z, last] = a.to_rows4();
            prop_assert_eq!(last, [0.0, 0.0, 0.0, 1.0]);
            prop_assert!(distance(&Pose::from_rows(&[x, y, z]).expect("a pose"), &a) < 1e-13);
        }

        #[test]
        fn noisy_rows_become_a_rotation(a in pose(), noise in -3e-4f64..3e-4) {
            let [mut x, y, z, _] = a.to_rows4();
            x[0] += noise;
            let read = Pose::from_rows(&[x, y, z]).expect("within the tolerance");
            prop_assert!((read.rotation * read.rotation.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-14));
        }
    }

    const ROWS: [[f64; 4]; 3] = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3]];

    #[test]
    fn what_is_no_pose_is_refused() {
        let mut rows = ROWS;
        rows[1][3] = f64::NAN;
        let error = Pose::from_rows(&rows).unwrap_err();
        assert_eq!(
            error.to_string(),
            "element `NaN` in row `1`, column `3` is not a finite number"
        );
        let mut rows = ROWS;
        rows[0][0] = 1.1;
        let error = Pose::from_rows(&rows).unwrap_err();
        assert!(matches!(error, PoseError::NotOrthonormal { .. }), "{error}");
        let mut rows = ROWS;
        rows[2][2] = -1.0;
        assert_eq!(Pose::from_rows(&rows), Err(PoseError::Mirrored { determinant: -1.0 }));
    }

    #[test]
    fn angle_between_poses() {
        let turned = Pose::exp(Twist {
            rotation: DVec3::new(0.0, 0.3, 0.0),
            translation: DVec3::ONE,
        });
        assert!((turned.angle_to(&Pose::identity()) - 0.3).abs() < 1e-14);
    }
}
