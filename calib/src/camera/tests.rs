//! Camera models against round trips, differences and numbers of others.

use std::f64::consts::PI;

use proptest::prelude::*;

use super::*;

fn with_lens(lens: LensModel) -> Intrinsics {
    Intrinsics {
        size_px: [640, 480],
        focal_px: DVec2::new(605.5, 604.0),
        principal_point_px: DVec2::new(320.9, 238.4),
        lens,
    }
}

fn perspective() -> impl Strategy<Value = Intrinsics> {
    let small = -0.002f64..0.002;
    (-0.35f64..0.2, -0.1f64..0.15, small.clone(), small, -0.05f64..0.05)
        .prop_map(|(k1, k2, p1, p2, k3)| with_lens(LensModel::BrownConrady { k1, k2, p1, p2, k3 }))
}

fn fisheye() -> impl Strategy<Value = Intrinsics> {
    (
        -0.03f64..0.03,
        -0.008f64..0.01,
        -0.003f64..0.003,
        -0.0004f64..0.0004,
        0.8f64..1.75,
    )
        .prop_map(|(a, b, c, d, max_angle_rad)| {
            with_lens(LensModel::KannalaBrandt {
                k: [a, b, c, d],
                max_angle_rad,
            })
        })
        .prop_filter("one to one", |intrinsics| intrinsics.lens.is_usable())
}

fn equisolid() -> impl Strategy<Value = Intrinsics> {
    (0.3f64..3.1).prop_map(|max_angle_rad| with_lens(LensModel::Equisolid { max_angle_rad }))
}

/// Coefficients as OpenCV finds them: numerator and denominator nearly cancel.
fn rational() -> impl Strategy<Value = Intrinsics> {
    let small = -0.002f64..0.002;
    (
        (-0.5f64..8.0, -0.35f64..0.2),
        (-0.3f64..3.0, -0.1f64..0.1),
        (small.clone(), small),
        (-0.02f64..0.1, -0.02f64..0.02),
    )
        .prop_map(|((k4, d1), (k5, d2), (p1, p2), (k6, d3))| {
            with_lens(LensModel::Rational {
                coefficients: [k4 + d1, k5 + d2, p1, p2, k6 + d3, k4, k5, k6],
            })
        })
        .prop_filter("one to one", |intrinsics| intrinsics.lens.is_usable())
}

fn eucm() -> impl Strategy<Value = Intrinsics> {
    (0.0f64..=1.0, 0.3f64..3.0, prop_oneof![Just(PI), 0.3f64..2.5]).prop_map(|(alpha, beta, max_angle_rad)| {
        with_lens(LensModel::Eucm {
            alpha,
            beta,
            max_angle_rad,
        })
    })
}

fn double_sphere() -> impl Strategy<Value = Intrinsics> {
    (-0.9f64..0.9, 0.0f64..=1.0, prop_oneof![Just(PI), 0.3f64..2.5]).prop_map(|(xi, alpha, max_angle_rad)| {
        with_lens(LensModel::DoubleSphere {
            xi,
            alpha,
            max_angle_rad,
        })
    })
}

fn any_lens() -> impl Strategy<Value = Intrinsics> {
    prop_oneof![
        perspective(),
        rational(),
        fisheye(),
        equisolid(),
        eucm(),
        double_sphere()
    ]
}

/// A direction at `part` of the largest angle at which the lens images something within three focal lengths.
fn seen(lens: &Intrinsics, part: f64, turn: f64) -> DVec3 {
    let three = lens.principal_point_px + 3.0 * lens.focal_px.x * DVec2::X;
    let end = match lens.unproject(three) {
        Some(ray) => ray.angle_between(DVec3::Z),
        None => lens.lens.max_angle_rad().unwrap_or(lens.max_radius().atan()),
    };
    ray(part * end, turn)
}

fn ray(angle: f64, turn: f64) -> DVec3 {
    DVec3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos())
}

/// Central differences; the third derivatives of these lenses are below 1e4 px per metre³, so h = 1e-5 is good to
/// 1e-5.
fn check_gradient(intrinsics: &Intrinsics, point: DVec3) {
    let projection = intrinsics.project_with_gradient(point).expect("visible");
    let step = 1e-5 * point.length();
    for axis in DVec3::AXES {
        let ahead = intrinsics.project(point + axis * step);
        let behind = intrinsics.project(point - axis * step);
        let (Some(ahead), Some(behind)) = (ahead, behind) else {
            continue;
        };
        let numeric = (ahead - behind) / (2.0 * step);
        let exact = DVec2::new(projection.gradient[0].dot(axis), projection.gradient[1].dot(axis));
        assert!(
            numeric.distance(exact) < 1e-5 * (1.0 + exact.length()),
            "{numeric} {exact} at {point}"
        );
    }
}

