//! Synthetic truth, found again.
#![allow(clippy::print_stdout, reason = "the figures, with --nocapture")]

use glam::{DMat3, DVec2};

use super::{synthetic::*, *};
use crate::camera::LensModel;

fn request(scene: &Scene) -> Request<'_> {
    Request {
        board: &scene.board,
        size_px: scene.lens.size_px,
        model: scene.lens.lens.model(),
        max_angle_rad: None,
    }
}

fn solve(scene: &Scene, views: &[BoardView]) -> Result<Calibration, IntrinsicsError> {
    calibrate(&request(scene), views, &mut |_| {})
}

/// Rms over the picture of the distance between where the true lens and the one found show the same point.
fn off_px(scene: &Scene, found: &Calibration, reach: Reach, up_to_deg: f64) -> f64 {
    let difference = Difference::new(&scene.lens, &found.intrinsics, [32, 24], reach).expect("comparable");
    difference.rms_px(up_to_deg.to_radians())
}

/// Noise of good corners.
const SIGMA_PX: f64 = 0.05;

#[test]
fn a_pinhole_is_found_whether_the_board_is_flat_or_bowed() {
    let mut scene = Scene::new(pinhole(), 40, 1.0, 1);
    for bow_m in [0.0, 0.001] {
        scene.warp_m = [bow_m, 0.0, 0.0];
        let found = solve(&scene, &scene.views(SIGMA_PX, 1)).unwrap();
        // Where the board was, the goals of the figures; at infinity the noise leaves more.
        let near = off_px(&scene, &found, Reach::Distance(0.6), 180.0);
        assert!(near <= 0.005, "{near}");
        let far = off_px(&scene, &found, Reach::Infinity, 180.0);
        assert!(far <= 0.02, "{far}");
        assert!((found.noise * 0.1 / SIGMA_PX - 1.0).abs() < 0.03, "{}", found.noise);
        for axis in 0..3 {
            let off = (found.board_warp_m[axis] - scene.warp_m[axis]).abs();
            assert!(
                off < 4.0 * found.board_warp_sigma_m[axis],
                "{axis}: {:?}",
                found.board_warp_m
            );
        }
        assert_eq!((found.rejected_views.len(), found.views.len()), (0, 40));
        assert!(found.rejected_corners.len() <= 1, "{:?}", found.rejected_corners);
        let found_parameters = found.intrinsics.parameters();
        for (index, (truth, sigma)) in scene.lens.parameters().iter().zip(found.sigmas()).enumerate() {
            let off = (found_parameters[index] - truth).abs();
            assert!(off < 4.0 * sigma, "{index}: {off} {sigma}");
        }
    }
}

/// A flat board, with its warp taken for zero and with it free: mean squares of the distances over the field.
#[test]
fn a_board_is_bent_only_when_the_corners_ask_for_it() {
    const SEEDS: u64 = 10;
    let (mut flat, mut free, mut n_flat) = (0.0, 0.0, 0);
    for seed in 1..=SEEDS {
        let mut scene = Scene::new(pinhole(), 20, 0.9, 20 + seed);
        let views = scene.views(SIGMA_PX, seed);
        let found = solve(&scene, &views).unwrap();
        n_flat += u32::from(found.board_warp_m == [0.0; 3]);
        assert!(
            found
                .board_warp_sigma_m
                .iter()
                .all(|sigma| (1e-6..1e-4).contains(sigma))
        );
        flat += off_px(&scene, &found, Reach::Infinity, 180.0).powi(2);
        free += off_with_warp_free(&scene, &views).powi(2);
        for bow_m in [0.001, 0.0002] {
            scene.warp_m = [0.0, bow_m, 0.0];
            let found = solve(&scene, &scene.views(SIGMA_PX, seed)).unwrap();
            assert!(
                (found.board_warp_m[1] / bow_m - 1.0).abs() < 0.3,
                "{:?}",
                found.board_warp_m
            );
        }
    }
    println!(
        "rms over the field: flat {:.4} px, warp free {:.4} px",
        (flat / SEEDS as f64).sqrt(),
        (free / SEEDS as f64).sqrt()
    );
    assert!(n_flat >= 9, "{n_flat}");
    assert!(flat < 0.9 * free, "{flat} {free}");
}

