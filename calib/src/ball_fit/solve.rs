//! Centre and radius from the cones that several cameras see.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, Matrix4, Matrix5, SMatrix, Vector3, Vector5};

use super::{Agreement, BallView, Measured};
use crate::{
    least_squares::loss::Loss,
    pose::Pose,
    probe::{mirror_ball::MirrorBall, outline::ConeSighting},
};

/// Expected common widening of outlines, pixels: what the look of a mirror's edge is off by.
const GROWTH_SIGMA_PX: f64 = 0.1;
/// Iterations of the least squares; from within a few pixels four are enough.
const ITERATIONS: usize = 30;
/// Length of the last step, in standard deviations, at which the unknowns have settled all the same: views between Huber's
/// squares and lines make steps small but slow.
const SETTLED: f64 = 0.01;
/// Squared deviation beyond which a view contradicts: by chance one of 4 million does (χ² of three degrees of freedom), and
/// outlines are not that normal.
const CONTRADICTION: f64 = 33.0;
/// Pictures nearer to each other than this are from the same side: 15°, which turn the reflections at the rim by 30°.
const SAME_SIDE_RAD: f64 = 0.262;
/// Largest factor between expected and found standard deviations of views that agree.
pub(super) const MAX_SCALE: f64 = 6.0;

/// A view's cone in the form that is solved for.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) index: usize,
    camera_from_world: Pose,
    axis: DVec3,
    half_angle: f64,
    basis: [DVec3; 2],
    px_per_rad: f64,
    /// Inverse of the lower Cholesky factor of the covariance: makes residuals independent and of unit variance.
    whiten: Matrix3<f64>,
}

/// Makes pictures from the same side count as one: what the surroundings show just inside the outline, and so its error,
/// is alike there.
pub(super) fn share_sides(seen: &mut [Seen], about: &MirrorBall) {
    let sides: Vec<DVec3> = seen
        .iter()
        .map(|view| (view.camera_from_world.inverse().translation - about.center_m).normalize_or(DVec3::Z))
        .collect();
    for (view, side) in seen.iter_mut().zip(&sides) {
        let n_near = sides
            .iter()
            .filter(|other| other.angle_between(*side) < SAME_SIDE_RAD)
            .count();
        view.whiten /= (n_near as f64).sqrt();
    }
}

/// A joint solution.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub(super) ball: MirrorBall,
    pub(super) growth_px: f64,
    pub(super) covariance_m2: Matrix4<f64>,
    pub(super) scale: f64,
    /// Views that count.
    pub(super) used: Vec<usize>,
    /// The view furthest off, and how far, pixels.
    pub(super) worst: (usize, f64),
    /// Whether the solve came to rest.
    pub(super) has_settled: bool,
}

impl Solution {
    /// Whether even the views that are left do not fit together.
    pub(super) fn is_contradictory(&self) -> bool {
        self.scale > MAX_SCALE
    }
}

impl Seen {
    /// `about` is the ball as known so far, for its distance. Of the camera's uncertain place only the part along the line of
    /// sight is a ball's own: across it, place and orientation err together, and the markers beside the ball stay put.
    pub(super) fn new(index: usize, view: &BallView<'_>, about: &MirrorBall, sighting: &ConeSighting) -> Self {
        let distance_m = view.view.camera_from_world.transform_point(about.center_m).length();
        let pose_rad = sighting.half_angle_rad * view.position_sigma_m / distance_m;
        let covariance = sighting.covariance_rad2 + DMat3::from_diagonal(DVec3::Z * (pose_rad * pose_rad));
        let covariance = Matrix3::from_fn(|i, j| 0.5 * (covariance.col(i)[j] + covariance.col(j)[i]));
        let whiten = covariance.cholesky().and_then(|factor| factor.l().try_inverse());
        Self {
            index,
            camera_from_world: view.view.camera_from_world,
            axis: sighting.axis,
            half_angle: sighting.half_angle_rad,
            basis: sighting.basis,
            px_per_rad: sighting.px_per_rad,
            whiten: whiten.unwrap_or_else(Matrix3::zeros),
        }
    }

    /// Predicted minus seen: axis along the basis and half-angle, radians; `None` from inside the ball.
    fn residual(&self, state: &Vector5<f64>) -> Option<Vector3<f64>> {
        let center = self
            .camera_from_world
            .transform_point(DVec3::new(state[0], state[1], state[2]));
        let distance_m = center.length();
        if !(distance_m > state[3] && state[3] > 0.0) {
            return None;
        }
        let offset = center / distance_m - self.axis;
        let half_angle = (state[3] / distance_m).asin() + state[4] / self.px_per_rad;
        Some(Vector3::new(
            self.basis[0].dot(offset),
            self.basis[1].dot(offset),
            half_angle - self.half_angle,
        ))
    }

