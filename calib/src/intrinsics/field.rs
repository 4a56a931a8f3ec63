//! Lenses compared over the whole picture: how sure one is, and how far two are apart.
//!
//! Both mean what mrcal calls projection uncertainty and projection difference (Kogan, "mrcal", sections "Projection
//! uncertainty" and "Differences"): a lens model is defined up to a small motion of the camera frame, as whoever uses it fits a
//! pose to the same pictures. So that motion is fitted away first: over the whole picture, unweighted, a rotation for points at
//! infinity, and a translation too for points at a finite distance.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Dyn, Matrix6, OMatrix, U6, Vector6};

use crate::{
    camera::{Intrinsics, Jacobians},
    pose::{Pose, Twist},
};

/// Iterations that fit the motion away; it is small and two are enough.
const ITERATIONS: usize = 20;

/// How far away the points are whose pixels are compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reach {
    /// Infinitely: only directions count.
    Infinity,
    /// This many metres from the camera.
    Distance(f64),
}

/// How sure a lens is over its picture.
#[derive(Debug, Clone, PartialEq)]
pub struct UncertaintyMap {
    /// Cells from left to right.
    pub columns: usize,
    /// Cells from top to bottom.
    pub rows: usize,
    /// Standard deviation in pixels: the root of the expected squared length of the displacement, x and y together, at the
    /// middle of each cell, row by row from the top; NaN where the lens images nothing.
    pub sigma_px: Vec<f64>,
}

/// How far two lenses are apart over the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Pixels of the first lens, the angle of their rays to its axis in radians, and how far the second lens's pixels are from
    /// them, in pixels.
    pub points: Vec<(DVec2, f64, DVec2)>,
}

impl UncertaintyMap {
    /// Propagates the covariance of a lens's parameters to its picture.
    ///
    /// A change δ of the parameters moves the pixel of a ray by J δ. The motion of the camera frame that undoes most of it over
    /// the picture is linear in δ too, so what is left is (J + M K) δ, and its covariance follows. `None` when `columns` or
    /// `rows` is too small for the motion to be told from the lens.
    #[must_use]
    pub fn new(
        intrinsics: &Intrinsics,
        covariance: &DMatrix<f64>,
        [columns, rows]: [usize; 2],
        reach: Reach,
    ) -> Option<Self> {
        let n = covariance.nrows();
        let cells: Vec<Option<[Sensitivity; 2]>> = grid(intrinsics.size_px, [columns, rows])
            .map(|pixel| sensitivities(intrinsics, intrinsics.unproject(pixel)?, n, reach))
            .collect();
        let mut normal = Matrix6::zeros();
        let mut coupling = OMatrix::<f64, U6, Dyn>::zeros(n);
        for row in cells.iter().flatten().flatten() {
            normal += row.by_motion * row.by_motion.transpose();
            coupling += row.by_motion * &row.by_lens;
        }
        let motion = -solve(normal, reach)? * coupling;
        let sigma = |rows: &[Sensitivity; 2]| {
            let variance: f64 = rows
                .iter()
                .map(|row| {
                    let left = &row.by_lens + row.by_motion.transpose() * &motion;
                    (&left * covariance * left.transpose())[(0, 0)]
                })
                .sum();
            variance.max(0.0).sqrt()
        };
        let sigma_px = cells.iter().map(|cell| cell.as_ref().map_or(f64::NAN, sigma)).collect();
        Some(Self {
            columns,
            rows,
            sigma_px,
        })
    }

    /// Root mean square over the picture, in pixels.
    #[must_use]
    pub fn rms_px(&self) -> f64 {
        rms(self.sigma_px.iter().copied().filter(|sigma| sigma.is_finite()))
    }

    /// The largest, in pixels.
    #[must_use]
    pub fn worst_px(&self) -> f64 {
        self.sigma_px
            .iter()
            .copied()
            .filter(|sigma| sigma.is_finite())
            .fold(0.0, f64::max)
    }
}

