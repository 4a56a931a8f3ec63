//! Bundle adjustment of cameras on a carrier, markers, and where the carrier stood.
//!
//! A corner `p` of a marker is seen at `project(camera_from_rig * rig_from_world * world_from_marker * p)`. Cameras and markers that
//! are free are the shared unknowns of an arrow, the stations `rig_from_world` its blocks. Cameras and stations are moved by
//! a twist in their own frame (on the left), markers too (on the right), so that covariances are of places, not of levers.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Matrix6, Vector6};

use crate::{
    camera::Intrinsics,
    least_squares::{
        arrow::{self, ArrowProblem, ArrowSystem, BLOCK, Minimum, SolveError, Weighted},
        loss::Loss,
    },
    pose::{Pose, Twist},
};

/// Iterations of the last solve.
const MAX_ITERATIONS: usize = 100;

/// Iterations of a solve on the way.
const ROUND_ITERATIONS: usize = 25;

/// Solves with a loss that hardly counts what is far off, each judging by the spread that the one before left.
const CAUTIOUS_ROUNDS: usize = 3;

/// Solves in all, until the same corners stay.
const MAX_ROUNDS: usize = 15;

/// Standard deviations beyond which a corner is left out: one in 270 000 for normal errors in two directions.
const OUTLIER_SIGMAS: f64 = 5.0;

/// Least distance, in pixels, at which a corner is left out: exact corners of tests have no spread.
const MIN_OUTLIER_PX: f64 = 0.01;

/// Median of the length of a vector with two components of unit variance (Rayleigh's distribution): sqrt(2 ln 2).
const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// Least spread, in units of the expected one, that errors are judged by.
const MIN_SPREAD: f64 = 1e-3;

/// Corners of a detection that must fit; two wrong ones mean another marker.
const MIN_CORNERS: usize = 3;

/// A camera on the carrier.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    pub(super) intrinsics: Intrinsics,
    pub(super) is_free: bool,
}

/// A square of known side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Square {
    pub(super) id: u32,
    pub(super) side_m: f64,
    pub(super) is_free: bool,
}

/// A marker in a picture. Numbers are indices.
#[derive(Debug, Clone)]
pub(super) struct Sighting {
    /// Number of the picture, for what is said about it.
    pub(super) view: usize,
    pub(super) station: usize,
    pub(super) eye: usize,
    pub(super) square: usize,
    pub(super) corners_px: [DVec2; 4],
    /// Standard deviation expected, of relative importance only.
    pub(super) sigma_px: f64,
}

/// All poses.
#[derive(Debug, Clone)]
pub(super) struct Poses {
    pub(super) camera_from_rig: Vec<Pose>,
    pub(super) world_from_marker: Vec<Pose>,
    pub(super) rig_from_world: Vec<Pose>,
}

/// What was seen of what.
#[derive(Debug, Clone)]
pub(super) struct Bundle {
    /// Names of the pictures.
    pub(super) views: Vec<String>,
    pub(super) eyes: Vec<Eye>,
    pub(super) squares: Vec<Square>,
    pub(super) n_stations: usize,
    pub(super) sightings: Vec<Sighting>,
}

/// How well the markers of one picture fit.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewResult {
    /// Name of the picture.
    pub name: String,
    /// Markers that count.
    pub markers: usize,
    /// Root mean square distance of the corners that count from where they should be, in pixels; NaN without any.
    pub rms_px: f64,
    /// The largest such distance.
    pub worst_px: f64,
}

/// A detection of which at least one corner was left out.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedDetection {
    /// Name of the picture.
    pub view: String,
    /// The marker's id.
    pub marker: u32,
    /// Corners left out, 1 to 4.
    pub corners: usize,
    /// Distance of the worst corner from where it should be, in pixels; infinite for one that could not be seen.
    pub worst_px: f64,
}

/// A solved bundle.
#[derive(Debug, Clone)]
pub(super) struct Settled {
    pub(super) poses: Poses,
    /// The equations at the solution, for corners with the spread expected of them.
    system: ArrowSystem,
    /// Variance of a corner in units of the one expected.
    pub(super) variance: f64,
    /// Root mean square distance over all corners that count, in pixels.
    pub(super) rms_px: f64,
    pub(super) views: Vec<ViewResult>,
    pub(super) rejected: Vec<RejectedDetection>,
    layout: Layout,
}

