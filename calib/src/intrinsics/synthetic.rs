//! Views of a board that never was: for tests.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::warp::WarpedBoard;
use crate::{
    board::{Board, BoardView, SeenCorner},
    camera::{Intrinsics, LensModel},
    pose::{Pose, Twist},
    tag::Family,
};

/// Numbers by chance, the same for the same seed (SplitMix64: Steele, Lea, Flood 2014).
pub(super) struct Chance(pub(super) u64);

impl Chance {
    /// Evenly in 0 to 1.
    pub(super) fn even(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.even()
    }

    /// Normally distributed with deviation 1 (Box and Muller 1958).
    pub(super) fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.even()).ln()).sqrt() * (2.0 * PI * self.even()).cos()
    }
}

/// A scene: a lens, a board, how it is bent, and where it stood.
pub(super) struct Scene {
    pub(super) lens: Intrinsics,
    pub(super) board: Board,
    pub(super) warp_m: [f64; 3],
    pub(super) poses: Vec<Pose>,
}

/// Kalibr's 6×6 grid.
pub(super) fn grid() -> Board {
    Board::AprilGrid {
        family: Family::Tag36h11,
        columns: 6,
        rows: 6,
        side_m: 0.088,
        spacing_m: 0.0264,
        border_bits: 2,
        first_id: 0,
    }
}

pub(super) fn pinhole() -> Intrinsics {
    Intrinsics {
        size_px: [1280, 720],
        focal_px: DVec2::new(905.3, 903.1),
        principal_point_px: DVec2::new(648.2, 351.7),
        lens: LensModel::BrownConrady {
            k1: -0.21,
            k2: 0.08,
            p1: 7e-4,
            p2: -5e-4,
            k3: -0.012,
        },
    }
}

/// A round picture of 189°.
pub(super) fn fisheye() -> Intrinsics {
    Intrinsics {
        size_px: [1280, 960],
        focal_px: DVec2::new(281.4, 280.9),
        principal_point_px: DVec2::new(645.1, 474.2),
        lens: LensModel::KannalaBrandt {
            k: [0.012, -0.0081, 0.0022, -0.0004],
            max_angle_rad: 94.5f64.to_radians(),
        },
    }
}

impl Scene {
    /// The board all over the picture, turned and tilted by chance: up to `tilt_rad` about any axis in its plane.
    pub(super) fn new(lens: Intrinsics, n_views: usize, tilt_rad: f64, seed: u64) -> Self {
        Self::at(
            lens,
            n_views,
            tilt_rad,
            if lens.lens.model().is_fisheye() {
                [0.3, 0.6]
            } else {
                [0.5, 1.2]
            },
            seed,
        )
    }

    pub(super) fn at(lens: Intrinsics, n_views: usize, tilt_rad: f64, distance_m: [f64; 2], seed: u64) -> Self {
        let board = grid();
        let mut chance = Chance(seed);
        let size = DVec2::new(f64::from(lens.size_px[0]), f64::from(lens.size_px[1]));
        let mut poses = Vec::new();
        let mut scene = Self {
            lens,
            board,
            warp_m: [0.0; 3],
            poses: Vec::new(),
        };
        while poses.len() < n_views {
            let pixel = DVec2::new(chance.even(), chance.even()) * size - 0.5;
            let Some(towards) = lens.unproject(pixel) else { continue };
            let facing = DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, -towards));
            // Upright as it is printed: y up in the board, down in the picture.
            let about = chance.between(0.0, 2.0 * PI);
            let tilt = DVec3::new(about.cos(), about.sin(), 0.0) * chance.between(0.0, tilt_rad);
            let turn = |rotation| {
                Pose::exp(Twist {
                    rotation,
                    translation: DVec3::ZERO,
                })
                .rotation
            };
            let rotation = facing * turn(tilt) * turn(DVec3::Z * chance.between(0.0, 2.0 * PI));
            let distance = chance.between(distance_m[0], distance_m[1]);
            let pose = Pose {
                rotation,
                translation: towards * distance - rotation * DVec3::new(0.33, 0.33, 0.0),
            };
            scene.poses = vec![pose];
            if scene.views(0.0, 0)[0].corners.len() >= 40 {
                poses.push(pose);
            }
        }
        scene.poses = poses;
        scene
    }

    /// The corners that are in the picture, with noise.
    pub(super) fn views(&self, sigma_px: f64, seed: u64) -> Vec<BoardView> {
        let board = WarpedBoard::new(self.board.corners_m());
        let mut chance = Chance(seed);
        let mut views = Vec::new();
        for (index, pose) in self.poses.iter().enumerate() {
            let mut corners = Vec::new();
            for corner in 0..board.len() {
                let point = pose.transform_point(board.bent(corner, &self.warp_m));
                let noise = DVec2::new(chance.normal(), chance.normal()) * sigma_px;
                let faces = (pose.inverse().translation.z) > 0.0;
                if let Some(pixel) = self
                    .lens
                    .project(point)
                    .filter(|pixel| faces && self.lens.contains(*pixel))
                {
                    corners.push(SeenCorner {
                        corner: corner as u32,
                        pixel: pixel + noise,
                        sigma_px: 0.1,
                    });
                }
            }
            views.push(BoardView {
                name: format!("{index:03}.png"),
                corners,
            });
        }
        views
    }
}
