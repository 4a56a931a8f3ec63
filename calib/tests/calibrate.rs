//! From pictures to a lens: boards rendered with exactly known corners, detected, calibrated, compared with the truth.

#![allow(clippy::print_stdout, reason = "the figures, with --nocapture")]

#[path = "support/board_pictures.rs"]
mod board_pictures;

use std::f64::consts::TAU;

use board_pictures::{BoardCamera, Look, Noise, board_pose};
use glam::{DVec2, DVec3};
use mirrorball_calib::{
    board::{Board, BoardDetector, BoardView},
    camera::{Intrinsics, LensModel},
    intrinsics::{Calibration, Difference, Reach, Request, calibrate},
    pose::Pose,
    response::ResponseCurve,
    tag::Family,
};
use rayon::prelude::*;

const VIEWS: u64 = 40;

/// Largest angle between the board's normal and the line of sight.
const TILT_DEG: f64 = 50.0;

/// Corners that a picture must show.
const MIN_CORNERS: usize = 48;

fn board() -> Board {
    Board::AprilGrid {
        family: Family::Tag36h11,
        columns: 6,
        rows: 6,
        side_m: 0.088,
        spacing_m: 0.0264,
        border_bits: 1,
        first_id: 0,
    }
}

fn pinhole() -> Intrinsics {
    Intrinsics {
        size_px: [640, 480],
        focal_px: DVec2::new(512.7, 511.2),
        principal_point_px: DVec2::new(324.6, 236.1),
        lens: LensModel::BrownConrady {
            k1: -0.21,
            k2: 0.08,
            p1: 7e-4,
            p2: -5e-4,
            k3: -0.012,
        },
    }
}

/// A round picture of 189 degrees.
fn fisheye() -> Intrinsics {
    Intrinsics {
        size_px: [800, 680],
        focal_px: DVec2::new(204.6, 204.1),
        principal_point_px: DVec2::new(402.3, 337.2),
        lens: LensModel::KannalaBrandt {
            k: [0.012, -0.0081, 0.0022, -0.0004],
            max_angle_rad: 94.5f64.to_radians(),
        },
    }
}

/// A pose with the middle of the board anywhere in the picture, tilted and rolled by chance, that shows enough corners.
fn pose(camera: &BoardCamera, distance_m: [f64; 2], chance: &mut Noise) -> Pose {
    let [width, height] = camera.size();
    loop {
        let pixel = DVec2::new(chance.uniform() * width as f64, chance.uniform() * height as f64) - 0.5;
        let tilt = TILT_DEG.to_radians() * chance.uniform();
        let about = TAU * chance.uniform();
        let roll = TAU * chance.uniform();
        let distance = distance_m[0] + (distance_m[1] - distance_m[0]) * chance.uniform();
        let Some(towards) = camera.intrinsics.unproject(pixel) else {
            continue;
        };
        let turns = DVec3::new(tilt * about.cos(), tilt * about.sin(), roll);
        let pose = board_pose(&board(), distance, turns, towards);
        let shown = camera.exact_corners(&board(), &pose).into_iter().flatten().count();
        if pose.inverse().translation.z > 0.0 && shown >= MIN_CORNERS {
            return pose;
        }
    }
}

struct Run {
    truth: Intrinsics,
    calibration: Calibration,
    /// Rms of a coordinate of the corners that are believed, against the exact ones, in pixels.
    corners_px: f64,
    /// How far the rejected corners are from the exact ones, in pixels.
    rejected_px: Vec<f64>,
    n_corners: usize,
}

