//! Boards in pictures that were drawn exactly: which corners are found, and how well.

#[path = "support/board_pictures.rs"]
mod board_pictures;

use board_pictures::{BoardCamera, Look, Noise, board_pose, linear_response};
use glam::{DVec2, DVec3};
use mirrorball_calib::{
    board::{Board, BoardDetector, CharucoPattern, FoundBoard, Reason},
    camera::{Intrinsics, LensModel},
    pose::Pose,
    response::ResponseCurve,
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
        size_px: [720, 720],
        focal_px: DVec2::new(216.0, 215.5),
        principal_point_px: DVec2::new(361.3, 358.2),
        lens: LensModel::KannalaBrandt {
            k: [-0.0121, 0.0058, -0.0021, 0.00021],
            max_angle_rad: 94.5f64.to_radians(),
        },
    }
}

/// Turns of the board in degrees, direction towards its middle in the camera frame, distance in metres.
struct View {
    distance_m: f64,
    turns_deg: [f64; 3],
    towards: [f64; 3],
}

const PINHOLE_VIEWS: [View; 3] = [
    View {
        distance_m: 0.36,
        turns_deg: [0.0, 0.0, 0.0],
        towards: [0.0, 0.0, 1.0],
    },
    View {
        distance_m: 0.34,
        turns_deg: [-60.0, 0.0, -160.0],
        towards: [0.0, 0.05, 1.0],
    },
    View {
        distance_m: 0.55,
        turns_deg: [20.0, 40.0, 80.0],
        towards: [0.2, -0.15, 1.0],
    },
];

const FISHEYE_VIEWS: [View; 2] = [
    View {
        distance_m: 0.16,
        turns_deg: [0.0, 20.0, 30.0],
        towards: [0.1, 0.0, 1.0],
    },
    View {
        distance_m: 0.17,
        turns_deg: [20.0, -30.0, -90.0],
        towards: [0.2, -1.0, 0.1],
    },
];

/// A chessboard must be seen whole: up to 80 degrees off the axis.
const WHOLE_FISHEYE_VIEW: View = View {
    distance_m: 0.22,
    turns_deg: [0.0, -20.0, 70.0],
    towards: [-1.0, 0.3, 0.7],
};

/// Errors of a picture's corners.
#[derive(Debug)]
struct Score {
    /// Of either coordinate.
    rms_px: f64,
    worst_px: f64,
    found: usize,
    visible: usize,
}

impl Score {
    fn of(found: &FoundBoard, exact: &[Option<DVec2>]) -> Self {
        let errors: Vec<f64> = found
            .view
            .corners
            .iter()
            .map(|corner| exact[corner.corner as usize].map_or(f64::INFINITY, |exact| exact.distance(corner.pixel)))
            .collect();
        let numbers: Vec<u32> = found.view.corners.iter().map(|corner| corner.corner).collect();
        assert!(numbers.is_sorted_by(|a, b| a < b), "corners rise, each once");
        Self {
            rms_px: (errors.iter().map(|e| e * e).sum::<f64>() / (2.0 * errors.len() as f64)).sqrt(),
            worst_px: errors.iter().copied().fold(0.0, f64::max),
            found: errors.len(),
            visible: exact.iter().flatten().count(),
        }
    }

    fn assert(&self, rms_px: f64, worst_px: f64) {
        assert!(self.rms_px < rms_px && self.worst_px < worst_px, "{self:?}");
        // Corners at a fisheye's rim are cut.
        assert!(self.found as f64 > 0.85 * self.visible as f64, "{self:?}");
    }
}

fn pose(board: &Board, view: &View) -> Pose {
    let turns = DVec3::from_array(view.turns_deg.map(f64::to_radians));
    board_pose(board, view.distance_m, turns, DVec3::from_array(view.towards))
}

/// Takes a picture and finds the board in it.
fn shoot(camera: &BoardCamera, board: &Board, view: &View, look: &Look) -> (FoundBoard, Score) {
    let pose = pose(board, view);
    let rgb = camera.picture(board, &pose, look);
    let found = BoardDetector::new(board).detect("view", &rgb, camera.size(), &ResponseCurve::srgb());
    let found = found.unwrap_or_else(|error| panic!("{error}: {}", error.reason));
    let score = Score::of(&found, &camera.exact_corners(board, &pose));
    (found, score)
}

