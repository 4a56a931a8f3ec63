//! The closed form.

use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};

use super::Pair;
use crate::pose::Pose;

/// headset_from_camera and world_from_tracker of least squares, first over rotations, then over translations (Shah 2013,
/// section 3). `None` when the poses do not determine them.
///
/// With Y = Z⁻¹: `R_A R_X = R_Y R_B`, so `Σ R_B ⊗ R_A` maps `vec R_X` to n times `vec R_Y`: its first singular vectors.
/// Then `R_A t_X - t_Y = R_Y t_B - t_A`.
pub(super) fn solve(pairs: &[Pair]) -> Option<(Pose, Pose)> {
    let mut sum = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        sum += matrix(&pair.world_from_camera.rotation).kronecker(&matrix(&pair.tracker_from_headset.rotation));
    }
    let svd = sum.svd(true, true);
    let largest = svd.singular_values.imax();
    let of_x = svd.v_t?.row(largest).transpose();
    let of_y = svd.u?.column(largest).into_owned();
    let x = rotation(&Matrix3::from_iterator(of_x.iter().copied()))?;
    let y = rotation(&Matrix3::from_iterator(of_y.iter().copied()))?;
    let mut left = DMatrix::zeros(3 * pairs.len(), 6);
    let mut right = DVector::zeros(3 * pairs.len());
    for (i, pair) in pairs.iter().enumerate() {
        let a = matrix(&pair.tracker_from_headset.rotation);
        left.fixed_view_mut::<3, 3>(3 * i, 0).copy_from(&a);
        left.fixed_view_mut::<3, 3>(3 * i, 3).copy_from(&-Matrix3::identity());
        let shift = y * pair.world_from_camera.translation - pair.tracker_from_headset.translation;
        for axis in 0..3 {
            right[3 * i + axis] = shift[axis];
        }
    }
    let normal = left.transpose() * &left;
    let t = normal.cholesky()?.solve(&(left.transpose() * right));
    let headset_from_camera = Pose {
        rotation: x,
        translation: DVec3::new(t[0], t[1], t[2]),
    };
    let tracker_from_world = Pose {
        rotation: y,
        translation: DVec3::new(t[3], t[4], t[5]),
    };
    let is_finite = headset_from_camera.is_finite() && tracker_from_world.is_finite();
    is_finite.then(|| (headset_from_camera, tracker_from_world.inverse()))
}

fn matrix(rotation: &DMat3) -> Matrix3<f64> {
    Matrix3::from_column_slice(&rotation.to_cols_array())
}

/// The rotation nearest to a multiple, of either sign, of a matrix.
fn rotation(multiple: &Matrix3<f64>) -> Option<DMat3> {
    let svd = (multiple * multiple.determinant().signum()).svd(true, true);
    let nearest = svd.u? * svd.v_t?;
    let columns: [f64; 9] = nearest.as_slice().try_into().expect("nine numbers");
    (nearest.determinant() > 0.0).then(|| DMat3::from_cols_array(&columns))
}