fn off_with_warp_free(scene: &Scene, views: &[BoardView]) -> f64 {
    let board = WarpedBoard::new(scene.board.corners_m());
    let (sightings, left_out) = sightings(&board, views).unwrap();
    let mut solver = Solver {
        board: &board,
        model: scene.lens.lens.model(),
        sightings,
        left_out,
        progress: &mut |_| {},
    };
    let start = solver.start(scene.lens.size_px).unwrap();
    let intrinsics = solver.finish(start).unwrap().state.intrinsics;
    let difference = Difference::new(&scene.lens, &intrinsics, [32, 24], Reach::Infinity).unwrap();
    difference.rms_px(4.0)
}

#[test]
fn a_fisheye_of_189_degrees_is_found_and_no_corner_is_cut() {
    let scene = Scene::new(fisheye(), 40, 0.8, 2);
    let views = scene.views(SIGMA_PX, 2);
    let found = solve(&scene, &views).unwrap();
    for (up_to_deg, allowed_px) in [(86.0, 0.01), (94.0, 0.03)] {
        let off = off_px(&scene, &found, Reach::Infinity, up_to_deg);
        assert!(off <= allowed_px, "{up_to_deg}: {off}");
    }
    let corners: usize = views.iter().map(|view| view.corners.len()).sum();
    let used: usize = found.views.iter().map(|view| view.residuals.len()).sum();
    assert!(corners - used <= 1, "{:?}", found.rejected_corners);
    let LensModel::KannalaBrandt { max_angle_rad, .. } = found.intrinsics.lens else {
        panic!()
    };
    assert!(
        (94.5..98.0).contains(&max_angle_rad.to_degrees()),
        "{}",
        max_angle_rad.to_degrees()
    );
    // What was measured is valid.
    assert!(
        views
            .iter()
            .flat_map(|view| &view.corners)
            .all(|c| found.intrinsics.unproject(c.pixel).is_some())
    );
}

#[test]
fn any_focal_length_and_a_centre_far_off_are_found() {
    for (seed, focal_px, k1) in [(1, 330.0, -0.05), (2, 700.0, -0.3), (3, 3000.0, 0.1), (4, 9000.0, 0.0)] {
        let mut lens = pinhole();
        lens.focal_px = DVec2::new(focal_px, 1.02 * focal_px);
        lens.principal_point_px = DVec2::new(639.5 + 128.0, 359.5 - 72.0);
        lens.lens = LensModel::BrownConrady {
            k1,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        };
        let scale = (focal_px / 905.0).max(0.6);
        let scene = Scene::at(lens, 15, 0.9, [0.4 * scale, 1.2 * scale], seed);
        let found = solve(&scene, &scene.views(SIGMA_PX, seed)).unwrap_or_else(|error| panic!("{focal_px}: {error}"));
        for (index, (truth, sigma)) in lens.parameters().iter().zip(found.sigmas()).enumerate() {
            let off = (found.intrinsics.parameters()[index] - truth).abs();
            assert!(off < 4.5 * sigma, "{focal_px} {index}: {off} {sigma}");
        }
    }
    for (seed, focal_px) in [(5, 180.0), (6, 500.0), (7, 900.0)] {
        let mut lens = fisheye();
        lens.focal_px = DVec2::splat(focal_px);
        lens.principal_point_px = DVec2::new(639.5 - 100.0, 479.5 + 80.0);
        let scene = Scene::new(lens, 15, 0.8, seed);
        let found = solve(&scene, &scene.views(SIGMA_PX, seed)).unwrap_or_else(|error| panic!("{focal_px}: {error}"));
        for (index, (truth, sigma)) in lens.parameters().iter().zip(found.sigmas()).enumerate() {
            let off = (found.intrinsics.parameters()[index] - truth).abs();
            assert!(off < 4.5 * sigma, "{focal_px} {index}: {off} {sigma}");
        }
    }
}

/// A real lens (OpenCV's numbers for the fisheye of the camodocal pictures): its polynomial folds back soon after the picture.
#[test]
fn a_lens_whose_polynomial_folds_back_is_found() {
    let mut lens = fisheye();
    lens.focal_px = DVec2::splat(376.2);
    lens.principal_point_px = DVec2::new(639.5, 474.4);
    lens.lens = LensModel::KannalaBrandt {
        k: [0.0473, -0.0557, 0.0255, -0.0046],
        max_angle_rad: 1.45,
    };
    let scene = Scene::new(lens, 14, 0.8, 9);
    let found = solve(&scene, &scene.views(SIGMA_PX, 9)).unwrap();
    assert_eq!(found.views.len(), 14);
    let off = off_px(&scene, &found, Reach::Infinity, 80.0);
    assert!(off < 0.05, "{off}");
}

