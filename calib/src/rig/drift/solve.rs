//! The best explanation of all pictures, given who is suspected.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Matrix6, Vector6};

use super::problem::{Observation, Problem, State, Suspect};
use crate::{
    least_squares::{
        arrow::{ArrowProblem, ArrowSystem, Weighted, minimise},
        loss::Loss,
    },
    pose::{Pose, Twist},
};

/// Iterations at most. Reweighting converges linearly; twenty are usual.
const ITERATIONS: usize = 300;

/// What is far off hardly counts, so that a wrong corner is not taken for a moved marker; but where many corners of a marker
/// are off alike, their cost is there to be saved.
const LOSS: Loss = Loss::Cauchy;

/// Standard deviations at which a corner counts half: 95 % efficient on normal errors (Holland and Welsch 1977).
const CAUCHY: f64 = 2.385;

/// Median length of a vector with two components of unit variance: sqrt(2 ln 2).
const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// An explanation.
#[derive(Debug, Clone)]
pub(super) struct Explanation {
    pub(super) state: State,
    pub(super) cost: f64,
    /// Residuals in units of what is expected of corners of their size; robust.
    pub(super) spread: f64,
    /// Covariance of the suspects' unknowns, in their order.
    pub(super) shared: DMatrix<f64>,
    /// Covariance of each pose, rotation first.
    pub(super) poses: Vec<Matrix6<f64>>,
    /// Residual of every observation in pixels.
    pub(super) residuals: Vec<DVec2>,
}

/// With residuals judged by `scale` times what is expected of them. `None` when the unknowns are not determined.
pub(super) fn explain(problem: &Problem<'_>, suspects: &[Suspect], scale: f64) -> Option<Explanation> {
    run(problem, suspects, scale, problem.start())
}

/// The same from another explanation on.
pub(super) fn explain_from(
    problem: &Problem<'_>,
    suspects: &[Suspect],
    scale: f64,
    from: &Explanation,
) -> Option<Explanation> {
    run(problem, suspects, scale, from.state.clone())
}

fn run(problem: &Problem<'_>, suspects: &[Suspect], scale: f64, start: State) -> Option<Explanation> {
    let trial = Trial {
        problem,
        suspects,
        scale,
    };
    let minimum = minimise(&trial, start, ITERATIONS, &mut |_| {}).ok()?;
    let residuals = problem.observations.iter();
    let residuals: Option<Vec<DVec2>> = residuals.map(|seen| problem.residual(&minimum.state, seen)).collect();
    let residuals = residuals?;
    let unknowns = 6 * problem.blocks.len() + trial.n_shared();
    let spread = spread(&problem.observations, &residuals, unknowns)?;
    // Residuals of unit variance are assumed where their own spread is known.
    let variance = (spread / scale).powi(2).max(1e-6);
    let shared = if suspects.is_empty() {
        DMatrix::zeros(0, 0)
    } else {
        minimum.system.shared_covariance()? * variance
    };
    let poses = (0..problem.blocks.len()).map(|block| {
        let own = minimum.system.blocks[block].normal.cholesky()?.inverse();
        if suspects.is_empty() {
            return Some(own * variance);
        }
        // Poses only need their own covariance where they are asked for: fixed cameras.
        problem.blocks[block].fixed_camera?;
        Some(minimum.system.block_covariance(block)? * variance)
    });
    let poses = poses.map(|covariance| covariance.unwrap_or_else(|| Matrix6::from_diagonal_element(f64::INFINITY)));
    Some(Explanation {
        cost: minimum.system.cost,
        spread,
        shared,
        poses: poses.collect(),
        residuals,
        state: minimum.state,
    })
}

/// Standard deviation of either component in units of the expected one, from the median; the unknowns that were fitted take
/// their part.
fn spread(observations: &[Observation], residuals: &[DVec2], unknowns: usize) -> Option<f64> {
    let lengths = observations.iter().zip(residuals);
    let mut lengths: Vec<f64> = lengths
        .map(|(seen, residual)| residual.length() / seen.sigma_px)
        .collect();
    lengths.sort_by(f64::total_cmp);
    let median = *lengths.get(lengths.len() / 2)?;
    let components = 2.0 * lengths.len() as f64;
    Some(median / RAYLEIGH_MEDIAN * (components / (components - unknowns as f64).max(1.0)).sqrt())
}

