//! Levenberg-Marquardt where a few unknowns are shared and all others come in blocks that know the shared ones only.
//!
//! A lens and the poses of a board before it, or markers and the poses of a camera that sees them, are such problems. Their
//! normal matrix is an arrow: the blocks on the diagonal, and borders where they meet the shared unknowns. Eliminating the
//! blocks (Schur complement; Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6.1) leaves a small
//! dense system.

use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

/// Unknowns of a block: a pose.
pub const BLOCK: usize = 6;

/// A step changes every unknown by less than this many of its standard deviations (of unit-variance residuals) at the end.
const STEP_TOLERANCE: f64 = 1e-7;

/// Damping at which no step helps any more.
const MAX_DAMPING: f64 = 1e14;

/// Damping up to which a short step is short because the minimum is near, and not because it is damped.
const LITTLE_DAMPING: f64 = 1e-2;

/// Part of the cost, and cost in residuals of unit variance, by which a step that is hardly damped may still promise to
/// improve a minimum.
const PROMISE: [f64; 2] = [1e-6, 1e-9];

/// What is to be made small.
pub trait ArrowProblem {
    /// All unknowns.
    type State: Clone;

    /// The problem, linearised at a state; `None` where it is not defined, such as a point behind a lens.
    fn linearise(&self, state: &Self::State) -> Option<ArrowSystem>;

    /// The cost at a state, as [`ArrowSystem::cost`] would be.
    fn cost(&self, state: &Self::State) -> Option<f64>;

    /// The state moved by a step in every unknown; `None` where that makes no sense, such as a negative focal length.
    fn moved(&self, state: &Self::State, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<Self::State>;
}

/// Normal equations `N x = -g` with an arrow for N.
#[derive(Debug, Clone)]
pub struct ArrowSystem {
    /// Sum of the residuals' costs.
    pub cost: f64,
    /// The shared unknowns' corner of N.
    pub shared: DMatrix<f64>,
    /// The shared unknowns' part of g.
    pub shared_gradient: DVector<f64>,
    /// The blocks.
    pub blocks: Vec<ArrowBlock>,
}

/// A block of the normal equations.
#[derive(Debug, Clone)]
pub struct ArrowBlock {
    /// The block on N's diagonal.
    pub normal: Matrix6<f64>,
    /// Its part of g.
    pub gradient: Vector6<f64>,
    /// The border: rows are shared unknowns, columns the block's.
    pub coupling: DMatrix<f64>,
}

/// A residual and its weight in the sum of squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighted {
    /// The residual.
    pub residual: f64,
    /// The weight.
    pub weight: f64,
}

/// How far a solve has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// Number of the iteration, from 1.
    pub number: usize,
    /// Cost after it.
    pub cost: f64,
}

/// Where a solve ended.
#[derive(Debug, Clone)]
pub struct Minimum<S> {
    /// The unknowns.
    pub state: S,
    /// The equations there; their cost is the least.
    pub system: ArrowSystem,
    /// Iterations that it took.
    pub iterations: usize,
}

/// Why there is no minimum.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// The start is outside the problem.
    #[error("the start of the solve is not possible: a point that was seen cannot be seen from there")]
    Start,
    /// Some unknowns are not determined.
    #[error("the measurements do not determine all unknowns")]
    Singular,
    /// It takes too long.
    #[error("the solve does not converge: after `{iterations}` iterations its steps are still large")]
    NotConverged {
        /// Iterations made.
        iterations: usize,
    },
}

impl ArrowSystem {
    /// Equations without any residual.
    #[must_use]
    pub fn new(n_shared: usize, n_blocks: usize) -> Self {
        let block = ArrowBlock {
            normal: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            coupling: DMatrix::zeros(n_shared, BLOCK),
        };
        Self {
            cost: 0.0,
            shared: DMatrix::zeros(n_shared, n_shared),
            shared_gradient: DVector::zeros(n_shared),
            blocks: vec![block; n_blocks],
        }
    }

    /// Adds a residual that knows one block and the shared unknowns listed in `by_shared` as (index, derivative). The
    /// residual's cost is not added.
    pub fn add(&mut self, block: usize, by_shared: &[(usize, f64)], by_block: &Vector6<f64>, weighted: Weighted) {
        self.add_shared(by_shared, weighted);
        let Weighted { residual, weight } = weighted;
        let block = &mut self.blocks[block];
        block.normal += by_block * by_block.transpose() * weight;
        block.gradient += by_block * (weight * residual);
        for &(row, a) in by_shared {
            for column in 0..BLOCK {
                block.coupling[(row, column)] += weight * a * by_block[column];
            }
        }
    }

