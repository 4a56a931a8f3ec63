//! Least squares on what is left at every moment.

use glam::DVec3;
use nalgebra::{DMatrix, Matrix6, Vector6};

use super::{Clocks, HandEye, Moment, Residual, track::Track};
use crate::{
    extrinsics::bundle::twist,
    least_squares::{
        arrow::{self, ArrowProblem, ArrowSystem, SolveError, Weighted},
        loss::Loss,
    },
    pose::{Pose, Twist},
};

/// Iterations of the last solve.
const MAX_ITERATIONS: usize = 100;

/// Iterations of a solve on the way.
const ROUND_ITERATIONS: usize = 20;

/// Solves with a loss that hardly counts what is far off.
const CAUTIOUS_ROUNDS: usize = 3;

/// Solves in all, until the same moments stay.
const MAX_ROUNDS: usize = 12;

/// Standard deviations beyond which a moment is left out: one in 400 000 for normal errors in three directions.
const OUTLIER_SIGMAS: f64 = 5.5;

/// Median of the length of a vector with three components of unit variance (Maxwell's distribution).
const MAXWELL_MEDIAN: f64 = 1.538_17;

/// Least spread, in radians and metres, that errors are judged by: no tracker is better.
const MIN_SPREAD: f64 = 1e-6;

/// Step of the difference quotients, in radians, metres and seconds; all of them are of order 1 here.
const DIFFERENCE: f64 = 1e-6;

/// All unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub(super) headset_from_camera: Pose,
    pub(super) world_from_tracker: Pose,
    pub(super) offset_s: f64,
}

/// What is left: the camera as tracked, in the camera as seen.
pub(super) fn error(state: &State, tracker_from_headset: &Pose, world_from_camera: &Pose) -> Twist {
    let tracked = state.world_from_tracker * *tracker_from_headset * state.headset_from_camera;
    (world_from_camera.inverse() * tracked).log()
}

impl State {
    /// Moved by a twist of the camera, one of the tracker, and perhaps a time.
    fn moved(&self, step: &[f64]) -> Self {
        Self {
            headset_from_camera: (self.headset_from_camera * Pose::exp(twist(&step[..6]))).orthonormalized(),
            world_from_tracker: (self.world_from_tracker * Pose::exp(twist(&step[6..12]))).orthonormalized(),
            offset_s: self.offset_s + step.get(12).copied().unwrap_or(0.0),
        }
    }
}

struct Problem<'a> {
    track: &'a Track<'a>,
    moments: &'a [&'a Moment],
    kept: &'a [bool],
    n_unknowns: usize,
    loss: Loss,
    spread: Spread,
}

/// Standard deviations of rotations (radians) and places (metres), per axis.
#[derive(Debug, Clone, Copy)]
struct Spread {
    rotation: f64,
    place: f64,
}

impl Problem<'_> {
    fn tracked(&self, state: &State, moment: &Moment) -> Option<Pose> {
        self.track.at(self.track.seconds(moment.timestamp_ns) + state.offset_s)
    }

    /// What is left at a moment; `None` when the tracker gave no pose then.
    fn error(&self, state: &State, moment: &Moment) -> Option<[DVec3; 2]> {
        let twist = error(
            state,
            &self.tracked(state, moment)?,
            &moment.camera_from_world.inverse(),
        );
        Some([twist.rotation, twist.translation])
    }

    fn counted(&self) -> impl Iterator<Item = &Moment> {
        let pairs = self.moments.iter().zip(self.kept);
        pairs.filter(|(_, kept)| **kept).map(|(moment, _)| *moment)
    }

    /// Columns: derivatives of the six numbers that are left by each unknown.
    fn derivatives(&self, state: &State, moment: &Moment) -> Option<Vec<[DVec3; 2]>> {
        let world_from_camera = moment.camera_from_world.inverse();
        let here = self.tracked(state, moment)?;
        let column = |index: usize| {
            let at = |sign: f64| {
                let mut step = vec![0.0; self.n_unknowns];
                step[index] = sign * DIFFERENCE;
                let moved = state.moved(&step);
                // Only the time decides about the tracked pose, which is costly.
                let is_pose = index < 12;
                let tracked = if is_pose { here } else { self.tracked(&moved, moment)? };
                let twist = error(&moved, &tracked, &world_from_camera);
                Some([twist.rotation, twist.translation])
            };
            let ([r0, t0], [r1, t1]) = (at(-1.0)?, at(1.0)?);
            Some([(r1 - r0) / (2.0 * DIFFERENCE), (t1 - t0) / (2.0 * DIFFERENCE)])
        };
        (0..self.n_unknowns).map(column).collect()
    }
}