/// Central differences of the pixel by every parameter.
fn check_parameters(intrinsics: &Intrinsics, point: DVec3) {
    let jacobians = intrinsics.project_with_jacobians(point).expect("visible");
    let parameters = intrinsics.parameters();
    assert_eq!(parameters.len(), intrinsics.lens.model().parameter_names().len());
    for index in 0..parameters.len() {
        let step = 1e-6 * parameters[index].abs().max(1.0);
        let moved = |sign: f64| {
            let mut parameters = parameters.clone();
            parameters[index] += sign * step;
            intrinsics.with_parameters(&parameters).project(point)
        };
        let (Some(ahead), Some(behind)) = (moved(1.0), moved(-1.0)) else {
            continue;
        };
        let numeric = (ahead - behind) / (2.0 * step);
        for axis in 0..2 {
            let exact = jacobians.by_parameters[axis][index];
            assert!(
                (numeric[axis] - exact).abs() < 1e-4 * (1.0 + exact.abs()),
                "{index}: {numeric} {exact} {intrinsics:?} {point}"
            );
        }
    }
    assert!(
        jacobians
            .by_parameters
            .iter()
            .all(|row| row[parameters.len()..].iter().all(|&x| x == 0.0))
    );
}

proptest! {
    #[test]
    fn round_trip(lens in any_lens(), part in 0.0f64..0.98, turn in 0.0..2.0 * PI, distance in 0.1f64..10.0) {
        let direction = seen(&lens, part, turn);
        let pixel = lens.project(direction * distance).expect("a direction that the lens images");
        let back = lens.unproject(pixel).expect("a pixel that a ray maps to");
        prop_assert!(back.distance(direction) < 1e-8, "{} {}", back, direction);
        check_gradient(&lens, direction * distance);
        check_parameters(&lens, direction * distance);
        check_parameters(&lens, DVec3::Z * distance);
    }

    #[test]
    fn a_fisheye_images_everything_up_to_its_largest_angle_and_nothing_beyond(
        lens in prop_oneof![fisheye(), equisolid(), eucm(), double_sphere()], turn in 0.0..2.0 * PI,
    ) {
        let end = lens.lens.max_angle_rad().expect("a fisheye");
        prop_assert!(lens.lens.is_usable());
        let mut radius = 0.0;
        for step in 1..=400 {
            let direction = ray(end * (1.0 - 1e-12) * f64::from(step) / 400.0, turn);
            let pixel = lens.project(direction).expect("within the largest angle");
            let next = ((pixel - lens.principal_point_px) / lens.focal_px).length();
            prop_assert!(next > radius, "{} {}", next, radius);
            radius = next;
        }
        if end < PI - 1e-6 {
            prop_assert_eq!(lens.project(ray(end + 1e-6, turn)), None);
        }
        let beyond = lens.principal_point_px + 1.000_001 * radius * lens.focal_px * DVec2::from_angle(turn);
        prop_assert_eq!(lens.unproject(beyond), None);
    }

    #[test]
    fn eucm_is_what_its_paper_says(
        alpha in 0.0f64..=1.0, beta in 0.3f64..3.0, angle in 0.0..PI, turn in 0.0..2.0 * PI, distance in 0.1f64..10.0,
    ) {
        let lens = with_lens(LensModel::Eucm { alpha, beta, max_angle_rad: PI });
        let point = ray(angle, turn) * distance;
        let DVec3 { x, y, z } = point;
        let rho = (beta * (x * x + y * y) + z * z).sqrt();
        // Projectable where z > -w ρ.
        let w = if alpha <= 0.5 { alpha / (1.0 - alpha) } else { (1.0 - alpha) / alpha };
        let denominator = alpha * rho + (1.0 - alpha) * z;
        let expected = DVec2::new(x / denominator, y / denominator);
        // At the border itself rounding decides, and pictures are cut at 1000 focal lengths.
        prop_assume!((z + w * rho).abs() > 1e-9 * distance && expected.length() < 900.0);
        let found = lens.project(point).map(|pixel| (pixel - lens.principal_point_px) / lens.focal_px);
        prop_assert_eq!(found.is_some(), z > -w * rho);
        if let Some(found) = found {
            prop_assert!(found.distance(expected) < 1e-9 * (1.0 + expected.length_squared()), "{} {}", found, expected);
            let r2 = expected.length_squared();
            let depth = (1.0 - beta * alpha * alpha * r2)
                / (alpha * (1.0 - (2.0 * alpha - 1.0) * beta * r2).max(0.0).sqrt() + (1.0 - alpha));
            // Where the picture folds back the angle is a square root of the radius.
            let back = lens.unproject(lens.project(point).unwrap()).expect("a pixel of the picture");
            prop_assert!(depth.is_nan() || back.distance(expected.extend(depth).normalize()) < 1e-5);
        }
    }

    #[test]
    fn double_sphere_is_what_its_paper_says(
        xi in -0.9f64..0.9, alpha in 0.0f64..=1.0, angle in 0.0..PI, turn in 0.0..2.0 * PI, distance in 0.1f64..10.0,
    ) {
        let lens = with_lens(LensModel::DoubleSphere { xi, alpha, max_angle_rad: PI });
        let point = ray(angle, turn) * distance;
        let DVec3 { x, y, z } = point;
        let d1 = (x * x + y * y + z * z).sqrt();
        let d2 = (x * x + y * y + (xi * d1 + z).powi(2)).sqrt();
        let denominator = alpha * d2 + (1.0 - alpha) * (xi * d1 + z);
        let expected = DVec2::new(x / denominator, y / denominator);
        let Some(pixel) = lens.project(point) else {
            // Not imaged: behind the centre of projection, or folded back into the picture.
            let next = ray(angle + 1e-6, turn);
            let d2 = (1.0 + 2.0 * xi * next.z + xi * xi).sqrt();
            let radius = next.truncate().length() / (alpha * d2 + (1.0 - alpha) * (xi + next.z));
            let is_folded = radius <= expected.length();
            prop_assert!(denominator <= 0.0 || expected.length() > 900.0 || is_folded);
            return Ok(());
        };
        let found = (pixel - lens.principal_point_px) / lens.focal_px;
        prop_assert!(found.distance(expected) < 1e-9 * (1.0 + expected.length_squared()), "{} {}", found, expected);
        // Equations 46 to 49.
        let r2 = expected.length_squared();
        let mz = (1.0 - alpha * alpha * r2) / (alpha * (1.0 - (2.0 * alpha - 1.0) * r2).max(0.0).sqrt() + 1.0 - alpha);
        let scale = (mz * xi + (mz * mz + (1.0 - xi * xi) * r2).sqrt()) / (mz * mz + r2);
        let ray = (expected.extend(mz) * scale - DVec3::Z * xi).normalize();
        let back = lens.unproject(pixel).expect("a pixel of the picture");
        prop_assert!(!ray.is_finite() || back.distance(ray) < 1e-5, "{} {}", back, ray);
    }

    #[test]
    fn unprojected_pixels_project_back(lens in any_lens(), x in -50.0f64..700.0, y in -50.0f64..530.0) {
        let pixel = DVec2::new(x, y);
        if let Some(ray) = lens.unproject(pixel) {
            prop_assert!((ray.length() - 1.0).abs() < 1e-12);
            let back = lens.project(ray).expect("a ray of the lens");
            prop_assert!(back.distance(pixel) < 1e-6, "{} {}", back, pixel);
        }
    }

    #[test]
    fn nothing_panics(lens in any_lens(), x: f64, y: f64, z: f64, wild: [f64; 8]) {
        let parameters = [&lens.parameters()[..4], &wild].concat();
        let _ = lens.with_parameters(&parameters).project_with_jacobians(DVec3::new(x, y, z));
        let _ = lens.with_parameters(&parameters).unproject(DVec2::new(x, y));
        let _ = lens.project_with_jacobians(DVec3::new(x, y, z));
        let _ = lens.unproject(DVec2::new(x, y));
    }
}