/// Takes the pictures, finds the boards in them, and calibrates.
fn run(truth: &Intrinsics, bow_m: f64, distance_m: [f64; 2]) -> Run {
    let mut camera = BoardCamera::new(truth);
    camera.bow_m = bow_m;
    let mut chance = Noise(7);
    let poses: Vec<Pose> = (0..VIEWS).map(|_| pose(&camera, distance_m, &mut chance)).collect();
    let views: Vec<BoardView> = poses
        .par_iter()
        .enumerate()
        .map(|(index, pose)| {
            let look = Look {
                full_well_e: 20_000.0,
                seed: 100 + index as u64,
                ..Look::default()
            };
            let rgb = camera.picture(&board(), pose, &look);
            let mut detector = BoardDetector::new(&board());
            let found = detector.detect(&index.to_string(), &rgb, camera.size(), &ResponseCurve::srgb());
            found.unwrap_or_else(|error| panic!("{index}: {}", error.reason)).view
        })
        .collect();
    let request = Request {
        board: &board(),
        size_px: truth.size_px,
        model: truth.lens.model(),
        max_angle_rad: None,
    };
    let calibration = calibrate(&request, &views, &mut |_| {}).expect("good pictures");
    let exact: Vec<_> = poses.iter().map(|pose| camera.exact_corners(&board(), pose)).collect();
    let off_px = |view: &str, corner: u32, pixel: DVec2| {
        let view: usize = view.parse().expect("named by a number");
        exact[view][corner as usize].map_or(f64::INFINITY, |exact| exact.distance(pixel))
    };
    let believed = calibration.views.iter().flat_map(|view| {
        view.residuals
            .iter()
            .map(|r| off_px(&view.name, r.corner, r.pixel).powi(2))
    });
    let (sum, count) = believed.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    let rejected = calibration.rejected_corners.iter();
    Run {
        truth: *truth,
        corners_px: (0.5 * sum / count).sqrt(),
        n_corners: views.iter().map(|view| view.corners.len()).sum(),
        rejected_px: rejected.map(|c| off_px(&c.view, c.corner, c.pixel)).collect(),
        calibration,
    }
}

impl Run {
    /// Every view takes part, and no corner is cut but what the detector has put elsewhere.
    fn assert_nothing_is_cut(&self) {
        assert_eq!(self.calibration.views.len(), VIEWS as usize);
        assert!(self.rejected_px.len() <= self.n_corners / 200, "{:?}", self.rejected_px);
        let honest = 3.0 * self.corners_px;
        assert!(
            self.rejected_px.iter().all(|off| *off > honest),
            "{:?}",
            self.rejected_px
        );
    }

    /// Rms over the field up to an angle to the axis, at infinity.
    fn off_px(&self, up_to_deg: f64) -> f64 {
        let found = &self.calibration.intrinsics;
        let difference = Difference::new(&self.truth, found, [32, 24], Reach::Infinity).expect("comparable");
        difference.rms_px(up_to_deg.to_radians())
    }

    fn print(&self, name: &str, up_to_deg: &[f64]) {
        let predicted = self
            .calibration
            .uncertainty([32, 24], Reach::Infinity)
            .expect("known")
            .rms_px();
        println!(
            "{name}: {} corners of {:.4} px, out are those off by {:.3?} px; warp {:?} ± {:?} m; predicted {predicted:.4} px",
            self.n_corners,
            self.corners_px,
            self.rejected_px,
            self.calibration.board_warp_m,
            self.calibration.board_warp_sigma_m,
        );
        for &angle in up_to_deg {
            println!("  rms over the field to {angle} degrees: {:.4} px", self.off_px(angle));
        }
    }
}

#[test]
fn a_pinhole_is_calibrated_from_pictures_of_a_flat_board_and_of_a_bowed_one() {
    for (name, bow_m, allowed_px) in [("flat", 0.0, 0.005), ("bowed by 1 mm", 0.001, 0.01)] {
        let run = run(&pinhole(), bow_m, [0.5, 0.9]);
        run.print(name, &[180.0]);
        run.assert_nothing_is_cut();
        assert!(run.off_px(180.0) <= allowed_px, "{name}: {}", run.off_px(180.0));
        let off = run.calibration.board_warp_m[0] - bow_m;
        assert!(off.abs() < 2e-5, "{name}: {off}");
    }
}

#[test]
fn a_fisheye_of_189_degrees_is_calibrated_from_pictures() {
    let run = run(&fisheye(), 0.0, [0.3, 0.5]);
    run.print("fisheye", &[86.0, 94.0]);
    run.assert_nothing_is_cut();
    // Else the field would end before.
    let max_angle_rad = run.calibration.intrinsics.lens.max_angle_rad();
    assert!(
        max_angle_rad.is_some_and(|angle| angle.to_degrees() >= 94.0),
        "{max_angle_rad:?}"
    );
    for (up_to_deg, allowed_px) in [(86.0, 0.005), (94.0, 0.01)] {
        assert!(
            run.off_px(up_to_deg) <= allowed_px,
            "{up_to_deg}: {}",
            run.off_px(up_to_deg)
        );
    }
}