#[test]
fn every_board_is_found_through_a_perspective_lens() {
    let camera = BoardCamera::new(&pinhole());
    let tags_in_charuco = Board::Charuco {
        family: Family::Tag36h11,
        columns: 7,
        rows: 6,
        square_m: 0.034,
        side_m: 0.026,
        first_id: 20,
        pattern: CharucoPattern::BlackBottomLeft,
    };
    for board in [aprilgrid(1), aprilgrid(2), charuco(), tags_in_charuco, chessboard()] {
        for view in &PINHOLE_VIEWS {
            let (_, score) = shoot(&camera, &board, view, &Look::default());
            println!("{score:?}");
            score.assert(0.025, 0.08);
            assert_eq!(score.found, score.visible);
        }
    }
}

#[test]
fn every_board_is_found_through_a_fisheye() {
    let camera = BoardCamera::new(&fisheye());
    for board in [aprilgrid(1), aprilgrid(2), charuco()] {
        for view in &FISHEYE_VIEWS {
            let (_, score) = shoot(&camera, &board, view, &Look::default());
            println!("{score:?}");
            score.assert(0.03, 0.1);
        }
    }
    for view in [&FISHEYE_VIEWS[0], &WHOLE_FISHEYE_VIEW] {
        shoot(&camera, &chessboard(), view, &Look::default())
            .1
            .assert(0.03, 0.1);
    }
}

/// Pictures as cameras take them: noise, uneven light, some blur, and a response that is not what the program is told.
#[test]
fn noise_shading_and_another_response_do_little_harm() {
    let camera = BoardCamera::new(&pinhole());
    for (seed, response) in [(1, ResponseCurve::srgb()), (2, linear_response())] {
        let look = Look {
            blur_px: 0.8,
            full_well_e: 5000.0,
            exposure: 0.8,
            shading: 0.6,
            response,
            seed,
        };
        for board in [aprilgrid(2), charuco(), chessboard()] {
            let (_, score) = shoot(&camera, &board, &PINHOLE_VIEWS[2], &look);
            println!("{score:?}");
            score.assert(0.05, 0.25);
        }
    }
}

#[test]
fn blur_is_measured() {
    let camera = BoardCamera::new(&pinhole());
    for blur_px in [0.5f64, 1.5, 2.5] {
        let look = Look {
            blur_px,
            ..Look::default()
        };
        let (found, _) = shoot(&camera, &chessboard(), &PINHOLE_VIEWS[0], &look);
        // The pixel's own square has a variance of 1/12.
        let expected = (blur_px * blur_px + 1.0 / 12.0).sqrt();
        assert!(
            (found.edge_width_px / expected - 1.0).abs() < 0.15,
            "{expected} {}",
            found.edge_width_px
        );
    }
}

/// A board of even sides looks the same turned by half a turn: its rows then run to the right in the picture.
#[test]
fn a_chessboard_without_an_up_is_read_from_left_to_right() {
    let board = Board::Chessboard {
        columns: 8,
        rows: 6,
        square_m: 0.025,
    };
    let camera = BoardCamera::new(&pinhole());
    for turn_deg in [-30.0, 160.0] {
        let pose = board_pose(&board, 0.36, DVec3::new(0.2, 0.1, f64::to_radians(turn_deg)), DVec3::Z);
        let rgb = camera.picture(&board, &pose, &Look::default());
        let found = BoardDetector::new(&board)
            .detect("view", &rgb, camera.size(), &ResponseCurve::srgb())
            .expect("found");
        assert_eq!(found.view.corners.len(), 48);
        let pixel = |i: usize| found.view.corners[i].pixel;
        assert!(pixel(7).x > pixel(0).x && pixel(40).y < pixel(0).y, "{turn_deg}");
    }
}