    /// Adds a residual that knows shared unknowns only, such as an expectation. The residual's cost is not added.
    pub fn add_shared(&mut self, by_shared: &[(usize, f64)], weighted: Weighted) {
        let Weighted { residual, weight } = weighted;
        for &(row, a) in by_shared {
            self.shared_gradient[row] += weight * a * residual;
            for &(column, b) in by_shared {
                self.shared[(row, column)] += weight * a * b;
            }
        }
    }

    /// Adds another system of the same shape: sums made by several threads.
    pub fn merge(&mut self, other: &Self) {
        self.cost += other.cost;
        self.shared += &other.shared;
        self.shared_gradient += &other.shared_gradient;
        for (block, other) in self.blocks.iter_mut().zip(&other.blocks) {
            block.normal += other.normal;
            block.gradient += other.gradient;
            block.coupling += &other.coupling;
        }
    }

    /// Covariance of the shared unknowns for residuals of unit variance: the inverse of the Schur complement. `None` when
    /// they are not determined.
    #[must_use]
    pub fn shared_covariance(&self) -> Option<DMatrix<f64>> {
        let (complement, _) = self.eliminate(0.0)?;
        inverse(complement)
    }

    /// Covariance of a block's unknowns, the shared ones being uncertain too, for residuals of unit variance.
    #[must_use]
    pub fn block_covariance(&self, block: usize) -> Option<Matrix6<f64>> {
        let shared = self.shared_covariance()?;
        let block = &self.blocks[block];
        let own = block.normal.cholesky()?.inverse();
        let influence = own * block.coupling.transpose();
        let spread = influence.clone() * shared * influence.transpose();
        Some(own + Matrix6::from_iterator(spread.iter().copied()))
    }

    /// The step that Levenberg and Marquardt take.
    fn step(&self, damping: f64) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
        let (complement, gradient) = self.eliminate(damping)?;
        let shared = -scaled_solve(&complement, &gradient)?;
        let mut blocks = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let right = block.gradient + block.coupling.transpose() * &shared;
            blocks.push(-damped(&block.normal, damping).cholesky()?.solve(&right));
        }
        Some((shared, blocks))
    }

    /// The system of the shared unknowns alone.
    fn eliminate(&self, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let mut complement = self.shared.clone();
        for i in 0..complement.nrows() {
            complement[(i, i)] *= 1.0 + damping;
        }
        let mut gradient = self.shared_gradient.clone();
        for block in &self.blocks {
            let factor = damped(&block.normal, damping).cholesky()?;
            let solved = factor.solve(&block.coupling.transpose());
            complement -= &block.coupling * solved;
            gradient -= &block.coupling * factor.solve(&block.gradient);
        }
        Some((complement, gradient))
    }

    /// By how much a step that is hardly damped promises to lower the cost: large where steps stop short of a minimum, as at the
    /// edge of what a lens can be.
    fn promise(&self) -> f64 {
        let Some((shared, blocks)) = self.step(LITTLE_DAMPING) else {
            return f64::INFINITY;
        };
        let own = self.shared_gradient.dot(&shared);
        let others = self.blocks.iter().zip(&blocks);
        let others: f64 = others.map(|(block, step)| block.gradient.dot(step)).sum();
        -0.5 * (own + others)
    }

    /// Length of a step in standard deviations of the undamped unknowns, the largest of all.
    fn relative_length(&self, shared: &DVector<f64>, blocks: &[Vector6<f64>]) -> f64 {
        let own = (0..shared.len()).map(|i| shared[i].abs() * self.shared[(i, i)].sqrt());
        let others = self.blocks.iter().zip(blocks);
        let others =
            others.flat_map(|(block, step)| (0..BLOCK).map(move |i| step[i].abs() * block.normal[(i, i)].sqrt()));
        own.chain(others).fold(0.0, f64::max)
    }
}

/// Moves the unknowns to the nearest minimum; `report` hears of every iteration.
///
/// # Errors
/// When the start is not possible, unknowns are not determined, or it does not converge within `max_iterations`.
pub fn minimise<P: ArrowProblem>(
    problem: &P,
    start: P::State,
    max_iterations: usize,
    report: &mut dyn FnMut(Iteration),
) -> Result<Minimum<P::State>, SolveError> {
    match descend(problem, start, max_iterations, report)? {
        (minimum, true) => Ok(minimum),
        (minimum, false) => Err(SolveError::NotConverged {
            iterations: minimum.iterations,
        }),
    }
}

