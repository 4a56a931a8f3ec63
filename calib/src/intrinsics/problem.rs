//! Lens, warp of the board and its poses as one arrow-shaped least-squares problem.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Vector6};
use rayon::prelude::*;

use super::warp::{WARP, WarpedBoard};
use crate::{
    camera::{Intrinsics, Jacobians, Model},
    least_squares::{
        arrow::{ArrowProblem, ArrowSystem, Weighted},
        loss::Loss,
    },
    pose::{Pose, Twist},
};

/// Standard deviation that the rational model's k4, k5 and k6 are expected to have. Numerator and denominator undo each other
/// almost; without an expectation they run away together, to a pole just outside the corners that were seen. What the corners do
/// determine they determine a thousand times better.
const EXPECTED_DENOMINATOR: f64 = 0.5;

/// A corner in a picture, and whether it is believed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub(super) index: usize,
    pub(super) pixel: DVec2,
    pub(super) sigma_px: f64,
    pub(super) used: bool,
}

/// The corners of a picture.
#[derive(Debug, Clone)]
pub(super) struct Sighting {
    /// Index of the view among all that were given.
    pub(super) view: usize,
    pub(super) corners: Vec<Corner>,
}

/// What is being solved for.
#[derive(Debug, Clone)]
pub(super) struct State {
    /// The lens; a fisheye's largest angle is π here, so that no corner is cut.
    pub(super) intrinsics: Intrinsics,
    pub(super) warp: [f64; WARP],
    /// camera_from_board of every sighting.
    pub(super) poses: Vec<Pose>,
}

/// Which of the shared numbers may move.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Free {
    /// Lens parameters; those in one group move by the same amount.
    pub(super) groups: Vec<Vec<usize>>,
    /// Whether the warp may.
    pub(super) warp: WarpFree,
}

/// Whether the board's warp is solved for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WarpFree {
    Yes,
    No,
}

/// The problem: residuals are pixels over `sigma_px` of the corner times `scale`.
pub(super) struct Problem<'a> {
    pub(super) board: &'a WarpedBoard,
    pub(super) sightings: &'a [Sighting],
    pub(super) free: Free,
    pub(super) loss: Loss,
    pub(super) scale: f64,
}

impl Free {
    /// Nothing but the poses.
    pub(super) fn poses() -> Self {
        Self {
            groups: Vec::new(),
            warp: WarpFree::No,
        }
    }

    /// Every parameter of the lens by itself.
    pub(super) fn all(n_parameters: usize, warp: WarpFree) -> Self {
        Self {
            groups: (0..n_parameters).map(|i| vec![i]).collect(),
            warp,
        }
    }

    /// Number of shared unknowns.
    pub(super) fn count(&self) -> usize {
        self.groups.len()
            + match self.warp {
                WarpFree::Yes => WARP,
                WarpFree::No => 0,
            }
    }
}

impl State {
    /// Residual of a corner in pixels, seen minus predicted; `None` where the lens does not image it.
    pub(super) fn residual(&self, board: &WarpedBoard, sighting: usize, corner: &Corner) -> Option<DVec2> {
        let point = self.poses[sighting].transform_point(board.bent(corner.index, &self.warp));
        Some(corner.pixel - self.intrinsics.project(point)?)
    }
}