/// The reason why a board is not found in a picture of another one.
fn reason(shown: &Board, sought: &Board, change: impl Fn(&mut Vec<u8>, usize)) -> Reason {
    let camera = BoardCamera::new(&pinhole());
    let mut rgb = camera.picture(shown, &pose(shown, &PINHOLE_VIEWS[0]), &Look::default());
    change(&mut rgb, camera.size()[0]);
    let found = BoardDetector::new(sought).detect("view 7", &rgb, camera.size(), &ResponseCurve::srgb());
    let error = found.expect_err("another board");
    assert_eq!(error.to_string(), "no board in `view 7`");
    assert!(!error.reason.hint().is_empty());
    error.reason
}

fn mirror(rgb: &mut Vec<u8>, width: usize) {
    *rgb = rgb
        .chunks_exact(3 * width)
        .flat_map(|row| row.chunks_exact(3).rev().flatten().copied())
        .collect();
}

#[test]
fn a_mirrored_grid_is_told_whatever_its_border() {
    for sought in [1, 2] {
        for shown in [1, 2] {
            let mirrored = reason(&aprilgrid(shown), &aprilgrid(sought), mirror);
            assert!(
                matches!(mirrored, Reason::Mirrored { markers } if markers >= 2),
                "{shown} {sought}: {mirrored}"
            );
        }
    }
}

#[test]
fn another_chessboard_is_told_by_its_size() {
    let small = Board::Chessboard {
        columns: 7,
        rows: 5,
        square_m: 0.025,
    };
    let other = reason(&chessboard(), &small, |_, _| {});
    assert!(
        matches!(
            other,
            Reason::OtherChessboard {
                found_long: 9,
                found_short: 6,
                corners: 54,
                ..
            }
        ),
        "{other}"
    );
}

#[test]
fn wrong_boards_are_told_by_what_is_wrong() {
    let keep = |_: &mut Vec<u8>, _: usize| {};
    let grid = |new_columns: u32, new_rows: u32, new_first: u32| {
        let mut board = aprilgrid(1);
        if let Board::AprilGrid {
            columns,
            rows,
            first_id,
            ..
        } = &mut board
        {
            (*columns, *rows, *first_id) = (new_columns, new_rows, new_first);
        }
        board
    };
    let shown = grid(6, 5, 0);
    let mirrored = reason(&shown, &shown, mirror);
    assert!(
        matches!(mirrored, Reason::Mirrored { markers } if markers > 25) && mirrored.is_wrong_board(),
        "{mirrored}"
    );
    assert!(matches!(
        reason(&charuco(), &charuco(), mirror),
        Reason::Mirrored { .. }
    ));
    assert_eq!(
        reason(&shown, &aprilgrid(2), keep),
        Reason::OtherBorder { found: 1, expected: 2 }
    );
    assert_eq!(
        reason(&shown, &grid(5, 6, 0), keep),
        Reason::OtherColumns { found: 6, expected: 5 }
    );
    let other_ids = |first, last| Reason::OtherIds {
        lowest: 0,
        highest: 29,
        first,
        last,
    };
    assert_eq!(reason(&shown, &grid(6, 3, 0), keep), other_ids(0, 17));
    // Counted from another id, half of the markers or more still fit each other.
    assert_eq!(reason(&shown, &grid(6, 5, 3), keep), other_ids(3, 32));
    assert_eq!(reason(&shown, &grid(6, 5, 6), keep), other_ids(6, 35));
    assert_eq!(reason(&shown, &grid(6, 5, 100), keep), other_ids(100, 129));
    let charuco_from = |new_rows: u32, new_first: u32| {
        let mut board = charuco();
        if let Board::Charuco { rows, first_id, .. } = &mut board {
            (*rows, *first_id) = (new_rows, new_first);
        }
        board
    };
    let charuco_ids = |first, last| Reason::OtherIds {
        lowest: 0,
        highest: 23,
        first,
        last,
    };
    assert_eq!(reason(&charuco(), &charuco_from(6, 3), keep), charuco_ids(3, 26));
    assert_eq!(reason(&charuco(), &charuco_from(4, 0), keep), charuco_ids(0, 15));
    assert_eq!(reason(&chessboard(), &shown, keep), Reason::Nothing);
    assert_eq!(reason(&shown, &charuco(), keep), Reason::Nothing);
}

