//! From a start to the least squares: parameters freed step by step, then outliers named in rounds.

use glam::DVec2;
use nalgebra::{Matrix3, Vector3};

use super::{
    RejectedBecause,
    planar_pose::MIN_CORNERS,
    problem::{Free, Problem, Sighting, State, WarpFree},
    start::{self, median},
    warp::{WARP, WarpedBoard},
};
use crate::{
    camera::{Intrinsics, Model},
    least_squares::{
        arrow::{Iteration, Minimum, SolveError, approach, minimise},
        loss::Loss,
    },
};

/// Iterations of a solve.
const MAX_ITERATIONS: usize = 100;

/// Suppositions that are followed up.
const FOLLOWED: usize = 3;

/// A corner further off than this many standard deviations is an outlier: of a million honest ones 4 are (Rayleigh's
/// distribution, exp(-5²/2)).
const OUTLIER: f64 = 5.0;

/// A view whose middle corner is further off than this many standard deviations has moved, or shows another board.
const OUTLYING_VIEW: f64 = 4.0;

/// Least noise, over `sigma_px`, that is believed: corners that are exact to the last digit have outliers of rounding.
const LEAST_NOISE: f64 = 0.01;

/// χ² of three degrees of freedom that one flat board in a hundred exceeds.
const BENT: f64 = 11.345;

/// Standard deviation of the warp, in parts of the board's diagonal, from which on it cannot be taken for zero: 0.2 mm on a board
/// of 1 m, which is as flat as glass and aluminium are.
const KNOWN_FLAT: f64 = 2e-4;

/// Most rounds of naming outliers; corners on the edge could go in and out for ever.
const MAX_ROUNDS: usize = 10;

/// Median of Rayleigh's distribution: of the length of a two-dimensional error in standard deviations of a coordinate.
const RAYLEIGH_MEDIAN: f64 = 1.177_410_022_515_474_7;

/// A view that takes no part, by its index, and why.
pub(super) type LeftOut = (usize, RejectedBecause);

/// The least squares.
pub(super) struct Solved {
    pub(super) minimum: Minimum<State>,
    /// Variance of the residuals over `sigma_px`.
    pub(super) variance: f64,
    /// Standard deviations of the warp as long as it was free, in metres.
    pub(super) warp_sigma_m: [f64; WARP],
}

/// A solve at work: the views that take part, and what is known of them.
pub(super) struct Solver<'a> {
    pub(super) board: &'a WarpedBoard,
    pub(super) model: Model,
    pub(super) sightings: Vec<Sighting>,
    pub(super) left_out: Vec<LeftOut>,
    pub(super) progress: &'a mut dyn FnMut(Iteration),
}

