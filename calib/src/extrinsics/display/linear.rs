//! The linear solution and its parts.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, Matrix3, Matrix3x4, Matrix4, Vector4};

use super::{Alignment, DisplayIntrinsics, refine::State};
use crate::pose::Pose;

/// Intrinsics and pose by direct linear transformation; `None` when points would lie behind the eye.
pub(super) fn solve(alignments: &[Alignment]) -> Option<State> {
    let pixels: Vec<DVec3> = alignments.iter().map(|alignment| alignment.pixel.extend(0.0)).collect();
    let points: Vec<DVec3> = alignments.iter().map(|alignment| alignment.point).collect();
    // Normalisation: mean 0, root mean square distance √2 and √3.
    let (pixel_mean, pixel_scale) = normalisation(&pixels, 2f64.sqrt());
    let (point_mean, point_scale) = normalisation(&points, 3f64.sqrt());
    let mut rows = DMatrix::zeros(2 * alignments.len(), 12);
    for (i, (pixel, point)) in pixels.iter().zip(&points).enumerate() {
        let pixel = (*pixel - pixel_mean) * pixel_scale;
        let point = ((*point - point_mean) * point_scale).extend(1.0).to_array();
        for axis in 0..2 {
            for (j, x) in point.into_iter().enumerate() {
                rows[(2 * i + axis, 4 * axis + j)] = x;
                rows[(2 * i + axis, 8 + j)] = -pixel[axis] * x;
            }
        }
    }
    let svd = rows.svd(false, true);
    let v_t = svd.v_t?;
    let solution = v_t.row(svd.singular_values.imin());
    let normalised = Matrix3x4::from_row_iterator(solution.iter().copied());
    let to_pixels = Matrix3::new(
        1.0 / pixel_scale,
        0.0,
        pixel_mean.x,
        0.0,
        1.0 / pixel_scale,
        pixel_mean.y,
        0.0,
        0.0,
        1.0,
    );
    let mut from_points = Matrix4::from_diagonal(&Vector4::new(point_scale, point_scale, point_scale, 1.0));
    for axis in 0..3 {
        from_points[(axis, 3)] = -point_scale * point_mean[axis];
    }
    let projection = to_pixels * normalised * from_points;
    // Of either sign; points are in front of the eye.
    let depth = |point: &DVec3| {
        projection
            .row(2)
            .dot(&Vector4::new(point.x, point.y, point.z, 1.0).transpose())
    };
    let in_front = points.iter().filter(|point| depth(point) > 0.0).count();
    let projection = match in_front {
        n if n == points.len() => projection,
        0 => -projection,
        _ => return None,
    };
    parts(&projection)
}

fn normalisation(points: &[DVec3], size: f64) -> (DVec3, f64) {
    let n = points.len() as f64;
    let mean = points.iter().sum::<DVec3>() / n;
    let square = points.iter().map(|point| point.distance_squared(mean)).sum::<f64>() / n;
    (mean, size / square.sqrt())
}

/// Takes `K [R | t]` apart: K from the rows' lengths and angles (Gram-Schmidt from the last row up).
fn parts(projection: &Matrix3x4<f64>) -> Option<State> {
    let row = |i: usize| DVec3::new(projection[(i, 0)], projection[(i, 1)], projection[(i, 2)]);
    let scale = 1.0 / row(2).length();
    let [a, b, z] = [row(0) * scale, row(1) * scale, row(2) * scale];
    let (cx, cy) = (a.dot(z), b.dot(z));
    let off_b = b - z * cy;
    let fy = off_b.length();
    let y = off_b / fy;
    let skew = a.dot(y);
    let off_a = a - z * cx - y * skew;
    let fx = off_a.length();
    let x = off_a / fx;
    let last = [0, 1, 2].map(|i| projection[(i, 3)] * scale);
    let ty = (last[1] - cy * last[2]) / fy;
    let tx = (last[0] - skew * ty - cx * last[2]) / fx;
    let rotation = DMat3::from_cols(x, y, z).transpose();
    let eye_from_headset = Pose {
        rotation,
        translation: DVec3::new(tx, ty, last[2]),
    };
    let is_eye = eye_from_headset.is_finite() && rotation.determinant() > 0.0;
    is_eye.then_some(State {
        intrinsics: DisplayIntrinsics {
            focal_px: DVec2::new(fx, fy),
            skew_px: skew,
            principal_point_px: DVec2::new(cx, cy),
        },
        eye_from_headset,
    })
}