#[test]
fn the_largest_radius_is_where_the_formula_folds_back() {
    // r (1 - 0.3 r²) has its maximum at r² = 1 / 0.9.
    let lens = with_lens(LensModel::BrownConrady {
        k1: -0.3,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    });
    let largest = (1.0f64 / 0.9).sqrt();
    assert!((lens.max_radius() - largest).abs() < 1e-9);
    assert!(lens.project(DVec3::new(largest * 0.999, 0.0, 1.0)).is_some());
    assert_eq!(lens.project(DVec3::new(largest * 1.001, 0.0, 1.0)), None);
    let beyond = lens.principal_point_px.x + 1.001 * lens.focal_px.x * largest * 2.0 / 3.0;
    assert_eq!(lens.unproject(DVec2::new(beyond, lens.principal_point_px.y)), None);
}

#[test]
fn a_lens_without_distortion_is_a_pinhole() {
    let lens = with_lens(LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    });
    assert_eq!(lens.max_radius(), MAX_TANGENT);
    let pixel = lens.project(DVec3::new(0.1, -0.2, 0.5)).expect("in front");
    assert!(pixel.distance(DVec2::new(320.9 + 605.5 * 0.2, 238.4 - 604.0 * 0.4)) < 1e-12);
}

#[test]
fn what_is_behind_the_camera_or_not_finite_is_not_seen() {
    let lens = with_lens(LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    });
    for point in [DVec3::NEG_Z, DVec3::ZERO, DVec3::X, DVec3::NAN, DVec3::INFINITY] {
        assert_eq!(lens.project(point), None, "{point}");
    }
    assert_eq!(lens.unproject(DVec2::new(f64::NAN, 0.0)), None);
}

