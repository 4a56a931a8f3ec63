//! Robust least squares on the reprojection error: Levenberg-Marquardt on SE(3) with weights for doubtful corners.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix6, Vector6};

use crate::{
    camera::Intrinsics,
    pose::{Pose, Twist},
};

/// Iterations at most; from a start within the basin six are usual.
const ITERATIONS: usize = 50;

/// Huber's constant in standard deviations (Huber 1981): 95 % efficient on normal errors.
const HUBER: f64 = 1.345;

/// A corner of a marker: where it is and where it was seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    /// Place in the world, in metres.
    pub(super) world: DVec3,
    /// Pixel it was seen at.
    pub(super) pixel: DVec2,
    /// Standard deviation expected of `pixel`, in pixels; of relative importance only.
    pub(super) sigma_px: f64,
}

/// How errors are judged, in standard deviations.
#[derive(Debug, Clone, Copy)]
pub(super) enum Loss {
    /// Squares, growing linearly from Huber's constant on: one minimum, for corners that belong.
    Huber,
    /// Bounded (Geman and McClure 1985): what is far off has no say, but where to start matters.
    Bounded,
}

impl Loss {
    /// Cost of a deviation and its weight in the normal equations.
    fn cost_and_weight(self, deviation: f64) -> (f64, f64) {
        match self {
            Self::Huber if deviation <= HUBER => (0.5 * deviation * deviation, 1.0),
            Self::Huber => (HUBER * (deviation - 0.5 * HUBER), HUBER / deviation),
            Self::Bounded => {
                let shrink = 1.0 / (1.0 + deviation * deviation);
                (0.5 * deviation * deviation * shrink, shrink * shrink)
            }
        }
    }

    /// Steps shorter than this, in radians and metres, end the iteration.
    fn step_tolerance(self) -> f64 {
        match self {
            Self::Huber => 1e-12,
            // On the way to another solution only.
            Self::Bounded => 1e-5,
        }
    }
}

/// A pose that fits the corners, and how well it is determined.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solution {
    pub(super) camera_from_world: Pose,
    /// Weighted normal matrix (rotation first, then translation; camera frame), for corners of unit variance.
    pub(super) information: Matrix6<f64>,
}

/// Distance of the corner's image from where it was seen, in pixels; `None` when the camera cannot see it.
pub(super) fn residual(intrinsics: &Intrinsics, pose: &Pose, corner: &Corner) -> Option<DVec2> {
    Some(intrinsics.project(pose.transform_point(corner.world))? - corner.pixel)
}

/// A problem: corners seen through a lens, and how to judge their errors.
pub(super) struct Problem<'a> {
    pub(super) intrinsics: &'a Intrinsics,
    pub(super) corners: &'a [Corner],
    pub(super) loss: Loss,
    /// Standard deviation of a corner whose `sigma_px` is 1, in pixels.
    pub(super) scale: f64,
}

/// Moves the pose to the nearest minimum of the robust error.
///
/// `None` when the start does not see every corner or the corners do not determine a pose.
pub(super) fn refine(problem: &Problem<'_>, start: Pose) -> Option<Solution> {
    let mut pose = start;
    let mut system = System::at(problem, &pose)?;
    let mut damping = 1e-4;
    for _ in 0..ITERATIONS {
        let mut damped = system.normal;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = -damped.cholesky()?.solve(&system.gradient);
        if !step.iter().all(|x| x.is_finite()) {
            return None;
        }
        let twist = Twist {
            rotation: DVec3::new(step[0], step[1], step[2]),
            translation: DVec3::new(step[3], step[4], step[5]),
        };
        let moved = (Pose::exp(twist) * pose).orthonormalized();
        match System::at(problem, &moved).filter(|next| next.cost <= system.cost) {
            Some(next) => {
                (pose, system) = (moved, next);
                damping = (damping * 0.1).max(1e-12);
            }
            None => damping *= 10.0,
        }
        if step.norm() < problem.loss.step_tolerance() || damping > 1e12 {
            break;
        }
    }
    Some(Solution {
        camera_from_world: pose,
        information: system.normal,
    })
}

/// The linearised problem at a pose.
struct System {
    normal: Matrix6<f64>,
    gradient: Vector6<f64>,
    cost: f64,
}

impl System {
    fn at(problem: &Problem<'_>, pose: &Pose) -> Option<Self> {
        let mut system = Self {
            normal: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            cost: 0.0,
        };
        for corner in problem.corners {
            let point = pose.transform_point(corner.world);
            let projection = problem.intrinsics.project_with_gradient(point)?;
            let error = projection.pixel - corner.pixel;
            let sigma = problem.scale * corner.sigma_px;
            let (cost, weight) = problem.loss.cost_and_weight(error.length() / sigma);
            system.cost += cost;
            let weight = weight / (sigma * sigma);
            for (gradient, error) in projection.gradient.into_iter().zip(error.to_array()) {
                let turn = point.cross(gradient);
                let row = Vector6::new(turn.x, turn.y, turn.z, gradient.x, gradient.y, gradient.z);
                system.normal += row * row.transpose() * weight;
                system.gradient += row * (error * weight);
            }
        }
        system.cost.is_finite().then_some(system)
    }
}
