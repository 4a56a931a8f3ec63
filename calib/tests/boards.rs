//! Boards in pictures that were drawn exactly: which corners are found, and how well.

#[path = "support/board_pictures.rs"]
mod board_pictures;

use board_pictures::{BoardCamera, Look, board_pose};
use glam::{DVec2, DVec3};
use mirrorball_calib::{
    board::{Board, BoardDetector, CharucoPattern, FoundBoard},
    camera::{Intrinsics, LensModel},
    tag::{DictionarySize, Family},
};

fn aprilgrid(border_bits: u32) -> Board {
    Board::AprilGrid {
        family: Family::Tag36h11,
        columns: 6,
        rows: 5,
        side_m: 0.03,
        spacing_m: 0.009,
        border_bits,
        first_id: 0,
    }
}

fn charuco() -> Board {
    Board::Charuco {
        family: Family::Aruco5x5(DictionarySize::N100),
        columns: 8,
        rows: 6,
        square_m: 0.03,
        side_m: 0.022,
        first_id: 0,
        pattern: CharucoPattern::BlackTopLeft,
    }
}

fn chessboard() -> Board {
    Board::Chessboard {
        columns: 9,
        rows: 6,
        square_m: 0.025,
    }
}

fn pinhole() -> Intrinsics {
    Intrinsics {
        size_px: [640, 480],
        focal_px: DVec2::new(520.0, 521.0),
        principal_point_px: DVec2::new(322.3, 238.1),
        lens: LensModel::BrownConrady {
            k1: -0.28,
            k2: 0.09,
            p1: 3e-4,
            p2: -4e-4,
            k3: 0.0,
        },
    }
}

/// 189 degrees.
fn fisheye() -> Intrinsics {
    Intrinsics {
        size_px: [800, 800],
        focal_px: DVec2::new(236.0, 235.5),
        principal_point_px: DVec2::new(401.3, 398.2),
        lens: LensModel::KannalaBrandt {
            k: [-0.0121, 0.0058, -0.0021, 0.00021],
            max_angle_rad: 94.5f64.to_radians(),
        },
    }
}

/// Turns and direction towards the board, in radians and in the camera frame, and distance in metres.
struct View {
    distance_m: f64,
    turns_deg: [f64; 3],
    towards: [f64; 3],
}

const PINHOLE_VIEWS: [View; 5] = [
    View {
        distance_m: 0.36,
        turns_deg: [0.0, 0.0, 0.0],
        towards: [0.0, 0.0, 1.0],
    },
    View {
        distance_m: 0.34,
        turns_deg: [35.0, -20.0, 10.0],
        towards: [0.03, 0.0, 1.0],
    },
    View {
        distance_m: 0.36,
        turns_deg: [10.0, 50.0, 80.0],
        towards: [0.0, -0.02, 1.0],
    },
    View {
        distance_m: 0.34,
        turns_deg: [-60.0, 0.0, -160.0],
        towards: [0.0, 0.05, 1.0],
    },
    View {
        distance_m: 0.55,
        turns_deg: [20.0, 40.0, 0.0],
        towards: [0.25, -0.2, 1.0],
    },
];

const FISHEYE_VIEWS: [View; 4] = [
    View {
        distance_m: 0.16,
        turns_deg: [0.0, 20.0, 30.0],
        towards: [0.1, 0.0, 1.0],
    },
    View {
        distance_m: 0.15,
        turns_deg: [-20.0, 0.0, 0.0],
        towards: [1.0, 0.3, 0.5],
    },
    View {
        distance_m: 0.15,
        turns_deg: [0.0, 30.0, 45.0],
        towards: [-0.6, 0.7, 0.15],
    },
    View {
        distance_m: 0.17,
        turns_deg: [20.0, -30.0, -90.0],
        towards: [0.2, -1.0, 0.1],
    },
];

/// Errors of a picture's corners.
struct Score {
    rms_px: f64,
    worst_px: f64,
    found: usize,
    visible: usize,
    edge_width_px: f64,
}

fn score(found: &FoundBoard, exact: &[Option<DVec2>]) -> Score {
    let errors: Vec<f64> = found
        .view
        .corners
        .iter()
        .map(|corner| exact[corner.corner as usize].map_or(f64::INFINITY, |exact| exact.distance(corner.pixel)))
        .collect();
    Score {
        rms_px: (errors.iter().map(|e| e * e).sum::<f64>() / (2.0 * errors.len() as f64)).sqrt(),
        worst_px: errors.iter().copied().fold(0.0, f64::max),
        found: errors.len(),
        visible: exact.iter().flatten().count(),
        edge_width_px: found.edge_width_px,
    }
}

fn shoot(intrinsics: &Intrinsics, views: &[View], board: &Board, look: &Look) -> Vec<Score> {
    let camera = BoardCamera::new(intrinsics);
    let mut detector = BoardDetector::new(board);
    let mut scores = Vec::new();
    for (number, view) in views.iter().enumerate() {
        let turns = DVec3::from_array(view.turns_deg.map(f64::to_radians));
        let pose = board_pose(board, view.distance_m, turns, DVec3::from_array(view.towards));
        let look = Look {
            seed: number as u64,
            ..look.clone()
        };
        let rgb = camera.picture(board, &pose, &look);
        if let Ok(dir) = std::env::var("BOARD_PICTURES") {
            let [w, h] = camera.size();
            image::save_buffer(
                format!("{dir}/{}_{number}.png", std::thread::current().name().unwrap()),
                &rgb,
                w as u32,
                h as u32,
                image::ColorType::Rgb8,
            )
            .unwrap();
        }
        let exact = camera.exact_corners(board, &pose);
        match detector.detect(&number.to_string(), &rgb, camera.size(), &look.response) {
            Ok(found) => {
                let score = score(&found, &exact);
                println!(
                    "view {number}: {} of {} corners, rms {:.4} px, worst {:.3} px, edges {:.2} px",
                    score.found, score.visible, score.rms_px, score.worst_px, score.edge_width_px
                );
                scores.push(score);
            }
            Err(error) => println!("{error}: {}", error.reason),
        }
    }
    scores
}

#[test]
fn april_pinhole() {
    for border in [1, 2] {
        shoot(&pinhole(), &PINHOLE_VIEWS, &aprilgrid(border), &Look::default());
    }
}

#[test]
fn april_fisheye() {
    for border in [1, 2] {
        shoot(&fisheye(), &FISHEYE_VIEWS, &aprilgrid(border), &Look::default());
    }
}

#[test]
fn charuco_pinhole() {
    shoot(&pinhole(), &PINHOLE_VIEWS, &charuco(), &Look::default());
}

#[test]
fn charuco_fisheye() {
    shoot(&fisheye(), &FISHEYE_VIEWS, &charuco(), &Look::default());
}

#[test]
fn chess_pinhole() {
    shoot(&pinhole(), &PINHOLE_VIEWS, &chessboard(), &Look::default());
}

#[test]
fn chess_fisheye() {
    shoot(&fisheye(), &FISHEYE_VIEWS, &chessboard(), &Look::default());
}
