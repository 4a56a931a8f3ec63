//! Least squares on display pixels.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Vector6};

use super::{Alignment, DisplayIntrinsics};
use crate::{
    extrinsics::bundle::twist,
    least_squares::arrow::{self, ArrowProblem, ArrowSystem, SolveError, Weighted},
    pose::Pose,
};

/// Focal lengths, skew, principal point; then the twist of the eye.
pub(super) const UNKNOWNS: usize = 11;

/// Iterations of a solve; intrinsics and place of an eye are nearly exchangeable.
const MAX_ITERATIONS: usize = 300;

/// All unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub(super) intrinsics: DisplayIntrinsics,
    pub(super) eye_from_headset: Pose,
}

/// A solution.
pub(super) struct Fit {
    pub(super) state: State,
    /// For alignments of unit variance.
    pub(super) covariance: DMatrix<f64>,
}

/// Where the points appear minus where they were seen; `None` when one is behind the eye.
pub(super) fn errors(state: &State, alignments: &[Alignment]) -> Option<Vec<DVec2>> {
    alignments
        .iter()
        .map(|alignment| Some(look(state, alignment)?.0))
        .collect()
}

/// The error of an alignment and the derivatives of both its coordinates by all unknowns.
fn look(state: &State, alignment: &Alignment) -> Option<(DVec2, [[f64; UNKNOWNS]; 2])> {
    let point = state.eye_from_headset.transform_point(alignment.point);
    if point.z <= 0.0 {
        return None;
    }
    let (x, y) = (point.x / point.z, point.y / point.z);
    let (focal, skew) = (state.intrinsics.focal_px, state.intrinsics.skew_px);
    let pixel = DVec2::new(focal.x * x + skew * y, focal.y * y) + state.intrinsics.principal_point_px;
    let gradients = [
        DVec3::new(focal.x, skew, -(focal.x * x + skew * y)) / point.z,
        DVec3::new(0.0, focal.y, -focal.y * y) / point.z,
    ];
    let by_intrinsics = [[x, 0.0, y, 1.0, 0.0], [0.0, y, 0.0, 0.0, 1.0]];
    let rows = std::array::from_fn(|axis| {
        let turn = point.cross(gradients[axis]);
        let mut row = [0.0; UNKNOWNS];
        row[..5].copy_from_slice(&by_intrinsics[axis]);
        row[5..8].copy_from_slice(&turn.to_array());
        row[8..].copy_from_slice(&gradients[axis].to_array());
        row
    });
    Some((pixel - alignment.pixel, rows))
}

struct Problem<'a> {
    alignments: &'a [Alignment],
}

impl ArrowProblem for Problem<'_> {
    type State = State;

    fn linearise(&self, state: &State) -> Option<ArrowSystem> {
        let mut system = ArrowSystem::new(UNKNOWNS, 0);
        for alignment in self.alignments {
            let (error, rows) = look(state, alignment)?;
            system.cost += 0.5 * error.length_squared();
            for (axis, row) in rows.into_iter().enumerate() {
                let row: Vec<(usize, f64)> = row.into_iter().enumerate().collect();
                system.add_shared(
                    &row,
                    Weighted {
                        residual: error[axis],
                        weight: 1.0,
                    },
                );
            }
        }
        Some(system)
    }

    fn cost(&self, state: &State) -> Option<f64> {
        let errors = errors(state, self.alignments)?;
        Some(errors.iter().map(|error| 0.5 * error.length_squared()).sum())
    }

    fn moved(&self, state: &State, shared: &[f64], _: &[Vector6<f64>]) -> Option<State> {
        let intrinsics = DisplayIntrinsics {
            focal_px: state.intrinsics.focal_px + DVec2::new(shared[0], shared[1]),
            skew_px: state.intrinsics.skew_px + shared[2],
            principal_point_px: state.intrinsics.principal_point_px + DVec2::new(shared[3], shared[4]),
        };
        let step = Pose::exp(twist(&shared[5..]));
        (intrinsics.focal_px.min_element() > 0.0).then(|| State {
            intrinsics,
            eye_from_headset: (step * state.eye_from_headset).orthonormalized(),
        })
    }
}

/// Refines a start.
pub(super) fn refine(alignments: &[Alignment], start: State) -> Result<Fit, SolveError> {
    let minimum = arrow::minimise(&Problem { alignments }, start, MAX_ITERATIONS, &mut |_| {})?;
    Ok(Fit {
        state: minimum.state,
        covariance: minimum.system.shared_covariance().ok_or(SolveError::Singular)?,
    })
}