    /// The residual in standard deviations and its derivatives by centre, radius and growth.
    fn linearised(&self, state: &Vector5<f64>) -> Option<(Vector3<f64>, SMatrix<f64, 3, 5>)> {
        const STEP: f64 = 1e-6;
        let here = self.residual(state)?;
        let mut jacobian = SMatrix::<f64, 3, 5>::zeros();
        for parameter in 0..5 {
            let at = |by: f64| {
                let mut moved = *state;
                moved[parameter] += by;
                self.residual(&moved)
            };
            jacobian.set_column(parameter, &((at(STEP)? - at(-STEP)?) / (2.0 * STEP)));
        }
        Some((self.whiten * here, self.whiten * jacobian))
    }

    /// How far this view's cone is from a solution's, pixels.
    fn off_px(&self, state: &Vector5<f64>) -> f64 {
        self.residual(state)
            .map_or(f64::INFINITY, |residual| residual.norm() * self.px_per_rad)
    }

    /// How this view's outline compares with a solution.
    pub(super) fn agreement(&self, solution: &Solution, sighting: &ConeSighting) -> Agreement {
        let residual = self.residual(&state(&solution.ball, solution.growth_px));
        let residual = residual.unwrap_or_else(|| Vector3::repeat(f64::INFINITY));
        Agreement {
            center_error_px: residual.xy().norm() * self.px_per_rad,
            radius_error_px: -residual.z * self.px_per_rad,
            radius_px: self.half_angle * self.px_per_rad,
            deviation_squared: (self.whiten * residual).norm_squared(),
            share: sighting.n_used as f64 / sighting.n_profiles as f64,
        }
    }
}

/// Solves, and leaves out views that contradict, the worst first, as long as a majority remains: few views always agree, and two
/// prove nothing against two others. Outlines are expected to be off by `expected_scale` times their standard deviations, 1 or
/// more.
pub(super) fn robust(
    seen: &[Seen],
    start: &MirrorBall,
    radius: Option<Measured>,
    expected_scale: f64,
) -> Option<Solution> {
    let mut used: Vec<&Seen> = seen.iter().collect();
    let majority = seen.len() / 2 + 1;
    let mut worst_of_all: Option<(usize, f64)> = None;
    loop {
        let Solved {
            state: solved,
            normal,
            has_settled,
        } = solve(&used, state(start, 0.0), radius)?;
        let freedom = |n_views: usize| (3 * n_views + usize::from(radius.is_some())).saturating_sub(4).max(1) as f64;
        let sum = sum_of_squares(&used, &solved);
        let furthest = used.iter().map(|view| (view.index, view.off_px(&solved)));
        let furthest = furthest.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let worst = worst_of_all.get_or_insert(furthest);
        // A wrong view pulls the solution, and all views are off then: the one without which the others agree best is wrong.
        if used.len() > majority
            && let Some((position, rest)) = best_without_one(&used, &solved, radius)
            && sum - rest > CONTRADICTION * (rest / freedom(used.len() - 1)).max(expected_scale.powi(2))
        {
            let removed = used.remove(position);
            let others = solve(&used, solved, radius)?;
            let off_px = removed.off_px(&others.state);
            if off_px > worst.1 {
                *worst = (removed.index, off_px);
            }
            continue;
        }
        let spread = sum / freedom(used.len());
        let scale = spread.max(1.0).sqrt();
        let covariance = normal.try_inverse()? * (scale * scale);
        return Some(Solution {
            ball: MirrorBall {
                center_m: DVec3::new(solved[0], solved[1], solved[2]),
                radius_m: solved[3],
            },
            growth_px: solved[4],
            covariance_m2: covariance.fixed_view::<4, 4>(0, 0).into_owned(),
            scale,
            used: used.iter().map(|view| view.index).collect(),
            worst: *worst,
            has_settled,
        });
    }
}

/// Sum of all views' squared deviations.
fn sum_of_squares(seen: &[&Seen], state: &Vector5<f64>) -> f64 {
    seen.iter()
        .map(|view| {
            let residual = view.residual(state);
            residual.map_or(f64::INFINITY, |residual| (view.whiten * residual).norm_squared())
        })
        .sum()
}