#[test]
fn a_fisheye_sees_behind_itself_up_to_its_largest_angle() {
    let max_angle_rad = 92.5f64.to_radians();
    let lens = with_lens(LensModel::KannalaBrandt {
        k: [-0.0121, 0.0058, -0.0021, 0.00021],
        max_angle_rad,
    });
    assert!(lens.lens.is_usable());
    assert!(lens.project(ray(92.4f64.to_radians(), 1.0)).is_some());
    assert_eq!(lens.project(ray(92.6f64.to_radians(), 1.0)), None);
    assert_eq!(lens.project(DVec3::Z * 2.0), Some(lens.principal_point_px));
    assert_eq!(lens.project(DVec3::NEG_Z), None);
}

#[test]
fn equal_solid_angles_have_equal_areas_in_an_equisolid_lens() {
    let lens = with_lens(LensModel::Equisolid { max_angle_rad: 2.0 });
    // Area of the zone between two angles over its solid angle 2π (cos a - cos b) is f².
    for (a, b) in [(0.0f64, 0.1f64), (0.7, 0.8), (1.8, 1.99)] {
        let radius = |angle: f64| {
            let pixel = lens.project(ray(angle, 0.0)).expect("inside") - lens.principal_point_px;
            pixel.x / lens.focal_px.x
        };
        let area = PI * (radius(b).powi(2) - radius(a).powi(2));
        let solid_angle = 2.0 * PI * (a.cos() - b.cos());
        assert!((area / solid_angle - 1.0).abs() < 1e-12);
    }
    assert!((lens.project(ray(1.0, 0.0)).expect("inside").x - (320.9 + 605.5 * 2.0 * 0.5f64.sin())).abs() < 1e-9);
}

#[test]
fn the_rim_of_a_fisheye_is_as_far_as_its_picture_says() {
    for lens in [
        LensModel::Equisolid { max_angle_rad: 1.6 },
        LensModel::KannalaBrandt {
            k: [-0.0121, 0.0058, -0.0021, 0.00021],
            max_angle_rad: 1.6,
        },
        LensModel::Eucm {
            alpha: 0.6,
            beta: 1.1,
            max_angle_rad: 1.6,
        },
        LensModel::DoubleSphere {
            xi: -0.2,
            alpha: 0.6,
            max_angle_rad: 1.6,
        },
    ] {
        let lens = with_lens(lens);
        let point = 0.7 * ray(1.2, 0.8);
        let rim = lens.project(ray(1.6 - 1e-12, 0.8)).expect("inside");
        let apart = lens.project(point).expect("inside").distance(rim);
        assert!((lens.distance_to_rim_px(point) - apart).abs() < 1e-6);
        assert!(lens.distance_to_rim_px(ray(1.7, 0.3)) < 0.0);
    }
    let perspective = with_lens(LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    });
    assert_eq!(perspective.distance_to_rim_px(DVec3::Z), f64::INFINITY);
}

#[test]
fn the_rational_lens_is_opencvs() {
    let lens = with_lens(LensModel::Rational {
        coefficients: [0.8, 0.06, 1e-3, -7e-4, 0.004, 1.05, 0.09, 0.006],
    });
    // cv2.projectPoints of OpenCV 5.0.0 with these coefficients, no rotation and no translation.
    for (point, expected) in [
        ([0.1, -0.2, 0.5], [436.6740165718693, 7.377258829367349]),
        ([-0.7, 0.4, 1.0], [-60.73184153321006, 456.1706618389137]),
        ([0.03, 0.9, 1.2], [334.4140612481314, 650.3002943743046]),
        ([1.5, -1.1, 1.0], [1024.5700662621448, -275.3293161541086]),
    ] {
        let pixel = lens.project(DVec3::from_array(point)).expect("in front");
        assert!(
            pixel.distance(DVec2::from_array(expected)) < 1e-9,
            "{pixel} {expected:?}"
        );
    }
}