/// Moves the unknowns towards the nearest minimum, `max_iterations` steps at most: on the way of a robust loss that is
/// then changed; `report` hears of every iteration.
///
/// # Errors
/// When the start is not possible or unknowns are not determined.
pub fn approach<P: ArrowProblem>(
    problem: &P,
    start: P::State,
    max_iterations: usize,
    report: &mut dyn FnMut(Iteration),
) -> Result<Minimum<P::State>, SolveError> {
    Ok(descend(problem, start, max_iterations, report)?.0)
}

/// Where the steps end, and whether that is a minimum.
fn descend<P: ArrowProblem>(
    problem: &P,
    start: P::State,
    max_iterations: usize,
    report: &mut dyn FnMut(Iteration),
) -> Result<(Minimum<P::State>, bool), SolveError> {
    let mut state = start;
    let mut system = problem.linearise(&state).ok_or(SolveError::Start)?;
    let mut damping = 1e-4;
    let mut iterations = 0;
    while iterations < max_iterations {
        iterations += 1;
        let Some((shared, blocks)) = system.step(damping) else {
            // Rounding can make a weakly determined system indefinite; more damping makes it definite again.
            damping *= 10.0;
            if damping > MAX_DAMPING {
                return Err(SolveError::Singular);
            }
            continue;
        };
        let length = system.relative_length(&shared, &blocks);
        if !length.is_finite() {
            return Err(SolveError::Singular);
        }
        let next = problem.moved(&state, shared.as_slice(), &blocks);
        let next = next.and_then(|next| Some((problem.cost(&next)?, next)));
        let improved = next.filter(|(cost, _)| *cost <= system.cost);
        if let Some((_, next)) = improved {
            system = problem.linearise(&next).ok_or(SolveError::Start)?;
            state = next;
            damping = (damping * 0.1).max(1e-12);
            report(Iteration {
                number: iterations,
                cost: system.cost,
            });
        } else {
            damping *= 10.0;
        }
        if length < STEP_TOLERANCE || damping > MAX_DAMPING {
            let is_minimum = damping <= LITTLE_DAMPING || system.promise() <= PROMISE[0] * system.cost + PROMISE[1];
            let minimum = Minimum {
                state,
                system,
                iterations,
            };
            return Ok((minimum, is_minimum));
        }
    }
    let minimum = Minimum {
        state,
        system,
        iterations,
    };
    Ok((minimum, false))
}

fn damped(normal: &Matrix6<f64>, damping: f64) -> Matrix6<f64> {
    let mut damped = *normal;
    for i in 0..BLOCK {
        damped[(i, i)] *= 1.0 + damping;
    }
    damped
}

/// Scales rows and columns so that the diagonal is 1: unknowns of very different size, such as pixels and coefficients of r⁶,
/// are then told apart from unknowns that are not determined.
fn scales(matrix: &DMatrix<f64>) -> Option<DVector<f64>> {
    let scales = matrix.diagonal().map(|x| 1.0 / x.sqrt());
    scales.iter().all(|x| x.is_finite()).then_some(scales)
}

fn scaled(matrix: &DMatrix<f64>, scales: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scales[i] * scales[j]
    })
}

fn scaled_solve(matrix: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    if matrix.is_empty() {
        return Some(DVector::zeros(0));
    }
    let scales = scales(matrix)?;
    let solution = scaled(matrix, &scales).cholesky()?.solve(&right.component_mul(&scales));
    Some(solution.component_mul(&scales))
}