/// The view without which the others agree best, and the sum of their squared deviations then.
fn best_without_one(seen: &[&Seen], start: &Vector5<f64>, radius: Option<Measured>) -> Option<(usize, f64)> {
    let without = |position: usize| {
        let mut others = seen.to_vec();
        others.remove(position);
        let solved = solve(&others, *start, radius)?;
        Some((position, sum_of_squares(&others, &solved.state)))
    };
    (0..seen.len()).filter_map(without).min_by(|a, b| a.1.total_cmp(&b.1))
}

fn state(ball: &MirrorBall, growth_px: f64) -> Vector5<f64> {
    let center = ball.center_m;
    Vector5::new(center.x, center.y, center.z, ball.radius_m, growth_px)
}

/// Where a solve ended.
struct Solved {
    state: Vector5<f64>,
    normal: Matrix5<f64>,
    /// Whether its steps had become short.
    has_settled: bool,
}

/// Gauss and Newton's method with Huber weights on whole views.
fn solve(seen: &[&Seen], start: Vector5<f64>, radius: Option<Measured>) -> Option<Solved> {
    let mut state = start;
    for iteration in 0..ITERATIONS {
        let mut normal = Matrix5::zeros();
        let mut gradient = Vector5::zeros();
        normal[(4, 4)] += GROWTH_SIGMA_PX.powi(-2);
        gradient[4] += state[4] * GROWTH_SIGMA_PX.powi(-2);
        if let Some(Measured { value_m, sigma_m }) = radius {
            normal[(3, 3)] += sigma_m.powi(-2);
            gradient[3] += (state[3] - value_m) * sigma_m.powi(-2);
        }
        for view in seen {
            let (residual, jacobian) = view.linearised(&state)?;
            // Three components: the deviation of one that has the same probability.
            let (_, weight) = Loss::Huber.cost_and_weight(residual.norm() / 3f64.sqrt());
            normal += jacobian.transpose() * jacobian * weight;
            gradient += jacobian.transpose() * residual * weight;
        }
        // Metres and pixels: scaled so that the diagonal is 1.
        let scale = normal.diagonal().map(|x| 1.0 / x.sqrt());
        let scaled = Matrix5::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
        let step = scaled
            .cholesky()?
            .solve(&gradient.component_mul(&scale))
            .component_mul(&scale);
        // Not past the ball's own size at once.
        let longest = step.fixed_rows::<4>(0).norm();
        let shorten = (0.3 * state[3] / longest).min(1.0);
        state -= step * shorten;
        if state[3] <= 0.0 || !state.iter().all(|x| x.is_finite()) {
            return None;
        }
        let in_sigmas = (normal * step).dot(&step).sqrt();
        if longest < 1e-9 || iteration + 1 == ITERATIONS {
            return Some(Solved {
                state,
                normal,
                has_settled: longest < 1e-9 || in_sigmas < SETTLED,
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn camera(from: DVec3, target: DVec3) -> Pose {
        let forward = (target - from).normalize();
        let right = forward.any_orthonormal_vector();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        Pose {
            rotation,
            translation: -(rotation * from),
        }
    }

    /// What a camera of 600 pixels' focal length sees of a ball, wrong by `error_px`.
    fn seen(index: usize, camera_from_world: Pose, ball: &MirrorBall, error_px: [f64; 3]) -> Seen {
        let center = camera_from_world.transform_point(ball.center_m);
        let basis = center.normalize().any_orthonormal_pair();
        let turned = basis.0 * error_px[0] + basis.1 * error_px[1];
        let axis = (center.normalize() + turned / 600.0).normalize();
        Seen {
            index,
            camera_from_world,
            axis,
            half_angle: (ball.radius_m / center.length()).asin() + error_px[2] / 600.0,
            basis: axis.any_orthonormal_pair().into(),
            px_per_rad: 600.0,
            whiten: Matrix3::identity() * (600.0 / 0.1),
        }
    }

    const BALL: MirrorBall = MirrorBall {
        center_m: DVec3::new(0.2, 0.1, 0.04),
        radius_m: 0.038,
    };

    fn around(n: usize) -> Vec<Pose> {
        (0..n)
            .map(|i| {
                let angle = 1.1 * i as f64;
                let from = BALL.center_m + DVec3::new(0.35 * angle.cos(), 0.35 * angle.sin(), 0.3);
                camera(from, BALL.center_m + DVec3::new(0.0, 0.03, 0.02))
            })
            .collect()
    }

    proptest! {
        #[test]
        fn exact_cones_give_the_ball(x in -0.004f64..0.004, y in -0.004f64..0.004, grown in 0.8f64..1.25) {
            let views: Vec<Seen> = around(3).into_iter().enumerate().map(|(i, pose)| seen(i, pose, &BALL, [0.0; 3])).collect();
            let start = MirrorBall { center_m: BALL.center_m + DVec3::new(x, y, -x), radius_m: grown * BALL.radius_m };
            let solution = robust(&views, &start, None, 1.0).unwrap();
            prop_assert!((solution.ball.center_m - BALL.center_m).length() < 1e-8);
            prop_assert!((solution.ball.radius_m - BALL.radius_m).abs() < 1e-8);
        }
    }

    #[test]
    fn errors_are_as_large_as_the_covariance_says() {
        let mut squared = 0.0;
        let mut noise = 1u64;
        let mut normal = || {
            // The sum of twelve uniform numbers less six has unit variance.
            (0..12)
                .map(|_| {
                    noise = noise
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    (noise >> 11) as f64 / (1u64 << 53) as f64
                })
                .sum::<f64>()
                - 6.0
        };
        let n_trials = 300;
        for _ in 0..n_trials {
            let blur = 0.1 * normal();
            let views: Vec<Seen> = around(5)
                .into_iter()
                .enumerate()
                .map(|(i, pose)| seen(i, pose, &BALL, [0.1 * normal(), 0.1 * normal(), 0.1 * normal() + blur]))
                .collect();
            let solution = robust(&views, &BALL, None, 1.0).unwrap();
            let covariance = solution.covariance_m2 / solution.scale.powi(2);
            let offset = solution.ball.center_m - BALL.center_m;
            let error = nalgebra::Vector4::new(offset.x, offset.y, offset.z, solution.ball.radius_m - BALL.radius_m);
            squared += (error.transpose() * covariance.try_inverse().unwrap() * error)[0] / 4.0;
        }
        let ratio = (squared / f64::from(n_trials)).sqrt();
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
    }

    #[test]
    fn a_view_of_something_else_is_left_out() {
        let mut views: Vec<Seen> = around(5)
            .into_iter()
            .enumerate()
            .map(|(i, pose)| seen(i, pose, &BALL, [0.0; 3]))
            .collect();
        views[3] = seen(3, around(5)[3], &BALL, [5.0, -3.0, 1.0]);
        let solution = robust(&views, &BALL, None, 1.0).unwrap();
        assert_eq!(solution.used, [0, 1, 2, 4]);
        assert_eq!(solution.worst.0, 3);
        assert!((solution.ball.center_m - BALL.center_m).length() < 1e-6);
    }

    #[test]
    fn one_of_four_is_left_out_though_the_others_are_worse_than_expected() {
        // Outlines three and more standard deviations off.
        let errors = [
            [0.3, -0.2, 0.25],
            [-0.35, 0.1, -0.3],
            [0.1, 0.3, 0.2],
            [-0.2, -0.3, -0.25],
        ];
        for wrong in 0..4 {
            let cone = |i: usize, pose: Pose| {
                let ball = MirrorBall {
                    center_m: BALL.center_m + DVec3::new(0.003, 0.002, 0.0) * f64::from(u8::from(i == wrong)),
                    ..BALL
                };
                seen(i, pose, &ball, errors[i])
            };
            let views: Vec<Seen> = around(4)
                .into_iter()
                .enumerate()
                .map(|(i, pose)| cone(i, pose))
                .collect();
            let solution = robust(&views, &BALL, None, 1.0).unwrap();
            let others: Vec<usize> = (0..4).filter(|i| *i != wrong).collect();
            assert_eq!(solution.used, others);
            assert_eq!(solution.worst.0, wrong);
            assert!(!solution.is_contradictory(), "{}", solution.scale);
            assert!((solution.ball.center_m - BALL.center_m).length() < 5e-4);
        }
    }

    #[test]
    fn two_against_two_contradict() {
        let cone = |i: usize, pose: Pose| {
            let moved = DVec3::new(0.004, 0.0, 0.0) * f64::from(u8::from(i >= 2));
            let ball = MirrorBall {
                center_m: BALL.center_m + moved,
                ..BALL
            };
            seen(i, pose, &ball, [0.0; 3])
        };
        let views: Vec<Seen> = around(4)
            .into_iter()
            .enumerate()
            .map(|(i, pose)| cone(i, pose))
            .collect();
        assert!(robust(&views, &BALL, None, 1.0).unwrap().is_contradictory());
    }
}
