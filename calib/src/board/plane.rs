//! How the plane of the board appears around a place: a homography of nearby corners, bent a little.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{SMatrix, SVector};

/// Least area that corners must span on the board, relative to their extent squared.
const MIN_SPREAD: f64 = 1e-3;

/// Corners from which on bending is looked for.
const MIN_TO_BEND: usize = 9;

/// How reluctantly a plane is bent: added to the mean of the squared quadratic terms, which are about 1.
const RELUCTANCE: f64 = 0.02;

/// Maps the board's plane to the picture, exactly for a perspective lens, and near the corners that it was made from for
/// any other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalPlane {
    /// Maps the board, moved and scaled by `centre` and `scale`, to the picture.
    homography: DMat3,
    /// What the lens adds, in pixels: coefficients of 1, x, y, x², xy, y².
    bend: [DVec2; 6],
    centre: DVec2,
    scale: f64,
}

impl LocalPlane {
    /// Fits pairs of a place on the board, in metres, and its pixel. `None` for less than four or where they lie on a line.
    pub(super) fn fit(pairs: &[(DVec2, DVec2)]) -> Option<Self> {
        let count = pairs.len() as f64;
        if pairs.len() < 4 {
            return None;
        }
        let mean = pairs
            .iter()
            .fold((DVec2::ZERO, DVec2::ZERO), |(a, b), pair| (a + pair.0, b + pair.1));
        let (centre, middle) = (mean.0 / count, mean.1 / count);
        let spread = |of: &dyn Fn(&(DVec2, DVec2)) -> DVec2| {
            (pairs.iter().map(|pair| of(pair).length_squared()).sum::<f64>() / count).sqrt()
        };
        let (scale, size) = (spread(&|pair| pair.0 - centre), spread(&|pair| pair.1 - middle));
        if !(scale > 0.0 && size > 0.0 && size.is_finite()) {
            return None;
        }
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for (place, pixel) in pairs {
            let (p, q) = ((*place - centre) / scale, (*pixel - middle) / size);
            (xx, xy, yy) = (xx + p.x * p.x, xy + p.x * p.y, yy + p.y * p.y);
            let rows = [
                (
                    SVector::from([p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y]),
                    q.x,
                ),
                (
                    SVector::from([0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y]),
                    q.y,
                ),
            ];
            for (row, value) in rows {
                normal += row * row.transpose();
                right += row * value;
            }
        }
        if xx * yy - xy * xy < MIN_SPREAD * count * count {
            return None;
        }
        // A trace of regularisation towards an affine map: three corners on a line and one beside it leave perspective open.
        normal[(6, 6)] += 1e-9 * count;
        normal[(7, 7)] += 1e-9 * count;
        let h = normal.cholesky()?.solve(&right);
        let scaled = DMat3::from_cols(
            DVec3::new(h[0], h[3], h[6]),
            DVec3::new(h[1], h[4], h[7]),
            DVec3::new(h[2], h[5], 1.0),
        );
        let unscale = DMat3::from_cols(
            DVec3::new(size, 0.0, 0.0),
            DVec3::new(0.0, size, 0.0),
            middle.extend(1.0),
        );
        let mut plane = Self {
            homography: unscale * scaled,
            bend: [DVec2::ZERO; 6],
            centre,
            scale,
        };
        if !plane.homography.is_finite() {
            return None;
        }
        if pairs.len() >= MIN_TO_BEND {
            plane.bend = plane.bending(pairs)?;
        }
        Some(plane)
    }

    /// Fits a quadratic to what the homography leaves, with a penalty on its size.
    fn bending(&self, pairs: &[(DVec2, DVec2)]) -> Option<[DVec2; 6]> {
        let mut normal = SMatrix::<f64, 6, 6>::identity() * (RELUCTANCE * pairs.len() as f64);
        let mut right = SMatrix::<f64, 6, 2>::zeros();
        for (place, pixel) in pairs {
            let terms = SVector::from(quadratic((*place - self.centre) / self.scale));
            let left = *pixel - self.pixel(*place)?;
            normal += terms * terms.transpose();
            right += terms * SMatrix::<f64, 1, 2>::new(left.x, left.y);
        }
        let solution = normal.cholesky()?.solve(&right);
        Some(std::array::from_fn(|i| DVec2::new(solution[(i, 0)], solution[(i, 1)])))
    }