/// Why a bundle has no solution.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// What was seen of a marker agrees on no place.
    #[error("the pictures of marker `{id}` agree on no place for it")]
    Contradictory {
        /// Its id.
        id: u32,
    },
    /// The solve failed.
    #[error(transparent)]
    Solve(#[from] SolveError),
}

/// Places of the free poses among the shared unknowns.
#[derive(Debug, Clone)]
struct Layout {
    eyes: Vec<Option<usize>>,
    squares: Vec<Option<usize>>,
    n_shared: usize,
}

/// A corner that is looked at, with the derivatives of both coordinates by eye, square and station.
struct Look {
    residual: DVec2,
    by_eye: [Vector6<f64>; 2],
    by_square: [Vector6<f64>; 2],
    by_station: [Vector6<f64>; 2],
}

/// Corners of a square of this side in its own frame: bottom-left, bottom-right, top-right, top-left.
pub(super) fn corners_m(side_m: f64) -> [DVec3; 4] {
    let half = 0.5 * side_m;
    [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| DVec3::new(x, y, 0.0))
}

impl Bundle {
    /// Distances, in pixels, of a sighting's corners from where they should be; infinite for what could not be seen.
    pub(super) fn errors_px(&self, poses: &Poses, sighting: &Sighting) -> [f64; 4] {
        let camera_from_world = poses.camera_from_rig[sighting.eye] * poses.rig_from_world[sighting.station];
        self.errors_from_px(&camera_from_world, &poses.world_from_marker, sighting)
    }

    /// The same for a camera that stands here.
    pub(super) fn errors_from_px(
        &self,
        camera_from_world: &Pose,
        world_from_marker: &[Pose],
        sighting: &Sighting,
    ) -> [f64; 4] {
        let camera_from_marker = *camera_from_world * world_from_marker[sighting.square];
        let corners = corners_m(self.squares[sighting.square].side_m);
        std::array::from_fn(|i| {
            let pixel = self.eyes[sighting.eye]
                .intrinsics
                .project(camera_from_marker.transform_point(corners[i]));
            pixel.map_or(f64::INFINITY, |pixel| pixel.distance(sighting.corners_px[i]))
        })
    }

    /// Finds the poses from a start, and what does not fit.
    ///
    /// # Errors
    /// When the start cannot be, nothing of a free marker fits, poses are not determined, or a solve does not converge.
    pub(super) fn settle(&self, start: Poses) -> Result<Settled, BundleError> {
        let layout = self.layout();
        let mut poses = start;
        let mut kept = self.within(&poses, |_| f64::MAX);
        let mut scale = self.spread(&poses, &kept, &layout).ok_or(SolveError::Start)?;
        for round in 0..MAX_ROUNDS {
            let is_cautious = round < CAUTIOUS_ROUNDS;
            let loss = if is_cautious { Loss::Cauchy } else { Loss::Huber };
            poses = self.minimum(&layout, &kept, (loss, scale), poses)?.state;
            scale = self.spread(&poses, &kept, &layout).ok_or(SolveError::Singular)?;
            if round + 1 < CAUTIOUS_ROUNDS {
                continue;
            }
            let limit = |sigma_px: f64| (OUTLIER_SIGMAS * scale * sigma_px).max(MIN_OUTLIER_PX);
            let next = self.within(&poses, limit);
            if next == kept && !is_cautious {
                break;
            }
            kept = next;
            self.check_every_marker_counts(&kept)?;
        }
        let minimum = self.minimum(&layout, &kept, (Loss::Squares, 1.0), poses)?;
        Ok(self.settled(minimum, &kept, layout)?)
    }

    /// Sum of squared deviations in units of a spread, none counted beyond [`OUTLIER_SIGMAS`]: twice the negative logarithm of
    /// how likely a solution is, for comparing two.
    pub(super) fn squared_deviations(&self, poses: &Poses, spread: f64) -> f64 {
        let of = |sighting: &Sighting| {
            let scale = spread * sighting.sigma_px;
            self.errors_px(poses, sighting)
                .map(|error| (error / scale).min(OUTLIER_SIGMAS).powi(2))
        };
        self.sightings.iter().flat_map(of).sum()
    }