impl ArrowProblem for Problem<'_> {
    type State = State;

    fn linearise(&self, state: &State) -> Option<ArrowSystem> {
        let mut system = ArrowSystem::new(self.n_unknowns, 0);
        for moment in self.counted() {
            // A moment at the end of the track may leave it on the way.
            let (Some(left), Some(columns)) = (self.error(state, moment), self.derivatives(state, moment)) else {
                return None;
            };
            for (part, sigma) in [self.spread.rotation, self.spread.place].into_iter().enumerate() {
                let (cost, weight) = self.loss.cost_and_weight(left[part].length() / sigma);
                system.cost += cost;
                for axis in 0..3 {
                    let row: Vec<(usize, f64)> = columns.iter().map(|column| column[part][axis]).enumerate().collect();
                    system.add_shared(
                        &row,
                        Weighted {
                            residual: left[part][axis],
                            weight: weight / (sigma * sigma),
                        },
                    );
                }
            }
        }
        Some(system)
    }

    fn cost(&self, state: &State) -> Option<f64> {
        let mut cost = 0.0;
        for moment in self.counted() {
            let [rotation, place] = self.error(state, moment)?;
            cost += self.loss.cost_and_weight(rotation.length() / self.spread.rotation).0;
            cost += self.loss.cost_and_weight(place.length() / self.spread.place).0;
        }
        cost.is_finite().then_some(cost)
    }

    fn moved(&self, state: &State, shared: &[f64], _: &[Vector6<f64>]) -> Option<State> {
        Some(state.moved(shared))
    }
}

/// Refines a start, leaves out what does not fit, and says how sure the rest is.
pub(super) fn refine(
    track: &Track<'_>,
    moments: &[&Moment],
    (start, clocks): (State, Clocks),
    untracked: usize,
) -> Result<HandEye, SolveError> {
    // Moments from which the offset may lead out of the track would come and go.
    let margin_s = match clocks {
        Clocks::Same => 0.0,
        Clocks::Offset => super::OFFSET_STEP_S,
    };
    let is_inside = |moment: &&Moment| {
        let time_s = track.seconds(moment.timestamp_ns) + start.offset_s;
        [-margin_s, 0.0, margin_s]
            .iter()
            .all(|margin| track.at(time_s + margin).is_some())
    };
    let inside: Vec<&Moment> = moments.iter().copied().filter(|moment| is_inside(moment)).collect();
    let mut problem = Problem {
        track,
        moments: &inside,
        kept: &vec![true; inside.len()],
        n_unknowns: match clocks {
            Clocks::Same => 12,
            Clocks::Offset => 13,
        },
        loss: Loss::Cauchy,
        spread: Spread {
            rotation: 1.0,
            place: 1.0,
        },
    };
    let mut state = start;
    let mut kept = vec![true; inside.len()];
    problem.spread = robust_spread(&problem, &state).ok_or(SolveError::Start)?;
    for round in 0..MAX_ROUNDS {
        let is_cautious = round < CAUTIOUS_ROUNDS;
        let problem = Problem {
            kept: &kept,
            loss: if is_cautious { Loss::Cauchy } else { Loss::Huber },
            ..problem
        };
        state = arrow::approach(&problem, state, ROUND_ITERATIONS, &mut |_| {})?.state;
        let spread = robust_spread(&problem, &state).ok_or(SolveError::Singular)?;
        let next: Vec<bool> = inside
            .iter()
            .map(|moment| fits(&problem, &state, (moment, spread)))
            .collect();
        if next == kept && !is_cautious {
            break;
        }
        kept = next;
    }
    problem.kept = &kept;
    problem.loss = Loss::Squares;
    for _ in 0..2 {
        problem.spread = spread(&problem, &state).ok_or(SolveError::Singular)?;
        state = arrow::minimise(&problem, state, MAX_ITERATIONS, &mut |_| {})?.state;
    }
    problem.spread = spread(&problem, &state).ok_or(SolveError::Singular)?;
    let system = problem.linearise(&state).ok_or(SolveError::Singular)?;
    let covariance = system.shared_covariance().ok_or(SolveError::Singular)?;
    Ok(result(
        &problem,
        &state,
        &covariance,
        untracked + moments.len() - inside.len(),
    ))
}