    /// The pixel of a place on the board, in metres; `None` beyond the horizon.
    pub(super) fn pixel(&self, place_m: DVec2) -> Option<DVec2> {
        let place = (place_m - self.centre) / self.scale;
        let q = self.homography * place.extend(1.0);
        let bend: DVec2 = self.bend.iter().zip(quadratic(place)).map(|(c, term)| *c * term).sum();
        (q.z > 1e-3).then(|| q.truncate() / q.z + bend)
    }

    /// How the pixel moves with the place along the board's x and y, in pixels per metre.
    pub(super) fn axes(&self, place_m: DVec2) -> Option<[DVec2; 2]> {
        let place = (place_m - self.centre) / self.scale;
        let q = self.homography * place.extend(1.0);
        if q.z <= 1e-3 {
            return None;
        }
        let pixel = q.truncate() / q.z;
        let axis = |column: DVec3| (column.truncate() - pixel * column.z) / q.z;
        let [_, x, y, xx, xy, yy] = self.bend;
        let bend = [
            x + xx * (2.0 * place.x) + xy * place.y,
            y + xy * place.x + yy * (2.0 * place.y),
        ];
        let along_x = axis(self.homography.x_axis) + bend[0];
        let along_y = axis(self.homography.y_axis) + bend[1];
        Some([along_x / self.scale, along_y / self.scale])
    }
}

fn quadratic(place: DVec2) -> [f64; 6] {
    let DVec2 { x, y } = place;
    [1.0, x, y, x * x, x * y, y * y]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A homography as a camera makes it.
    fn exact(place: DVec2) -> DVec2 {
        let q = DMat3::from_cols(
            DVec3::new(700.0, 90.0, 0.9),
            DVec3::new(-60.0, -640.0, 0.5),
            DVec3::new(310.0, 250.0, 1.0),
        ) * place.extend(1.0);
        q.truncate() / q.z
    }

    fn grid(side: u32) -> Vec<(DVec2, DVec2)> {
        let places = (0..side * side).map(|i| 0.03 * DVec2::new(f64::from(i % side), f64::from(i / side)));
        places.map(|place| (place, exact(place))).collect()
    }

    #[test]
    fn a_perspective_view_is_met_exactly() {
        for side in [2, 3, 4] {
            let plane = LocalPlane::fit(&grid(side)).unwrap();
            let place = DVec2::new(0.13, -0.02);
            assert!(plane.pixel(place).unwrap().distance(exact(place)) < 1e-3, "{side}");
            let axes = plane.axes(place).unwrap();
            for (axis, unit) in axes.into_iter().zip([DVec2::X, DVec2::Y]) {
                let numeric = (exact(place + 1e-6 * unit) - exact(place - 1e-6 * unit)) / 2e-6;
                assert!((axis - numeric).length() < 0.05, "{side}: {axis} {numeric}");
            }
        }
    }

    /// Between bent corners the bend is followed to a fraction of what a homography alone would be off.
    #[test]
    fn a_bent_view_is_followed() {
        let bent = |place: DVec2| exact(place) + DVec2::new(900.0, 400.0) * place.x * place.x * place.y / 0.1;
        let pairs: Vec<_> = grid(4).into_iter().map(|(place, _)| (place, bent(place))).collect();
        let place = DVec2::new(0.045, 0.045);
        let error = LocalPlane::fit(&pairs)
            .unwrap()
            .pixel(place)
            .unwrap()
            .distance(bent(place));
        assert!(error < 0.3, "{error}");
    }

    #[test]
    fn what_determines_nothing_is_refused() {
        assert_eq!(LocalPlane::fit(&grid(2)[..3]), None);
        assert_eq!(LocalPlane::fit(&grid(5)[..5]), None);
        assert_eq!(LocalPlane::fit(&[(DVec2::ONE, DVec2::ONE); 6]), None);
        let mut broken = grid(3);
        broken[2].1 = DVec2::NAN;
        assert_eq!(LocalPlane::fit(&broken), None);
    }
}