#[test]
fn a_covered_chessboard_is_not_found_and_a_covered_grid_is() {
    let camera = BoardCamera::new(&pinhole());
    for (board, least) in [(aprilgrid(2), 60), (charuco(), 15)] {
        let pose = pose(&board, &PINHOLE_VIEWS[0]);
        let mut rgb = camera.picture(&board, &pose, &Look::default());
        cover(&mut rgb, camera.size()[0]);
        let found = BoardDetector::new(&board)
            .detect("view", &rgb, camera.size(), &ResponseCurve::srgb())
            .expect("the rest is there");
        let exact = camera.exact_corners(&board, &pose);
        let seen = Score::of(&found, &exact);
        assert!(seen.found >= least && seen.worst_px < 0.1, "{seen:?}");
    }
    assert!(matches!(
        reason(&chessboard(), &chessboard(), |rgb, width| cover(rgb, width)),
        Reason::OtherChessboard { .. }
    ));
}

/// Lays a grey sheet over the left two fifths.
fn cover(rgb: &mut [u8], width: usize) {
    for row in rgb.chunks_exact_mut(3 * width) {
        row[..3 * width * 2 / 5].fill(120);
    }
}

#[test]
fn pictures_without_a_board_have_none() {
    let mut noise = Noise(7);
    for board in [aprilgrid(1), charuco(), chessboard()] {
        let mut detector = BoardDetector::new(&board);
        let mut none = |rgb: &[u8], size: [usize; 2]| {
            let found = detector.detect("view", rgb, size, &ResponseCurve::srgb());
            found.expect_err("nothing is there").reason
        };
        for size in [[0, 0], [1, 1], [4, 4], [5, 7], [15, 15], [16, 33], [3, 300], [320, 240]] {
            let [width, height] = size;
            let grey = vec![128; 3 * width * height];
            assert_eq!(
                none(&grey, size),
                if width * height == 0 {
                    none(&[], [0, 0])
                } else {
                    Reason::Nothing
                }
            );
            let checkers: Vec<u8> = (0..3 * width * height)
                .map(|i| if ((i / 3) ^ (i / 3 / width)) & 1 == 0 { 0 } else { 255 })
                .collect();
            none(&checkers, size);
            let random: Vec<u8> = grey.iter().map(|_| (256.0 * noise.uniform()) as u8).collect();
            none(&random, size);
        }
        let size = [64, 48];
        assert!(matches!(none(&[0; 3 * 64 * 48], size), Reason::Dark { .. }));
        assert!(matches!(none(&[255; 3 * 64 * 48], size), Reason::Clipped { .. }));
        assert!(matches!(none(&[0; 12], size), Reason::Picture(_)));
        assert!(matches!(none(&[0; 12], [40_000, 1]), Reason::Picture(_)));
    }
}

/// The standard deviations that are claimed are those of the errors, whatever limits them.
#[test]
fn corners_are_as_good_as_is_claimed() {
    let camera = BoardCamera::new(&pinhole());
    for board in [aprilgrid(2), charuco()] {
        for blur_px in [0.0, 0.5, 1.0] {
            for (full_well_e, turns_deg) in [
                (f64::INFINITY, [0.0, 3.0, 7.0]),
                (f64::INFINITY, [30.0, 3.0, 18.0]),
                (f64::INFINITY, [60.0, 3.0, 40.0]),
                (3000.0, [0.0, 3.0, 7.0]),
                (3000.0, [45.0, 3.0, 29.0]),
            ] {
                let view = View {
                    distance_m: 0.36,
                    turns_deg,
                    towards: [0.01, 0.02, 1.0],
                };
                let look = Look {
                    blur_px,
                    full_well_e,
                    ..Look::default()
                };
                let (found, _) = shoot(&camera, &board, &view, &look);
                let exact = camera.exact_corners(&board, &pose(&board, &view));
                let ratios = found.view.corners.iter().map(|corner| {
                    let exact = exact[corner.corner as usize].expect("it is in the picture");
                    exact.distance_squared(corner.pixel) / (2.0 * corner.sigma_px.powi(2))
                });
                let ratio = (ratios.sum::<f64>() / found.view.corners.len() as f64).sqrt();
                println!("{ratio:.2} blur {blur_px} full well {full_well_e} turns {turns_deg:?}");
                assert!((0.5..1.6).contains(&ratio), "{ratio} {blur_px} {turns_deg:?} {board:?}");
            }
        }
    }
}