    fn minimum(
        &self,
        layout: &Layout,
        kept: &[[bool; 4]],
        (loss, scale): (Loss, f64),
        start: Poses,
    ) -> Result<Minimum<Poses>, SolveError> {
        let problem = Problem {
            bundle: self,
            layout,
            kept,
            loss,
            scale,
        };
        match loss {
            Loss::Squares => arrow::minimise(&problem, start, MAX_ITERATIONS, &mut |_| {}),
            // On the way only; reweighted squares take long to settle their last digits.
            Loss::Huber | Loss::Cauchy => arrow::approach(&problem, start, ROUND_ITERATIONS, &mut |_| {}),
        }
    }

    fn layout(&self) -> Layout {
        let mut n_shared = 0;
        let mut place = |is_free: bool| {
            is_free.then(|| {
                n_shared += BLOCK;
                n_shared - BLOCK
            })
        };
        let eyes = self.eyes.iter().map(|eye| place(eye.is_free)).collect();
        let squares = self.squares.iter().map(|square| place(square.is_free)).collect();
        Layout {
            eyes,
            squares,
            n_shared,
        }
    }

    /// Which corners are within the limit; none of a sighting that has too few of them.
    fn within(&self, poses: &Poses, limit: impl Fn(f64) -> f64) -> Vec<[bool; 4]> {
        let of_sighting = |sighting: &Sighting| {
            let kept = self
                .errors_px(poses, sighting)
                .map(|error| error <= limit(sighting.sigma_px));
            let enough = kept.iter().filter(|kept| **kept).count() >= MIN_CORNERS;
            kept.map(|kept| kept && enough)
        };
        self.sightings.iter().map(of_sighting).collect()
    }

    /// Standard deviation of the corners that count, in units of the expected one; robust, never zero. `None` without
    /// corners.
    fn spread(&self, poses: &Poses, kept: &[[bool; 4]], layout: &Layout) -> Option<f64> {
        let mut deviations = Vec::new();
        for (sighting, kept) in self.sightings.iter().zip(kept) {
            let errors = self.errors_px(poses, sighting).into_iter().zip(kept);
            deviations.extend(
                errors
                    .filter(|(_, kept)| **kept)
                    .map(|(error, _)| error / sighting.sigma_px),
            );
        }
        deviations.sort_by(f64::total_cmp);
        let median = *deviations.get(deviations.len() / 2)?;
        let components = 2.0 * deviations.len() as f64;
        let freedom = (components - self.n_unknowns(kept, layout)).max(1.0);
        Some((median / RAYLEIGH_MEDIAN * (components / freedom).sqrt()).max(MIN_SPREAD))
    }

    fn n_unknowns(&self, kept: &[[bool; 4]], layout: &Layout) -> f64 {
        let alive = self.alive(kept).into_iter().filter(|alive| *alive).count();
        (layout.n_shared + BLOCK * alive) as f64
    }

    fn check_every_marker_counts(&self, kept: &[[bool; 4]]) -> Result<(), BundleError> {
        let mut counts = vec![false; self.squares.len()];
        for (sighting, kept) in self.sightings.iter().zip(kept) {
            counts[sighting.square] |= kept.contains(&true);
        }
        let mut lost = self
            .squares
            .iter()
            .zip(counts)
            .filter(|(square, counts)| square.is_free && !counts);
        match lost.next() {
            Some((square, _)) => Err(BundleError::Contradictory { id: square.id }),
            None => Ok(()),
        }
    }

    /// Which stations have any corner that counts.
    fn alive(&self, kept: &[[bool; 4]]) -> Vec<bool> {
        let mut alive = vec![false; self.n_stations];
        for (sighting, kept) in self.sightings.iter().zip(kept) {
            alive[sighting.station] |= kept.contains(&true);
        }
        alive
    }