#[test]
fn wrong_corners_and_wrong_views_are_named() {
    let scene = Scene::new(pinhole(), 14, 0.8, 3);
    let mut views = scene.views(SIGMA_PX, 3);
    let mut wrong = Vec::new();
    for (index, view) in views.iter_mut().enumerate().take(12) {
        for step in [3, 17, 30] {
            view.corners[step].pixel += DVec2::new(if index % 2 == 0 { 2.0 } else { -0.7 }, 0.9);
            wrong.push((view.name.clone(), view.corners[step].corner));
        }
    }
    // Two boards in one view: the lower half has moved.
    let half = views[13].corners.len() / 2;
    for corner in &mut views[13].corners[half..] {
        corner.pixel += DVec2::new(14.0, -9.0);
    }
    views[12].corners.truncate(5);
    let found = solve(&scene, &views).unwrap();
    let named: Vec<_> = found
        .rejected_corners
        .iter()
        .map(|c| (c.view.clone(), c.corner))
        .collect();
    assert_eq!(named, wrong);
    let views: Vec<_> = found
        .rejected_views
        .iter()
        .map(|view| (view.name.as_str(), view.reason))
        .collect();
    assert_eq!(
        views,
        [
            ("012.png", RejectedBecause::TooFewCorners),
            ("013.png", RejectedBecause::DoesNotFit)
        ]
    );
    let off = off_px(&scene, &found, Reach::Distance(0.8), 180.0);
    assert!(off < 0.015, "{off}");
}

#[test]
fn the_predicted_uncertainty_is_what_chance_does() {
    const TRIALS: u64 = 30;
    for (lens, reaches) in [
        (pinhole(), vec![Reach::Infinity, Reach::Distance(0.7)]),
        (fisheye(), vec![Reach::Infinity]),
    ] {
        let scene = Scene::new(lens, 12, 0.8, 4);
        let mut squares = vec![[0.0, 0.0]; reaches.len()];
        for trial in 0..TRIALS {
            let mut views = scene.views(SIGMA_PX, 100 + trial);
            for view in &mut views {
                view.corners.retain(|corner| corner.corner % 3 == 0);
            }
            let found = solve(&scene, &views).unwrap();
            for (reach, [happened, predicted]) in reaches.iter().zip(&mut squares) {
                // The same rays for the prediction and for the trial: those of the true lens.
                let map = UncertaintyMap::new(&scene.lens, &found.covariance, [16, 12], *reach).unwrap();
                let difference = Difference::new(&scene.lens, &found.intrinsics, [16, 12], *reach).unwrap();
                *happened += difference.rms_px(7.0).powi(2);
                *predicted += map.rms_px().powi(2);
            }
        }
        for [happened, predicted] in squares {
            let ratio = (happened / predicted).sqrt();
            assert!((1.0 / 1.3..1.3).contains(&ratio), "{ratio}");
            println!("happened over predicted: {ratio:.3}");
        }
    }
}

#[test]
fn what_cannot_be_calibrated_is_said() {
    let scene = Scene::new(pinhole(), 12, 0.8, 5);
    let views = scene.views(SIGMA_PX, 5);
    let error = solve(&scene, &views[..2]).unwrap_err();
    assert!(
        matches!(
            error,
            IntrinsicsError::TooFewViews {
                usable: 2,
                given: 2,
                ..
            }
        ),
        "{error}"
    );
    let mut poor = views[..4].to_vec();
    poor[1].corners.truncate(5);
    poor[2].corners.truncate(3);
    let error = solve(&scene, &poor).unwrap_err().to_string();
    assert!(error.contains("`001.png`: too few corners"), "{error}");

    // All views parallel: one orientation, many places.
    let mut parallel = Scene::new(pinhole(), 12, 0.3, 6);
    for pose in &mut parallel.poses {
        pose.rotation = DMat3::from_diagonal(glam::DVec3::new(1.0, -1.0, -1.0));
        pose.translation = glam::DVec3::new(-0.33, 0.33, 1.0 + 0.5 * pose.translation.x.abs());
    }
    let error = solve(&parallel, &parallel.views(SIGMA_PX, 6)).unwrap_err();
    assert!(
        matches!(error, IntrinsicsError::Parallel { spread_deg, .. } if spread_deg < 3.0),
        "{error}"
    );

    // Another spacing than the file says.
    let mut other = request(&scene);
    let board = Board::AprilGrid {
        family: crate::tag::Family::Tag36h11,
        columns: 6,
        rows: 6,
        side_m: 0.088,
        spacing_m: 0.04,
        border_bits: 2,
        first_id: 0,
    };
    other.board = &board;
    let error = calibrate(&other, &views, &mut |_| {}).unwrap_err();
    assert!(matches!(error, IntrinsicsError::Mismatch { .. }), "{error}");

    // A smaller board than the corners.
    let small = Board::Chessboard {
        columns: 5,
        rows: 4,
        square_m: 0.1,
    };
    other.board = &small;
    let error = calibrate(&other, &views, &mut |_| {}).unwrap_err();
    assert!(
        matches!(error, IntrinsicsError::NoSuchCorner { last: 19, .. }),
        "{error}"
    );
}