#[test]
fn a_rational_lens_ends_at_its_pole_and_where_it_folds_back() {
    let lens = |k1: f64, k4: f64| {
        with_lens(LensModel::Rational {
            coefficients: [k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, 0.0],
        })
    };
    // r (1 + 0.1 r²) / (1 - 0.5 r²) has a pole at r² = 2 and rises up to it.
    assert!((lens(0.1, -0.5).max_radius() - 2.0f64.sqrt()).abs() < 1e-9);
    // r / (1 + r²) is largest at r = 1; r (1 + r²) / (1 + 2 r²) rises everywhere.
    assert!((lens(0.0, 1.0).max_radius() - 1.0).abs() < 1e-9);
    assert_eq!(lens(0.0, 1.0).project(DVec3::new(1.001, 0.0, 1.0)), None);
    assert_eq!(lens(1.0, 2.0).max_radius(), MAX_TANGENT);
}

#[test]
fn lenses_of_spheres_see_behind_themselves() {
    let cases = [
        // Like the wide lenses of Usenko et al. 2018, table 2.
        LensModel::DoubleSphere {
            xi: -0.2,
            alpha: 0.59,
            max_angle_rad: PI,
        },
        LensModel::Eucm {
            alpha: 0.63,
            beta: 1.04,
            max_angle_rad: PI,
        },
    ];
    for lens in cases {
        let lens = with_lens(lens);
        assert!(lens.lens.max_angle_rad().unwrap() > 110f64.to_radians());
        let direction = ray(110f64.to_radians(), 0.7);
        let pixel = lens.project(3.0 * direction).expect("110 degrees off the axis");
        assert!(lens.unproject(pixel).expect("in the picture").distance(direction) < 1e-12);
    }
}

#[test]
fn lenses_of_spheres_contain_each_other() {
    // The unified model is both; with alpha = 0 it is a pinhole.
    let point = DVec3::new(0.4, -0.3, 0.7);
    for (alpha, pinhole) in [(0.0, true), (0.6, false)] {
        let eucm = with_lens(LensModel::Eucm {
            alpha,
            beta: 1.0,
            max_angle_rad: PI,
        });
        let spheres = with_lens(LensModel::DoubleSphere {
            xi: 0.0,
            alpha,
            max_angle_rad: PI,
        });
        let pixel = eucm.project(point).unwrap();
        assert!(pixel.distance(spheres.project(point).unwrap()) < 1e-10);
        let ideal = eucm.focal_px * point.truncate() / point.z + eucm.principal_point_px;
        assert_eq!(pixel.distance(ideal) < 1e-10, pinhole);
    }
}

#[test]
fn a_picture_shows_as_much_as_its_corners_or_its_rim() {
    let k = [-0.0121, 0.0058, -0.0021, 0.00021];
    let cropped = with_lens(LensModel::KannalaBrandt { k, max_angle_rad: 1.6 });
    let corner = cropped.unproject(DVec2::new(-0.5, 479.5)).expect("the farthest corner");
    assert_eq!(cropped.largest_angle_rad(), corner.angle_between(DVec3::Z));
    let round = Intrinsics {
        focal_px: DVec2::splat(150.0),
        ..cropped
    };
    assert_eq!(round.largest_angle_rad(), 1.6);
    let pinhole = with_lens(LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    });
    let corner = DVec2::new(321.4 / 605.5, 241.1 / 604.0);
    assert!((pinhole.largest_angle_rad() - corner.length().atan()).abs() < 1e-12);
}

#[test]
fn coefficients_that_describe_no_lens_are_not_usable() {
    for lens in [
        LensModel::Eucm {
            alpha: 0.5,
            beta: 0.0,
            max_angle_rad: PI,
        },
        LensModel::Eucm {
            alpha: f64::NAN,
            beta: 1.0,
            max_angle_rad: PI,
        },
        LensModel::DoubleSphere {
            xi: 1.0,
            alpha: 0.5,
            max_angle_rad: PI,
        },
        LensModel::DoubleSphere {
            xi: 0.1,
            alpha: 0.5,
            max_angle_rad: 0.0,
        },
        LensModel::Rational {
            coefficients: [0.0, 0.0, 0.4, 0.0, 0.0, 0.1, 0.0, 0.0],
        },
    ] {
        assert!(!lens.is_usable(), "{lens:?}");
    }
}
