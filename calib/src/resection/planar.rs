//! Pose of one square from its four corners: both solutions (IPPE: Collins and Bartoli 2014, "Infinitesimal
//! plane-based pose estimation").
//!
//! Worked out in a view turned towards the square, so that any lens and any direction will do.

use glam::{DMat2, DMat3, DVec2, DVec3};

use crate::{pose::Pose, view::View};

/// Least area of the quadrilateral on the view's plane; about (0.02 degrees)².
const MIN_AREA: f64 = 1e-7;

/// The two poses camera_from_marker that fit the corner rays of a square of this side, in metres; the order means
/// nothing.
///
/// Empty when the rays are no picture of a square: too small, collinear, turned inside out, not convex.
pub(crate) fn square_poses(rays: &[DVec3; 4], side_m: f64) -> Vec<Pose> {
    let Some(poses) = in_view(rays, side_m) else {
        return Vec::new();
    };
    poses.into_iter().flatten().filter(Pose::is_finite).collect()
}

fn in_view(rays: &[DVec3; 4], side_m: f64) -> Option<[Option<Pose>; 2]> {
    let view = View::along(rays)?;
    let mut seen = [DVec2::ZERO; 4];
    for (point, ray) in seen.iter_mut().zip(rays) {
        *point = view.plane_from_ray(*ray)?;
    }
    // Seen from the front, the corners run counterclockwise on paper, so clockwise where y points down; and no corner
    // may be reflex.
    let turn = |i: usize| (seen[(i + 1) % 4] - seen[i]).perp_dot(seen[(i + 2) % 4] - seen[(i + 1) % 4]);
    if (0..4).any(|i| turn(i) > -MIN_AREA) {
        return None;
    }
    let homography = homography_from_square(&seen, 0.5 * side_m)?;
    let centre = homography.z_axis.truncate();
    let [a, b] = rotations(&homography, centre)?;
    let camera_from_view = view.view_from_camera.transpose();
    let pose = |rotation: DMat3| {
        let translation = translation(&rotation, &seen, 0.5 * side_m)?;
        let in_front = square(0.5 * side_m)
            .iter()
            .all(|corner| (rotation * *corner + translation).z > 0.0);
        in_front.then(|| {
            Pose {
                rotation: camera_from_view * rotation,
                translation: camera_from_view * translation,
            }
            .orthonormalized()
        })
    };
    Some([pose(a), pose(b)])
}

/// Corners of a square in its own frame, in metres.
fn square(half: f64) -> [DVec3; 4] {
    [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| DVec3::new(x, y, 0.0))
}

/// The homography from a square of this half side to four points, its last element 1 (Heckbert 1989, section 2.2.3).
fn homography_from_square(points: &[DVec2; 4], half: f64) -> Option<DMat3> {
    let [p0, p1, p2, p3] = *points;
    let (d1, d2, sum) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
    let determinant = d1.perp_dot(d2);
    let g = sum.perp_dot(d2) / determinant;
    let h = d1.perp_dot(sum) / determinant;
    let from_unit = DMat3::from_cols(
        (p1 - p0 + g * p1).extend(g),
        (p3 - p0 + h * p3).extend(h),
        p0.extend(1.0),
    );
    // Unit square from the centred one.
    let scale = 0.5 / half;
    let unit = DMat3::from_cols(
        DVec3::new(scale, 0.0, 0.0),
        DVec3::new(0.0, scale, 0.0),
        DVec3::new(0.5, 0.5, 1.0),
    );
    let homography = from_unit * unit;
    let homography = homography * (1.0 / homography.z_axis.z);
    homography.is_finite().then_some(homography)
}

/// The two rotations that agree with the homography's first derivatives at the square's centre.
fn rotations(homography: &DMat3, centre: DVec2) -> Option<[DMat3; 2]> {
    let [h1, h2] = [homography.x_axis, homography.y_axis];
    let jacobian = DMat2::from_cols(h1.truncate() - centre * h1.z, h2.truncate() - centre * h2.z);
    let sight = rotation_to(centre.extend(1.0).normalize());
    let sight_rows = DMat2::from_cols(sight.x_axis.truncate(), sight.y_axis.truncate());
    let sight_z = DVec2::new(sight.x_axis.z, sight.y_axis.z);
    let projected = sight_rows - DMat2::from_cols(centre * sight_z.x, centre * sight_z.y);
    let a = projected.inverse() * jacobian;
    // Largest singular value of a 2×2 matrix.
    let square = a * a.transpose();
    let (mean, difference) = (
        0.5 * (square.x_axis.x + square.y_axis.y),
        0.5 * (square.x_axis.x - square.y_axis.y),
    );
    let scale = (mean + difference.hypot(square.x_axis.y)).sqrt();
    let upper = a * (1.0 / scale);
    let (c1, c2) = (upper.x_axis, upper.y_axis);
    let b1 = (1.0 - c1.length_squared()).max(0.0).sqrt();
    let b2 = (1.0 - c2.length_squared()).max(0.0).sqrt().copysign(-c1.dot(c2));
    let with_sign = |sign: f64| {
        let (x, y) = (c1.extend(sign * b1), c2.extend(sign * b2));
        sight * DMat3::from_cols(x, y, x.cross(y))
    };
    let pair = [with_sign(1.0), with_sign(-1.0)];
    pair.iter().all(DMat3::is_finite).then_some(pair)
}

/// The rotation that takes z to this unit vector the short way; the vector's z is positive.
fn rotation_to(direction: DVec3) -> DMat3 {
    let DVec3 { x, y, z } = direction;
    let c = 1.0 / (1.0 + z);
    DMat3::from_cols(
        DVec3::new(1.0 - x * x * c, -x * y * c, -x),
        DVec3::new(-x * y * c, 1.0 - y * y * c, -y),
        direction,
    )
}

/// The translation that brings the rotated corners closest to where they are seen, by linear least squares.
fn translation(rotation: &DMat3, seen: &[DVec2; 4], half: f64) -> Option<DVec3> {
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for (corner, point) in square(half).iter().zip(seen) {
        let turned = *rotation * *corner;
        for (row, measured) in [
            (DVec3::new(1.0, 0.0, -point.x), point.x),
            (DVec3::new(0.0, 1.0, -point.y), point.y),
        ] {
            normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            right += row * (measured * turned.z - if row.x == 1.0 { turned.x } else { turned.y });
        }
    }
    let translation = normal.inverse() * right;
    translation.is_finite().then_some(translation)
}