#[test]
fn mirrored_pictures_and_mixed_sizes_are_said() {
    let scene = Scene::new(pinhole(), 12, 0.8, 5);
    let views = scene.views(SIGMA_PX, 5);
    // A mirror.
    let mut mirrored = views.clone();
    for corner in mirrored.iter_mut().flat_map(|view| &mut view.corners) {
        corner.pixel.x = 1279.0 - corner.pixel.x;
    }
    let error = solve(&scene, &mirrored).unwrap_err();
    assert!(
        matches!(
            error,
            IntrinsicsError::Mirrored {
                mirrored: 12,
                views: 12,
                ..
            }
        ),
        "{error}"
    );

    let sizes = [
        ("a.png".to_owned(), [640, 480]),
        ("b.png".to_owned(), [640, 480]),
        ("c.png".to_owned(), [800, 600]),
    ];
    assert_eq!(common_size(&sizes[..2]), Ok([640, 480]));
    let error = common_size(&sizes).unwrap_err().to_string();
    assert_eq!(error, "view `c.png` has `800×600` pixels, `a.png` has `640×480`");
}

#[test]
fn corners_that_make_no_sense_are_refused() {
    let scene = Scene::new(pinhole(), 3, 0.8, 7);
    let mut views = scene.views(SIGMA_PX, 7);
    views[1].corners[4].pixel.x = f64::NAN;
    let error = solve(&scene, &views).unwrap_err().to_string();
    assert!(
        error.contains("of view `001.png` is not usable: its numbers are not finite"),
        "{error}"
    );
    let mut views = scene.views(SIGMA_PX, 7);
    views[2].corners[4].corner = views[2].corners[3].corner;
    let error = solve(&scene, &views).unwrap_err().to_string();
    assert!(error.contains("it is given twice"), "{error}");
}

#[test]
fn every_model_is_found_from_its_own_pictures() {
    let models = [
        (
            Model::Rational,
            vec![0.31, -0.12, 4e-4, -3e-4, 0.02, 0.55, -0.1, 0.01],
            905.0,
        ),
        (Model::Equisolid, vec![], 420.0),
        (Model::Eucm, vec![0.57, 1.12], 350.0),
        (Model::DoubleSphere, vec![-0.18, 0.59], 320.0),
    ];
    for (model, coefficients, focal_px) in models {
        let mut lens = if model.is_fisheye() { fisheye() } else { pinhole() };
        lens.focal_px = DVec2::new(focal_px, 1.003 * focal_px);
        lens.lens = LensModel::from_coefficients(model, &coefficients, 1.6).unwrap();
        let scene = Scene::new(lens, 20, 0.8, 8);
        let found = solve(&scene, &scene.views(SIGMA_PX, 8)).unwrap_or_else(|error| panic!("{model}: {error}"));
        assert!(
            (found.noise * 0.1 / SIGMA_PX - 1.0).abs() < 0.04,
            "{model}: {}",
            found.noise
        );
        let reach = if model.is_fisheye() {
            Reach::Infinity
        } else {
            Reach::Distance(0.8)
        };
        let off = off_px(&scene, &found, reach, 90.0);
        let predicted = found.uncertainty([32, 24], reach).expect("known").rms_px();
        assert!(predicted < 0.03 && off < 2.5 * predicted, "{model}: {off} {predicted}");
    }
}
