//! A board that is not flat: three numbers say how it bends.

use glam::{DVec2, DVec3};

/// Numbers of a warp.
pub(super) const WARP: usize = 3;

/// Standard deviation that a warp's coefficients are expected to have, as a part of the board's diagonal. A board that is
/// calibrated with is flatter than that; the expectation only keeps views that tell nothing about the warp from leaving it
/// undetermined.
const EXPECTED: f64 = 0.01;

/// Corners of a board and how they move when it bends.
///
/// With x and y running from -1 to 1 over the corners, `z = wx (1 - x²) + wy (1 - y²) + t x y`: a bow along either axis, as
/// mrcal has it (Kogan, "mrcal", section "Calibration object shape"), and a twist, which boards of wood and of foam take
/// on as easily.
#[derive(Debug, Clone)]
pub(super) struct WarpedBoard {
    flat: Vec<DVec3>,
    unit: Vec<DVec2>,
    /// Expected standard deviation of each coefficient, in metres.
    pub(super) expected_m: f64,
    /// From the first to the last corner, in metres.
    pub(super) diagonal_m: f64,
}

impl WarpedBoard {
    pub(super) fn new(flat: Vec<DVec3>) -> Self {
        let low = flat.iter().fold(DVec2::INFINITY, |low, p| low.min(p.truncate()));
        let high = flat.iter().fold(DVec2::NEG_INFINITY, |high, p| high.max(p.truncate()));
        let half = (0.5 * (high - low)).max(DVec2::splat(f64::MIN_POSITIVE));
        let unit = flat.iter().map(|p| (p.truncate() - 0.5 * (low + high)) / half);
        Self {
            unit: unit.collect(),
            expected_m: EXPECTED * (high - low).length(),
            diagonal_m: (high - low).length(),
            flat,
        }
    }

    /// Number of corners.
    pub(super) fn len(&self) -> usize {
        self.flat.len()
    }

    /// The corner on the flat board, in metres.
    pub(super) fn flat(&self, corner: usize) -> DVec3 {
        self.flat[corner]
    }

    /// The corner on the bent board, in metres.
    pub(super) fn bent(&self, corner: usize, warp: &[f64; WARP]) -> DVec3 {
        let basis = self.basis(corner);
        let z = basis[0] * warp[0] + basis[1] * warp[1] + basis[2] * warp[2];
        self.flat[corner] + DVec3::Z * z
    }

    /// Derivatives of the corner's z by the warp.
    pub(super) fn basis(&self, corner: usize) -> [f64; WARP] {
        let DVec2 { x, y } = self.unit[corner];
        [1.0 - x * x, 1.0 - y * y, x * y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Board;

    #[test]
    fn a_bow_is_highest_in_the_middle_and_nothing_at_the_corners() {
        let board = Board::Chessboard {
            columns: 5,
            rows: 3,
            square_m: 0.1,
        };
        let board = WarpedBoard::new(board.corners_m());
        let warp = [0.002, 0.001, 0.0];
        assert!((board.bent(7, &warp).z - 0.003).abs() < 1e-15);
        for corner in [0, 4, 10, 14] {
            assert!(board.bent(corner, &warp).z.abs() < 1e-15);
        }
        let twisted = [0, 4, 10, 14].map(|corner| board.bent(corner, &[0.0, 0.0, 0.001]).z);
        assert_eq!(twisted.map(|z| (z * 1e6).round()), [1000.0, -1000.0, -1000.0, 1000.0]);
    }
}