    fn settled(&self, minimum: Minimum<Poses>, kept: &[[bool; 4]], layout: Layout) -> Result<Settled, SolveError> {
        let poses = minimum.state;
        let mut tallies = vec![Tally::default(); self.views.len()];
        let (mut all, mut deviations) = (Tally::default(), 0.0);
        let mut rejected = Vec::new();
        for (sighting, kept) in self.sightings.iter().zip(kept) {
            let errors = self.errors_px(&poses, sighting);
            let fitting: Vec<f64> = errors.iter().zip(kept).filter_map(|(e, k)| k.then_some(*e)).collect();
            if !fitting.is_empty() {
                tallies[sighting.view].add(&fitting);
                all.add(&fitting);
                deviations += fitting.iter().map(|e| (e / sighting.sigma_px).powi(2)).sum::<f64>();
            }
            if fitting.len() < 4 {
                let wrong = errors.iter().zip(kept).filter_map(|(e, k)| (!k).then_some(*e));
                rejected.push(RejectedDetection {
                    view: self.views[sighting.view].clone(),
                    marker: self.squares[sighting.square].id,
                    corners: 4 - fitting.len(),
                    worst_px: wrong.fold(0.0, f64::max),
                });
            }
        }
        let freedom = 2.0 * all.corners as f64 - self.n_unknowns(kept, &layout);
        if freedom < 1.0 {
            return Err(SolveError::Singular);
        }
        Ok(Settled {
            variance: deviations / freedom,
            rms_px: all.rms_px(),
            views: tallies
                .iter()
                .zip(&self.views)
                .map(|(t, name)| t.result(name))
                .collect(),
            rejected,
            poses,
            system: minimum.system,
            layout,
        })
    }
}

impl Settled {
    /// Covariance of the twists of all free eyes, then all free squares.
    fn shared_covariance(&self) -> Option<DMatrix<f64>> {
        Some(self.system.shared_covariance()? * self.variance)
    }

    /// Covariances of the twists of the free squares, `None` for those that are not free.
    pub(super) fn square_covariances(&self) -> Result<Vec<Option<Matrix6<f64>>>, SolveError> {
        let covariance = self.shared_covariance().ok_or(SolveError::Singular)?;
        let of = |place: &Option<usize>| place.map(|i| covariance.fixed_view::<BLOCK, BLOCK>(i, i).into_owned());
        Ok(self.layout.squares.iter().map(of).collect())
    }

    /// Covariance of the twist of a free eye.
    pub(super) fn eye_covariance(&self, eye: usize) -> Option<Matrix6<f64>> {
        let place = self.layout.eyes[eye]?;
        let covariance = self.shared_covariance()?;
        Some(covariance.fixed_view::<BLOCK, BLOCK>(place, place).into_owned())
    }

    /// Covariance of the twist of a station.
    pub(super) fn station_covariance(&self, station: usize) -> Option<Matrix6<f64>> {
        Some(self.system.block_covariance(station)? * self.variance)
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    markers: usize,
    corners: usize,
    squares: f64,
    worst_px: f64,
}

impl Tally {
    fn add(&mut self, errors_px: &[f64]) {
        self.markers += 1;
        self.corners += errors_px.len();
        self.squares += errors_px.iter().map(|error| error * error).sum::<f64>();
        self.worst_px = errors_px.iter().copied().fold(self.worst_px, f64::max);
    }

    fn rms_px(&self) -> f64 {
        (self.squares / self.corners as f64).sqrt()
    }

    fn result(&self, name: &str) -> ViewResult {
        ViewResult {
            name: name.to_owned(),
            markers: self.markers,
            rms_px: self.rms_px(),
            worst_px: self.worst_px,
        }
    }
}

/// A bundle as least squares.
struct Problem<'a> {
    bundle: &'a Bundle,
    layout: &'a Layout,
    kept: &'a [[bool; 4]],
    loss: Loss,
    /// Spread of the corners in units of the one expected.
    scale: f64,
}

impl Problem<'_> {
    /// Sightings with the numbers of those of their corners that count.
    fn counted(&self) -> impl Iterator<Item = (&Sighting, usize)> {
        let pairs = self.bundle.sightings.iter().zip(self.kept);
        pairs.flat_map(|(sighting, kept)| (0..4).filter(|i| kept[*i]).map(move |i| (sighting, i)))
    }

    fn look(&self, poses: &Poses, sighting: &Sighting, corner: usize) -> Option<Look> {
        let camera_from_rig = poses.camera_from_rig[sighting.eye];
        let rig_from_world = poses.rig_from_world[sighting.station];
        let world_from_marker = poses.world_from_marker[sighting.square];
        let point = corners_m(self.bundle.squares[sighting.square].side_m)[corner];
        let in_rig = rig_from_world.transform_point(world_from_marker.transform_point(point));
        let in_camera = camera_from_rig.transform_point(in_rig);
        let projection = self.bundle.eyes[sighting.eye]
            .intrinsics
            .project_with_gradient(in_camera)?;
        let rig_from_camera = camera_from_rig.rotation.transpose();
        let marker_from_rig = (rig_from_world.rotation * world_from_marker.rotation).transpose();
        let by_rig = projection.gradient.map(|gradient| rig_from_camera * gradient);
        Some(Look {
            residual: projection.pixel - sighting.corners_px[corner],
            by_eye: projection.gradient.map(|gradient| by_twist(in_camera, gradient)),
            by_station: by_rig.map(|gradient| by_twist(in_rig, gradient)),
            by_square: by_rig.map(|gradient| by_twist(point, marker_from_rig * gradient)),
        })
    }
}