fn inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    if matrix.is_empty() {
        return Some(matrix);
    }
    let scales = scales(&matrix)?;
    let inverse = scaled(&matrix, &scales).cholesky()?.inverse();
    Some(scaled(&inverse, &scales))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines `y = (a + b_i) x + c_i` through points: a is shared, with b_i = 0 expected; a block uses two of its six.
    struct Lines {
        points: Vec<Vec<(f64, f64)>>,
    }

    #[derive(Clone)]
    struct State {
        shared: f64,
        blocks: Vec<Vector6<f64>>,
    }

    impl Lines {
        fn residuals(&self, state: &State) -> impl Iterator<Item = (usize, f64, f64)> {
            self.points.iter().enumerate().flat_map(move |(i, points)| {
                let (a, block) = (state.shared, state.blocks[i]);
                points.iter().map(move |&(x, y)| (i, x, a * x + block[0] - y))
            })
        }
    }

    impl ArrowProblem for Lines {
        type State = State;

        fn linearise(&self, state: &State) -> Option<ArrowSystem> {
            let mut system = ArrowSystem::new(1, self.points.len());
            system.cost = self.cost(state)?;
            for (block, x, residual) in self.residuals(state) {
                system.add(
                    block,
                    &[(0, x)],
                    &Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                    Weighted { residual, weight: 1.0 },
                );
            }
            for (i, block) in system.blocks.iter_mut().enumerate() {
                for unused in 1..BLOCK {
                    block.normal[(unused, unused)] += 1.0;
                    block.gradient[unused] += state.blocks[i][unused];
                }
            }
            Some(system)
        }

        fn cost(&self, state: &State) -> Option<f64> {
            let fit: f64 = self
                .residuals(state)
                .map(|(_, _, residual)| 0.5 * residual * residual)
                .sum();
            let unused: f64 = state.blocks.iter().map(|b| 0.5 * b.rows(1, 5).norm_squared()).sum();
            Some(fit + unused)
        }

        fn moved(&self, state: &State, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<State> {
            Some(State {
                shared: state.shared + shared[0],
                blocks: state
                    .blocks
                    .iter()
                    .zip(blocks)
                    .map(|(block, step)| block + step)
                    .collect(),
            })
        }
    }

    #[test]
    fn parallel_lines_have_the_least_squares_solution_and_its_covariance() {
        let lines = Lines {
            points: vec![vec![(0.0, 1.0), (1.0, 3.0), (2.0, 5.5)], vec![(0.0, -1.0), (3.0, 5.0)]],
        };
        let start = State {
            shared: 0.0,
            blocks: vec![Vector6::repeat(0.3); 2],
        };
        let mut heard = 0;
        let minimum = minimise(&lines, start, 50, &mut |_| heard += 1).unwrap();
        assert!(heard > 0);
        // Centred: sum of (x - mean) (y - mean) over sum of (x - mean)², both lines together.
        let slope = (4.5 + 9.0) / (2.0 + 4.5);
        assert!((minimum.state.shared - slope).abs() < 1e-9);
        assert!((minimum.state.blocks[1][0] - (2.0 - 1.5 * slope)).abs() < 1e-9);
        let variance = minimum.system.shared_covariance().unwrap()[(0, 0)];
        assert!((variance - 1.0 / 6.5).abs() < 1e-12);
        let offset = minimum.system.block_covariance(1).unwrap()[(0, 0)];
        assert!((offset - (0.5 + 1.5 * 1.5 / 6.5)).abs() < 1e-12);
    }

    #[test]
    fn one_step_approaches_and_does_not_pass_for_a_minimum() {
        let lines = Lines {
            points: vec![vec![(0.0, 1.0), (1.0, 3.0), (2.0, 5.5)], vec![(0.0, -1.0), (3.0, 5.0)]],
        };
        let start = State {
            shared: 7.0,
            blocks: vec![Vector6::repeat(0.3); 2],
        };
        let cost = lines.cost(&start).unwrap();
        let near = approach(&lines, start.clone(), 1, &mut |_| {}).unwrap();
        assert!(near.system.cost < cost);
        let error = minimise(&lines, start, 1, &mut |_| {}).err();
        assert_eq!(error, Some(SolveError::NotConverged { iterations: 1 }));
    }

    /// Lines whose slope may not exceed a bound.
    struct Bounded(Lines);

    impl ArrowProblem for Bounded {
        type State = State;

        fn linearise(&self, state: &State) -> Option<ArrowSystem> {
            self.0.linearise(state)
        }

        fn cost(&self, state: &State) -> Option<f64> {
            self.0.cost(state)
        }

        fn moved(&self, state: &State, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<State> {
            self.0.moved(state, shared, blocks).filter(|next| next.shared < 1.0)
        }
    }

    #[test]
    fn the_edge_of_what_is_possible_is_no_minimum() {
        let lines = Bounded(Lines {
            points: vec![vec![(0.0, 1.0), (1.0, 3.0), (2.0, 5.5)]],
        });
        let start = State {
            shared: 0.0,
            blocks: vec![Vector6::zeros()],
        };
        let stuck = minimise(&lines, start.clone(), 200, &mut |_| {}).map(|minimum| minimum.state.shared);
        assert!(matches!(stuck, Err(SolveError::NotConverged { .. })), "{stuck:?}");
        assert!(approach(&lines, start, 200, &mut |_| {}).unwrap().state.shared > 0.9);
    }

    #[test]
    fn what_is_not_determined_is_said() {
        // One point in each block: a slope cannot be told from offsets.
        let lines = Lines {
            points: vec![vec![(1.0, 1.0)], vec![(2.0, 1.0)]],
        };
        let start = State {
            shared: 0.0,
            blocks: vec![Vector6::zeros(); 2],
        };
        if let Ok(minimum) = minimise(&lines, start, 50, &mut |_| {}) {
            let covariance = minimum.system.shared_covariance();
            assert!(covariance.is_none_or(|c| c[(0, 0)] > 1e9));
        }
    }
}
