//! First poses, from the two poses that every square may have (IPPE), by vote.

use super::bundle::{Bundle, Sighting};
use crate::{pose::Pose, resection};

/// Error, in pixels, at which a corner or a frame counts half.
const SCALE_PX: f64 = 4.0;

/// Error, in pixels, of a corner that could not be seen at all.
const UNSEEN_PX: f64 = 1e6;

/// Frames at most that vote on a pose, spread evenly over those there are.
const MAX_VOTERS: usize = 24;

/// Poses of a station at most that are taken into account.
const MAX_STATION_POSES: usize = 4;

/// The poses camera_from_marker that a sighting may have; none when it is no picture of a square.
fn proposals(bundle: &Bundle, sighting: &Sighting) -> Vec<Pose> {
    let intrinsics = &bundle.eyes[sighting.eye].intrinsics;
    let rays = sighting.corners_px.map(|pixel| intrinsics.unproject(pixel));
    let [Some(a), Some(b), Some(c), Some(d)] = rays else {
        return Vec::new();
    };
    resection::square_poses(&[a, b, c, d], bundle.squares[sighting.square].side_m)
}

/// Where the carrier may be whose cameras saw all of this, best first, at most [`MAX_STATION_POSES`].
pub(super) fn rig_poses(
    bundle: &Bundle,
    camera_from_rig: &[Pose],
    world_from_marker: &[Pose],
    sightings: &[&Sighting],
) -> Vec<Pose> {
    // Cauchy's error over all corners: a wrong marker costs its own evidence only.
    let cost = |rig_from_world: &Pose| -> f64 {
        let errors = sightings.iter().flat_map(|sighting| {
            let camera_from_world = camera_from_rig[sighting.eye] * *rig_from_world;
            bundle.errors_from_px(&camera_from_world, world_from_marker, sighting)
        });
        errors
            .map(|error| (error.min(UNSEEN_PX) / SCALE_PX).powi(2).ln_1p())
            .sum()
    };
    let mut poses: Vec<(f64, Pose)> = voters(sightings.len())
        .flat_map(|i| {
            let marker_from_world = world_from_marker[sightings[i].square].inverse();
            let rig_from_camera = camera_from_rig[sightings[i].eye].inverse();
            let poses = proposals(bundle, sightings[i]);
            poses
                .into_iter()
                .map(move |camera_from_marker| rig_from_camera * camera_from_marker * marker_from_world)
        })
        .map(|pose| (cost(&pose), pose))
        .collect();
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    poses
        .into_iter()
        .take(MAX_STATION_POSES)
        .map(|(_, pose)| pose)
        .collect()
}

/// The pose first_from_second of two markers that most pictures agree on, and how many that are. `pairs` are sightings
/// of the first and of the second by the same camera at the same time.
///
/// The planar ambiguity of a small marker differs from view to view; the true pose is the one that stays.
pub(super) fn relative_marker(bundle: &Bundle, pairs: &[(&Sighting, &Sighting)]) -> Option<(Pose, f64)> {
    let poses: Vec<_> = voters(pairs.len())
        .map(|i| (pairs[i], proposals(bundle, pairs[i].0), proposals(bundle, pairs[i].1)))
        .collect();
    let candidates = poses.iter().flat_map(|(_, first, second)| {
        let from = |camera_from_first: &Pose| camera_from_first.inverse();
        first.iter().flat_map(move |a| second.iter().map(move |b| from(a) * *b))
    });
    elect(candidates, |first_from_second| {
        let error = |((_, seen), first, _): &((&Sighting, &Sighting), Vec<Pose>, Vec<Pose>)| {
            let errors = first.iter().map(|camera_from_first| {
                let mut poses = vec![Pose::identity(); bundle.squares.len()];
                poses[seen.square] = *first_from_second;
                mean(bundle.errors_from_px(camera_from_first, &poses, seen))
            });
            errors.fold(UNSEEN_PX, f64::min)
        };
        poses.iter().map(|voter| support(error(voter))).sum()
    })
}

/// The pose second_from_first of two cameras that most stations agree on, and how many that are. `pairs` are what the
/// first and the second camera saw at one station.
pub(super) fn relative_camera(
    bundle: &Bundle,
    world_from_marker: &[Pose],
    pairs: &[(Vec<&Sighting>, Vec<&Sighting>)],
) -> Option<(Pose, f64)> {
    let poses: Vec<_> = voters(pairs.len())
        .map(|i| {
            // Each camera by itself.
            let of = |sightings: &[&Sighting]| rig_poses(bundle, &[Pose::identity(); 2], world_from_marker, sightings);
            (&pairs[i].1, of(&pairs[i].0), of(&pairs[i].1))
        })
        .collect();
    let candidates = poses.iter().flat_map(|(_, first, second)| {
        first
            .iter()
            .flat_map(move |a| second.iter().map(move |b| *b * a.inverse()))
    });
    elect(candidates, |second_from_first| {
        let error = |(seen, first, _): &(&Vec<&Sighting>, Vec<Pose>, Vec<Pose>)| {
            let errors = first.iter().map(|first_from_world| {
                let camera_from_world = *second_from_first * *first_from_world;
                let sum: f64 = seen
                    .iter()
                    .map(|sighting| mean(bundle.errors_from_px(&camera_from_world, world_from_marker, sighting)))
                    .sum();
                sum / seen.len() as f64
            });
            errors.fold(UNSEEN_PX, f64::min)
        };
        poses.iter().map(|voter| support(error(voter))).sum()
    })
}

/// The candidate with most votes.
fn elect(candidates: impl Iterator<Item = Pose>, votes: impl Fn(&Pose) -> f64) -> Option<(Pose, f64)> {
    let counted = candidates.map(|candidate| (candidate, votes(&candidate)));
    counted.max_by(|a, b| a.1.total_cmp(&b.1))
}

/// How much a frame with this error supports a candidate, 0 to 1.
fn support(error_px: f64) -> f64 {
    1.0 / (1.0 + (error_px / SCALE_PX).powi(2))
}

fn mean(errors_px: [f64; 4]) -> f64 {
    0.25 * errors_px.iter().map(|error| error.min(UNSEEN_PX)).sum::<f64>()
}

/// Numbers of those that vote.
fn voters(n: usize) -> impl Iterator<Item = usize> {
    let step = n.div_ceil(MAX_VOTERS).max(1);
    (0..n).step_by(step)
}