/// Derivative by a twist that moves a point, of something with this gradient with respect to the point.
fn by_twist(point: DVec3, gradient: DVec3) -> Vector6<f64> {
    let turn = point.cross(gradient);
    Vector6::new(turn.x, turn.y, turn.z, gradient.x, gradient.y, gradient.z)
}

/// A twist from six numbers, rotation first.
pub(super) fn twist(step: &[f64]) -> Twist {
    Twist {
        rotation: DVec3::new(step[0], step[1], step[2]),
        translation: DVec3::new(step[3], step[4], step[5]),
    }
}

impl ArrowProblem for Problem<'_> {
    type State = Poses;

    fn linearise(&self, poses: &Poses) -> Option<ArrowSystem> {
        let mut system = ArrowSystem::new(self.layout.n_shared, self.bundle.n_stations);
        let mut by_shared = Vec::with_capacity(2 * BLOCK);
        for (sighting, corner) in self.counted() {
            let look = self.look(poses, sighting, corner)?;
            let sigma = self.scale * sighting.sigma_px;
            let (cost, weight) = self.loss.cost_and_weight(look.residual.length() / sigma);
            system.cost += cost;
            for axis in 0..2 {
                by_shared.clear();
                let eye = self.layout.eyes[sighting.eye].map(|place| (place, look.by_eye[axis]));
                let square = self.layout.squares[sighting.square].map(|place| (place, look.by_square[axis]));
                for (place, derivatives) in eye.into_iter().chain(square) {
                    by_shared.extend((0..BLOCK).map(|i| (place + i, derivatives[i])));
                }
                let weighted = Weighted {
                    residual: look.residual[axis],
                    weight: weight / (sigma * sigma),
                };
                system.add(sighting.station, &by_shared, &look.by_station[axis], weighted);
            }
        }
        // A station of which nothing counts stays where it is.
        for (block, alive) in system.blocks.iter_mut().zip(self.bundle.alive(self.kept)) {
            if !alive {
                block.normal = Matrix6::identity();
            }
        }
        system.cost.is_finite().then_some(system)
    }

    fn cost(&self, poses: &Poses) -> Option<f64> {
        let mut cost = 0.0;
        for (sighting, kept) in self.bundle.sightings.iter().zip(self.kept) {
            let errors = self.bundle.errors_px(poses, sighting);
            for (error, _) in errors.iter().zip(kept).filter(|(_, kept)| **kept) {
                cost += self.loss.cost_and_weight(error / (self.scale * sighting.sigma_px)).0;
            }
        }
        cost.is_finite().then_some(cost)
    }

    fn moved(&self, poses: &Poses, shared: &[f64], blocks: &[Vector6<f64>]) -> Option<Poses> {
        let step = |place: usize| Pose::exp(twist(&shared[place..place + BLOCK]));
        let mut poses = poses.clone();
        for (pose, place) in poses.camera_from_rig.iter_mut().zip(&self.layout.eyes) {
            if let Some(place) = place {
                *pose = (step(*place) * *pose).orthonormalized();
            }
        }
        for (pose, place) in poses.world_from_marker.iter_mut().zip(&self.layout.squares) {
            if let Some(place) = place {
                *pose = (*pose * step(*place)).orthonormalized();
            }
        }
        for (pose, block) in poses.rig_from_world.iter_mut().zip(blocks) {
            *pose = (Pose::exp(twist(block.as_slice())) * *pose).orthonormalized();
        }
        Some(poses)
    }
}