impl Difference {
    /// Compares two lenses at `columns` × `rows` pixels of the first, evenly spread. Pixels that either lens does not know are
    /// left out. `None` when none are left, or no motion of the camera brings the lenses together.
    #[must_use]
    pub fn new(first: &Intrinsics, second: &Intrinsics, cells: [usize; 2], reach: Reach) -> Option<Self> {
        let distance = match reach {
            Reach::Infinity => 1.0,
            Reach::Distance(metres) => metres,
        };
        let points: Vec<(DVec2, DVec3)> = grid(first.size_px, cells)
            .filter_map(|pixel| Some((pixel, first.unproject(pixel)? * distance)))
            .filter(|(_, point)| second.project(*point).is_some())
            .collect();
        let mut second_from_first = Pose::identity();
        for _ in 0..ITERATIONS {
            let (mut normal, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
            for (pixel, point) in &points {
                let moved = second_from_first.transform_point(*point);
                let Some(projection) = second.project_with_gradient(moved) else {
                    continue;
                };
                let residual = projection.pixel - *pixel;
                for axis in 0..2 {
                    let row = by_motion(moved, projection.gradient[axis], reach);
                    normal += row * row.transpose();
                    gradient += row * residual[axis];
                }
            }
            let step = -solve(normal, reach)? * gradient;
            let twist = Twist {
                rotation: DVec3::new(step[0], step[1], step[2]),
                translation: DVec3::new(step[3], step[4], step[5]),
            };
            second_from_first = (Pose::exp(twist) * second_from_first).orthonormalized();
            if step.norm() < 1e-14 {
                break;
            }
        }
        let points = points.into_iter().filter_map(|(pixel, point)| {
            let there = second.project(second_from_first.transform_point(point))?;
            Some((pixel, point.angle_between(DVec3::Z), there - pixel))
        });
        let points: Vec<_> = points.collect();
        (!points.is_empty()).then_some(Self { points })
    }

    /// Root mean square of the distances, in pixels, of rays up to this angle to the axis, in radians.
    #[must_use]
    pub fn rms_px(&self, up_to_rad: f64) -> f64 {
        let inside = self.points.iter().filter(|(_, angle, _)| *angle <= up_to_rad);
        rms(inside.map(|(.., off)| off.length()))
    }
}

/// How a pixel coordinate moves with the lens and with the camera frame.
struct Sensitivity {
    by_lens: OMatrix<f64, nalgebra::U1, Dyn>,
    by_motion: Vector6<f64>,
}

fn sensitivities(intrinsics: &Intrinsics, ray: DVec3, n: usize, reach: Reach) -> Option<[Sensitivity; 2]> {
    let point = match reach {
        Reach::Infinity => ray,
        Reach::Distance(metres) => ray * metres,
    };
    let Jacobians {
        by_point,
        by_parameters,
        ..
    } = intrinsics.project_with_jacobians(point)?;
    Some([0, 1].map(|axis| Sensitivity {
        by_lens: OMatrix::<f64, nalgebra::U1, Dyn>::from_fn(n, |_, i| by_parameters[axis][i]),
        by_motion: by_motion(point, by_point[axis], reach),
    }))
}

fn by_motion(point: DVec3, by_point: DVec3, reach: Reach) -> Vector6<f64> {
    let turn = point.cross(by_point);
    let shift = match reach {
        Reach::Infinity => DVec3::ZERO,
        Reach::Distance(_) => by_point,
    };
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// Inverse of the motion's normal matrix; at infinity the camera's place does not show and stays.
fn solve(mut normal: Matrix6<f64>, reach: Reach) -> Option<Matrix6<f64>> {
    if reach == Reach::Infinity {
        for i in 3..6 {
            normal[(i, i)] = 1.0;
        }
    }
    normal.cholesky().map(|factor| factor.inverse())
}

/// Middles of the cells of a grid over a picture, row by row.
fn grid(size_px: [u32; 2], [columns, rows]: [usize; 2]) -> impl Iterator<Item = DVec2> {
    let cell = DVec2::new(
        f64::from(size_px[0]) / columns as f64,
        f64::from(size_px[1]) / rows as f64,
    );
    (0..rows).flat_map(move |row| {
        (0..columns).map(move |column| DVec2::new(column as f64 + 0.5, row as f64 + 0.5) * cell - 0.5)
    })
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), v| (sum + v * v, count + 1));
    (sum / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::LensModel;

    fn lens(focal_px: f64) -> Intrinsics {
        Intrinsics {
            size_px: [640, 480],
            focal_px: DVec2::splat(focal_px),
            principal_point_px: DVec2::new(319.5, 239.5),
            lens: LensModel::BrownConrady {
                k1: 0.0,
                k2: 0.0,
                p1: 0.0,
                p2: 0.0,
                k3: 0.0,
            },
        }
    }

    /// A longer focal length enlarges the picture about its middle, which no rotation undoes; going back does at one distance.
    #[test]
    fn a_focal_length_differs_by_the_radius() {
        let (first, second) = (lens(600.0), lens(600.6));
        let radius = rms(grid([640, 480], [20, 15]).map(|pixel| pixel.distance(DVec2::new(319.5, 239.5))));
        let far = Difference::new(&first, &second, [20, 15], Reach::Infinity)
            .unwrap()
            .rms_px(4.0);
        assert!((far - radius * 0.001).abs() < 1e-4, "{far} {radius}");
        let near = Difference::new(&first, &second, [20, 15], Reach::Distance(1.0))
            .unwrap()
            .rms_px(4.0);
        assert!(near < 0.5 * far, "{near} {far}");
        // The same said by a covariance of f alone, both ways moving together.
        let mut covariance = DMatrix::zeros(9, 9);
        covariance.view_mut((0, 0), (2, 2)).fill(0.36);
        let map = UncertaintyMap::new(&first, &covariance, [20, 15], Reach::Infinity).unwrap();
        assert!((map.rms_px() - far).abs() < 2e-3 * far, "{}", map.rms_px());
        assert!(map.worst_px() > map.rms_px());
    }

    /// What moves the whole picture is the camera's own rotation, almost.
    #[test]
    fn a_shifted_centre_is_a_rotation() {
        let first = lens(6000.0);
        let mut second = first;
        second.principal_point_px += DVec2::new(3.0, -2.0);
        let difference = Difference::new(&first, &second, [20, 15], Reach::Infinity).unwrap();
        assert!(difference.rms_px(4.0) < 0.01, "{}", difference.rms_px(4.0));
    }
}