/// Cost of a deviation, half its square where it is small, and its weight.
fn cost_and_weight(deviation: f64) -> (f64, f64) {
    let (cost, weight) = LOSS.cost_and_weight(deviation / CAUCHY);
    (cost * CAUCHY * CAUCHY, weight)
}

struct Trial<'a> {
    problem: &'a Problem<'a>,
    suspects: &'a [Suspect],
    scale: f64,
}

impl Trial<'_> {
    fn n_shared(&self) -> usize {
        self.suspects.iter().map(|suspect| suspect.unknowns()).sum()
    }

    /// Derivatives of a residual's component by the suspects' unknowns, as (index, derivative).
    fn by_shared(&self, seen: &Observation, by_marker: &[f64; 6], by_lens: &[f64; 3]) -> Vec<(usize, f64)> {
        let mut first = 0;
        let mut all = Vec::new();
        for suspect in self.suspects {
            let derivatives: &[f64] = match *suspect {
                Suspect::Marker(marker) if marker == seen.marker => by_marker,
                Suspect::Lens(camera) if camera == seen.camera => by_lens,
                Suspect::Marker(_) | Suspect::Lens(_) => &[],
            };
            all.extend(
                derivatives
                    .iter()
                    .enumerate()
                    .map(|(i, derivative)| (first + i, *derivative)),
            );
            first += suspect.unknowns();
        }
        all
    }
}

impl ArrowProblem for Trial<'_> {
    type State = State;

    fn linearise(&self, state: &State) -> Option<ArrowSystem> {
        let mut system = ArrowSystem::new(self.n_shared(), self.problem.blocks.len());
        for seen in &self.problem.observations {
            let linear = self.problem.linear(state, seen)?;
            let sigma = self.scale * seen.sigma_px;
            let (cost, weight) = cost_and_weight(linear.residual.length() / sigma);
            system.cost += cost;
            for axis in 0..2 {
                let by_shared = self.by_shared(seen, &linear.by_marker[axis], &linear.by_lens[axis]);
                let by_pose = Vector6::from_row_slice(&linear.by_pose[axis]);
                let weighted = Weighted {
                    residual: linear.residual[axis],
                    weight: weight / (sigma * sigma),
                };
                system.add(seen.block, &by_shared, &by_pose, weighted);
            }
        }
        system.cost.is_finite().then_some(system)
    }

    fn cost(&self, state: &State) -> Option<f64> {
        let costs = self.problem.observations.iter().map(|seen| {
            let deviation = self.problem.residual(state, seen)?.length() / (self.scale * seen.sigma_px);
            Some(cost_and_weight(deviation).0)
        });
        costs.sum()
    }

    fn moved(&self, state: &State, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<State> {
        let mut next = state.clone();
        for (pose, step) in next.poses.iter_mut().zip(blocks) {
            *pose = (exp(step.as_slice()) * *pose).orthonormalized();
        }
        let mut rest = shared;
        for suspect in self.suspects {
            let (step, others) = rest.split_at(suspect.unknowns());
            rest = others;
            match *suspect {
                Suspect::Marker(marker) => {
                    let pose = &mut next.world_from_marker[marker];
                    *pose = (*pose * exp(step)).orthonormalized();
                }
                Suspect::Lens(camera) => {
                    let lens = &mut next.intrinsics[camera];
                    lens.focal_px *= step[0].exp();
                    lens.principal_point_px += DVec2::new(step[1], step[2]);
                    if !(lens.focal_px.is_finite() && lens.principal_point_px.is_finite()) {
                        return None;
                    }
                }
            }
        }
        Some(next)
    }
}

/// The motion of six numbers, rotation first.
fn exp(step: &[f64]) -> Pose {
    Pose::exp(Twist {
        rotation: DVec3::new(step[0], step[1], step[2]),
        translation: DVec3::new(step[3], step[4], step[5]),
    })
}