impl Solver<'_> {
    /// The best supposition with its parameters freed one after the other, judged by a part of the views; then a pose for every
    /// view through that lens. Views without one are left out.
    pub(super) fn start(&mut self, size_px: [u32; 2]) -> Option<State> {
        let all = std::mem::take(&mut self.sightings);
        let judges = start::judges(&all);
        let mut best: Option<(f64, Intrinsics)> = None;
        for hypothesis in start::hypotheses(self.model, size_px, self.board, &judges, FOLLOWED) {
            let mut state = self.locate(&hypothesis.intrinsics, &judges);
            for free in stages(self.model) {
                state = self.stage(state, free);
            }
            let noise = self.noise(&state).unwrap_or(f64::INFINITY);
            if best.is_none_or(|(least, _)| noise < least) {
                best = Some((noise, state.intrinsics));
            }
        }
        let state = self.locate(&best?.1, &all);
        let is_in = |view: usize| self.sightings.iter().any(|sighting| sighting.view == view);
        let out = all.iter().filter(|sighting| !is_in(sighting.view));
        self.left_out
            .extend(out.map(|sighting| (sighting.view, RejectedBecause::NoPose)));
        Some(state)
    }

    /// Poses through this lens; the views that have one take part.
    fn locate(&mut self, intrinsics: &Intrinsics, sightings: &[Sighting]) -> State {
        let found = sightings
            .iter()
            .filter_map(|one| Some((one.clone(), start::pose(intrinsics, self.board, one)?.0)));
        let (seen, poses): (Vec<_>, Vec<_>) = found.map(|(one, pose)| (one, pose.camera_from_board)).unzip();
        self.sightings = seen;
        State {
            intrinsics: *intrinsics,
            warp: [0.0; WARP],
            poses,
        }
    }

    /// Solves with some parameters free; where that leads nowhere the state stays.
    fn stage(&mut self, state: State, free: Free) -> State {
        let scale = self.noise(&state).unwrap_or(1.0).max(1e-3);
        let problem = Problem {
            board: self.board,
            sightings: &self.sightings,
            free,
            loss: Loss::Huber,
            scale,
        };
        approach(&problem, state.clone(), MAX_ITERATIONS, self.progress).map_or(state, |minimum| minimum.state)
    }

    /// The least squares over the corners that are believed.
    fn minimise(&mut self, state: State, free: Free) -> Result<Minimum<State>, SolveError> {
        let problem = Problem {
            board: self.board,
            sightings: &self.sightings,
            free,
            loss: Loss::Squares,
            scale: 1.0,
        };
        minimise(&problem, state, MAX_ITERATIONS, self.progress)
    }

    /// Everything free, the warp too: first robustly, then plain least squares over the corners that are believed.
    ///
    /// In each round the noise is estimated from the median deviation, which outliers hardly move; what is further off than
    /// [`OUTLIER`] times that is out, what came back is in again.
    pub(super) fn finish(&mut self, state: State) -> Result<Minimum<State>, SolveError> {
        let n_parameters = self.model.parameter_names().len();
        // Of a rational lens the numerator first: with the denominator it would wander off in their common valley.
        let state = self.stage(state, Free::all(n_parameters.min(9), WarpFree::No));
        let state = self.stage(state, Free::all(n_parameters, WarpFree::No));
        let mut state = self.stage(state, Free::all(n_parameters, WarpFree::Yes));
        for _ in 0..MAX_ROUNDS {
            let changed = self.judge(&mut state);
            if self.sightings.is_empty() {
                return Err(SolveError::Start);
            }
            if !changed {
                break;
            }
            state = self.stage(state, Free::all(n_parameters, WarpFree::Yes));
        }
        self.minimise(state, Free::all(n_parameters, WarpFree::Yes))
    }

    /// What a minimum with the warp free says, with the warp taken back to zero where the corners do not ask for one: three
    /// numbers that mean nothing cost accuracy.
    ///
    /// Wald's test of nested models (Seber and Wild, "Nonlinear regression", 1989, section 5.3): of a flat board `wᵀ C⁻¹ w`,
    /// with C the covariance of the warp, is distributed like χ² with three degrees of freedom; there are thousands of
    /// corners, so the limit of the F distribution is meant. Where the views cannot tell a flat board from a bent one
    /// ([`KNOWN_FLAT`]) the warp stays free, and its uncertainty is part of the lens's.
    pub(super) fn conclude(&mut self, bent: Minimum<State>) -> Result<Solved, SolveError> {
        let n_parameters = self.model.parameter_names().len();
        let variance = self.variance(&bent, n_parameters + WARP);
        let covariance = bent.system.shared_covariance().map(|covariance| covariance * variance);
        let of_warp: Option<Matrix3<f64>> = covariance.map(|covariance| {
            covariance
                .fixed_view::<WARP, WARP>(n_parameters, n_parameters)
                .into_owned()
        });
        let warp_sigma_m = of_warp.map_or([f64::NAN; WARP], |of_warp| {
            std::array::from_fn(|i| of_warp[(i, i)].max(0.0).sqrt())
        });
        let known = warp_sigma_m
            .iter()
            .all(|sigma| *sigma < KNOWN_FLAT * self.board.diagonal_m);
        let warp = Vector3::from(bent.state.warp);
        let deviation = of_warp
            .and_then(Matrix3::cholesky)
            .map(|factor| warp.dot(&factor.solve(&warp)));
        if !known || deviation.is_none_or(|deviation| deviation > BENT) {
            return Ok(Solved {
                minimum: bent,
                variance,
                warp_sigma_m,
            });
        }
        let state = State {
            warp: [0.0; WARP],
            ..bent.state
        };
        let minimum = self.minimise(state, Free::all(n_parameters, WarpFree::No))?;
        Ok(Solved {
            variance: self.variance(&minimum, n_parameters),
            minimum,
            warp_sigma_m,
        })
    }

    /// Variance of the residuals over `sigma_px`.
    fn variance(&self, minimum: &Minimum<State>, n_shared: usize) -> f64 {
        let used = self
            .sightings
            .iter()
            .map(|s| s.corners.iter().filter(|c| c.used).count());
        let n_unknowns = n_shared + 6 * self.sightings.len();
        let freedom = (2 * used.sum::<usize>()).saturating_sub(n_unknowns).max(1);
        (2.0 * minimum.system.cost / freedom as f64).max(LEAST_NOISE * LEAST_NOISE)
    }

    /// Standard deviation of the corners' coordinates, over their `sigma_px`, from the median over all corners.
    pub(super) fn noise(&self, state: &State) -> Option<f64> {
        let mut deviations = Vec::new();
        for (index, sighting) in self.sightings.iter().enumerate() {
            deviations.extend(
                sighting
                    .corners
                    .iter()
                    .map(|c| deviation(state.residual(self.board, index, c), c.sigma_px)),
            );
        }
        Some(median(deviations)? / RAYLEIGH_MEDIAN)
    }

    /// Says anew which corners and views are believed; whether anything changed.
    fn judge(&mut self, state: &mut State) -> bool {
        let noise = self.noise(state).unwrap_or(1.0).max(LEAST_NOISE);
        let mut changed = false;
        let mut keep = Vec::with_capacity(self.sightings.len());
        for (index, sighting) in self.sightings.iter_mut().enumerate() {
            let mut deviations = Vec::with_capacity(sighting.corners.len());
            for corner in &mut sighting.corners {
                let deviation = deviation(state.residual(self.board, index, corner), corner.sigma_px);
                deviations.push(deviation);
                let used = deviation < OUTLIER * noise;
                changed |= used != corner.used;
                corner.used = used;
            }
            let used = sighting.corners.iter().filter(|corner| corner.used).count();
            let middle = median(deviations).unwrap_or(f64::INFINITY);
            keep.push(used >= MIN_CORNERS && middle < OUTLYING_VIEW * RAYLEIGH_MEDIAN * noise);
        }
        let mut kept = keep.iter();
        state.poses.retain(|_| *kept.next().expect("one per view"));
        let mut kept = keep.iter();
        let left_out = &mut self.left_out;
        self.sightings.retain(|sighting| {
            let stays = *kept.next().expect("one per view");
            if !stays {
                left_out.push((sighting.view, RejectedBecause::DoesNotFit));
            }
            stays
        });
        changed || keep.contains(&false)
    }
}

fn deviation(residual: Option<DVec2>, sigma_px: f64) -> f64 {
    residual.map_or(f64::INFINITY, |residual| residual.length() / sigma_px)
}

/// Which parameters are freed, one set after the other: first what moves the picture most.
fn stages(model: Model) -> Vec<Free> {
    let coefficients: Vec<usize> = (4..model.parameter_names().len()).collect();
    let mut sets = vec![vec![vec![0, 1]], vec![vec![0, 1], vec![2], vec![3]]];
    let first = coefficients
        .first()
        .map(|&k| vec![vec![0, 1], vec![2], vec![3], vec![k]]);
    let second = coefficients
        .get(1)
        .map(|&k| vec![vec![0, 1], vec![2], vec![3], vec![coefficients[0]], vec![k]]);
    sets.extend(first.into_iter().chain(second));
    sets.into_iter()
        .map(|groups| Free {
            groups,
            warp: WarpFree::No,
        })
        .collect()
}