impl Problem<'_> {
    /// Cost of one sighting, with its equations added to `system` by the caller where asked.
    fn sighting_cost(&self, state: &State, index: usize) -> Option<f64> {
        let mut cost = 0.0;
        for corner in self.sightings[index].corners.iter().filter(|corner| corner.used) {
            let residual = state.residual(self.board, index, corner)?;
            cost += self
                .loss
                .cost_and_weight(residual.length() / (corner.sigma_px * self.scale))
                .0;
        }
        Some(cost)
    }

    /// Equations of one sighting alone: a system with one block.
    fn sighting_system(&self, state: &State, index: usize) -> Option<ArrowSystem> {
        let mut system = ArrowSystem::new(self.free.count(), 1);
        let pose = &state.poses[index];
        let mut by_shared = Vec::with_capacity(self.free.count());
        for corner in self.sightings[index].corners.iter().filter(|corner| corner.used) {
            let point = pose.transform_point(self.board.bent(corner.index, &state.warp));
            let jacobians = state.intrinsics.project_with_jacobians(point)?;
            let residual = jacobians.pixel - corner.pixel;
            let sigma = corner.sigma_px * self.scale;
            let (cost, weight) = self.loss.cost_and_weight(residual.length() / sigma);
            system.cost += cost;
            for axis in 0..2 {
                by_shared.clear();
                self.shared_derivatives(&jacobians, axis, &mut by_shared);
                if self.free.warp == WarpFree::Yes {
                    let by_z = jacobians.by_point[axis].dot(pose.rotation.z_axis);
                    let basis = self.board.basis(corner.index);
                    by_shared.extend((0..WARP).map(|i| (self.free.groups.len() + i, basis[i] * by_z)));
                }
                let by_block = by_pose(point, jacobians.by_point[axis]);
                let weighted = Weighted {
                    residual: residual[axis],
                    weight: weight / (sigma * sigma),
                };
                system.add(0, &by_shared, &by_block, weighted);
            }
        }
        Some(system)
    }

    fn shared_derivatives(&self, jacobians: &Jacobians, axis: usize, into: &mut Vec<(usize, f64)>) {
        for (unknown, group) in self.free.groups.iter().enumerate() {
            let sum = group.iter().map(|&i| jacobians.by_parameters[axis][i]).sum();
            into.push((unknown, sum));
        }
    }

    /// Shared unknowns of which something is expected: unknown, value, and standard deviation about zero.
    fn expectations(&self, state: &State) -> Vec<(usize, f64, f64)> {
        let mut expected = Vec::new();
        if state.intrinsics.lens.model() == Model::Rational {
            let parameters = state.intrinsics.parameters();
            for (unknown, group) in self.free.groups.iter().enumerate() {
                if let [index @ 9..=11] = group[..] {
                    expected.push((unknown, parameters[index], EXPECTED_DENOMINATOR));
                }
            }
        }
        if self.free.warp == WarpFree::Yes {
            let warp = state.warp.iter().enumerate();
            expected.extend(warp.map(|(i, value)| (self.free.groups.len() + i, *value, self.board.expected_m)));
        }
        expected
    }

    /// Cost of what is not as expected.
    fn unexpected(&self, state: &State) -> f64 {
        self.expectations(state)
            .iter()
            .map(|(_, value, sigma)| 0.5 * (value / sigma).powi(2))
            .sum()
    }
}

/// How a pixel coordinate moves with a small motion of the board in the camera frame: rotation, then translation.
fn by_pose(point: DVec3, by_point: DVec3) -> Vector6<f64> {
    let turn = point.cross(by_point);
    Vector6::new(turn.x, turn.y, turn.z, by_point.x, by_point.y, by_point.z)
}

impl ArrowProblem for Problem<'_> {
    type State = State;

    fn linearise(&self, state: &State) -> Option<ArrowSystem> {
        let parts: Option<Vec<ArrowSystem>> = (0..self.sightings.len())
            .into_par_iter()
            .map(|index| self.sighting_system(state, index))
            .collect();
        // Summed in order, so that the same input gives the same bits.
        let mut system = ArrowSystem::new(self.free.count(), 0);
        for mut part in parts? {
            system.cost += part.cost;
            system.shared += &part.shared;
            system.shared_gradient += &part.shared_gradient;
            system.blocks.append(&mut part.blocks);
        }
        for (unknown, value, sigma) in self.expectations(state) {
            system.add_shared(
                &[(unknown, 1.0)],
                Weighted {
                    residual: value,
                    weight: sigma.powi(-2),
                },
            );
        }
        system.cost += self.unexpected(state);
        Some(system)
    }

    fn cost(&self, state: &State) -> Option<f64> {
        let costs: Option<Vec<f64>> = (0..self.sightings.len())
            .into_par_iter()
            .map(|index| self.sighting_cost(state, index))
            .collect();
        Some(costs?.iter().sum::<f64>() + self.unexpected(state))
    }

    fn moved(&self, state: &State, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<State> {
        let mut parameters = state.intrinsics.parameters();
        for (group, step) in self.free.groups.iter().zip(shared) {
            for &index in group {
                parameters[index] += step;
            }
        }
        if !(parameters[0] > 0.0 && parameters[1] > 0.0) {
            return None;
        }
        let mut warp = state.warp;
        for (value, step) in warp.iter_mut().zip(&shared[self.free.groups.len()..]) {
            *value += step;
        }
        let poses = state.poses.iter().zip(blocks).map(|(pose, step)| {
            let twist = Twist {
                rotation: DVec3::new(step[0], step[1], step[2]),
                translation: DVec3::new(step[3], step[4], step[5]),
            };
            (Pose::exp(twist) * *pose).orthonormalized()
        });
        Some(State {
            intrinsics: state.intrinsics.with_parameters(&parameters),
            warp,
            poses: poses.collect(),
        })
    }
}

/// The corner of a covariance that belongs to the lens.
pub(super) fn lens_part(covariance: &DMatrix<f64>, n_parameters: usize) -> DMatrix<f64> {
    covariance.view((0, 0), (n_parameters, n_parameters)).into_owned()
}