fn result(problem: &Problem<'_>, state: &State, covariance: &DMatrix<f64>, untracked: usize) -> HandEye {
    let block = |start: usize| -> Matrix6<f64> { covariance.fixed_view::<6, 6>(start, start).into_owned() };
    let residual = |moment: &Moment| {
        let [rotation, place] = problem.error(state, moment)?;
        Some(Residual {
            name: moment.name.clone(),
            rotation_rad: rotation.length(),
            place_m: place.length(),
        })
    };
    let left_out = problem.moments.iter().zip(problem.kept).filter(|(_, kept)| !**kept);
    HandEye {
        headset_from_camera: state.headset_from_camera,
        world_from_tracker: state.world_from_tracker,
        camera_covariance: block(0),
        tracker_covariance: block(6),
        tracker_minus_camera_s: (problem.n_unknowns > 12).then(|| (state.offset_s, covariance[(12, 12)].sqrt())),
        rotation_spread_rad: problem.spread.rotation,
        place_spread_m: problem.spread.place,
        residuals: problem.counted().filter_map(residual).collect(),
        rejected: left_out.map(|(moment, _)| moment.name.clone()).collect(),
        untracked,
    }
}

fn fits(problem: &Problem<'_>, state: &State, (moment, spread): (&Moment, Spread)) -> bool {
    problem.error(state, moment).is_some_and(|[rotation, place]| {
        rotation.length() <= OUTLIER_SIGMAS * spread.rotation && place.length() <= OUTLIER_SIGMAS * spread.place
    })
}

/// Spread from the medians of what counts.
fn robust_spread(problem: &Problem<'_>, state: &State) -> Option<Spread> {
    let errors: Vec<[DVec3; 2]> = problem
        .counted()
        .filter_map(|moment| problem.error(state, moment))
        .collect();
    let median = |part: usize| {
        let mut lengths: Vec<f64> = errors.iter().map(|error| error[part].length()).collect();
        lengths.sort_by(f64::total_cmp);
        Some((lengths.get(lengths.len() / 2)? / MAXWELL_MEDIAN).max(MIN_SPREAD))
    };
    Some(Spread {
        rotation: median(0)?,
        place: median(1)?,
    })
}

/// Spread from the squares of what counts; each kind of error has taken up half of the unknowns.
fn spread(problem: &Problem<'_>, state: &State) -> Option<Spread> {
    let errors: Vec<[DVec3; 2]> = problem
        .counted()
        .filter_map(|moment| problem.error(state, moment))
        .collect();
    let freedom = 3.0 * errors.len() as f64 - 0.5 * problem.n_unknowns as f64;
    if freedom < 1.0 {
        return None;
    }
    let of = |part: usize| {
        let squares: f64 = errors.iter().map(|error| error[part].length_squared()).sum();
        (squares / freedom).sqrt().max(MIN_SPREAD)
    };
    Some(Spread {
        rotation: of(0),
        place: of(1),
    })
}
