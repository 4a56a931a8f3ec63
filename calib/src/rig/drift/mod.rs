//! Whether a rig still holds: has a marker been moved, a fixed camera been knocked, a lens been turned?
//!
//! All pictures of a recording are explained at once: every picture of the moving camera has a pose, every fixed camera one
//! for all of its pictures. Then suspicion falls on one part of the rig after the other: one marker may be anywhere, or one
//! lens may have another focal length and another centre. The suspicion that explains most is taken if it is more than
//! chance *and* more than matters ([`MATTERS`]), and the search goes on with what is left. To suspect a marker is to leave
//! it out of all poses and then to ask the pictures where it is, so its place comes in millimetres and degrees with their
//! standard deviations; a marker that moves the poses does not hide itself. Where a fixed camera stands is asked at the end,
//! of all markers but the ones that have moved.
//!
//! Whether the mirror ball is in its place its outline tells ([`BallCheck`]).
//!
//! What this cannot tell: which of two markers has moved when there are no others; how exposure and colour have changed,
//! since the light may have.

mod ball;
mod problem;
mod solve;
mod verdict;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::{Marker, Rig, Role};
use crate::{camera::Intrinsics, pose::Pose, resection, tag::Detection};
pub use ball::{BallCheck, BallPlace};
pub use problem::Suspect;
use problem::{Block, Observation, Problem};
pub use verdict::{CameraFit, Displacement, Drift, Finding, LensChange, MarkerFit};

/// From what on a change matters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matters {
    /// Way of a marker or a fixed camera in metres.
    pub distance_m: f64,
    /// The same relative to its distance from the camera, or from the markers: far away, less is seen.
    pub distance_relative: f64,
    /// Turn of a marker in radians.
    pub marker_angle_rad: f64,
    /// Turn of a fixed camera in radians.
    pub camera_angle_rad: f64,
    /// Change of a focal length, and way of the principal point, relative to the focal length.
    pub lens_relative: f64,
    /// Residuals in units of what corners of their size should have.
    pub residual: f64,
    /// Standard deviations that a change must exceed these limits by.
    pub sigmas: f64,
}

/// What is told: half a millimetre of a marker (a sheet that has slipped; printing and measuring are good to a tenth), a
/// tenth of a degree of a camera (a pixel at a focal length of 600), three thousandths of a focal length (refocusing does
/// more; the issue's own figure for a lens is a hundredth of a pixel, ten times less than this makes over the field). Four
/// standard deviations come by chance once in 16 000, and a rig has fewer parts.
///
/// Corners of good pictures have half of their expected residual (`tests/data`, noisier ones as much); three are more than wear.
pub const MATTERS: Matters = Matters {
    distance_m: 0.5e-3,
    distance_relative: 1e-3,
    marker_angle_rad: 0.5 * std::f64::consts::PI / 180.0,
    camera_angle_rad: 0.1 * std::f64::consts::PI / 180.0,
    lens_relative: 3e-3,
    residual: 3.0,
    sigmas: 4.0,
};

/// Pictures of the moving camera that are looked at, evenly spread over the recording; more only take time.
const MAX_PICTURES: usize = 120;

/// Pictures of a fixed camera; they all show the same.
const MAX_FIXED_PICTURES: usize = 20;

/// What a suspicion must explain: the cost, which counts half squares, sinks by chance by half the number of unknowns, and by
/// ten more less than once in 20 000.
const CHANCE: f64 = 12.0;

/// A suspicion that explains at least this much of what the best one does cannot be told from it.
const AS_GOOD: f64 = 0.9;

/// Why nothing can be said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DriftError {
    /// There is nothing to compare.
    #[error(
        "none of `{pictures}` pictures shows two markers of the rig or more, so that one could be held against another"
    )]
    TooLittle {
        /// Pictures looked at.
        pictures: usize,
    },
    /// The numbers lead nowhere.
    #[error("the poses of the recording cannot be found together: the solve does not converge")]
    NotConverged,
}

impl DriftError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::TooLittle { .. } => "record the rig with several of its markers in view at a time",
            Self::NotConverged => "calibrate the rig anew: `mirrorball-calib intrinsics`, then `markers`",
        }
    }
}

/// Collects what the pictures of a recording show.
pub struct DriftCheck<'a> {
    rig: &'a Rig,
    pictures: Vec<Seen>,
    lost: usize,
    seen: usize,
}

/// Markers in a picture.
struct Seen {
    camera: usize,
    block: Block,
    detections: Vec<Detection>,
}

impl<'a> DriftCheck<'a> {
    /// Without any picture yet.
    #[must_use]
    pub fn new(rig: &'a Rig) -> Self {
        Self {
            rig,
            pictures: Vec::new(),
            lost: 0,
            seen: 0,
        }
    }

    /// Takes in the markers found in a picture of this camera; one that the rig does not have is ignored.
    pub fn add(&mut self, camera: &str, detections: &[Detection]) {
        let Some(index) = self.rig.cameras.iter().position(|known| known.name == camera) else {
            return;
        };
        let camera = &self.rig.cameras[index];
        let known: Vec<Detection> = detections
            .iter()
            .filter(|seen| {
                self.rig
                    .marker(seen.id)
                    .is_some_and(|marker| marker.family == seen.family)
            })
            .copied()
            .collect();
        let located = resection::locate(&known, self.rig, &camera.intrinsics);
        self.seen += usize::from(camera.role == Role::Scene);
        self.lost += usize::from(camera.camera_from_world.is_none() && located.is_err());
        // Where a rig is very wrong, all of its markers together say nothing, but each of them does.
        let found = located.map(|located| located.camera_from_world);
        let found = found
            .ok()
            .or_else(|| self.pose_by_one_marker(&known, &camera.intrinsics));
        // A camera that has been knocked sees the markers from elsewhere.
        let Some(camera_from_world) = found.or(camera.camera_from_world) else {
            return;
        };
        let fixed_camera = camera.camera_from_world.map(|_| index);
        if known.is_empty() || (fixed_camera.is_none() && known.len() < 2) {
            return;
        }
        self.pictures.push(Seen {
            camera: index,
            block: Block {
                camera_from_world,
                fixed_camera,
            },
            detections: known,
        });
    }

    /// Where one marker alone puts the camera: of all of these, the one that puts the others nearest to where they were seen.
    fn pose_by_one_marker(&self, known: &[Detection], intrinsics: &Intrinsics) -> Option<Pose> {
        // Sums of distances, so that what is far off counts little more than what is off.
        let error = |pose: &Pose| -> f64 {
            let corners = known.iter().flat_map(|seen| {
                let places = self.rig.marker(seen.id).map(Marker::corners_world);
                places.into_iter().flatten().zip(seen.corners_px)
            });
            let distance = |(place, pixel): (DVec3, DVec2)| {
                let projected = intrinsics.project(pose.transform_point(place));
                projected.map_or(f64::from(intrinsics.size_px[0]), |projected| projected.distance(pixel))
            };
            corners.map(distance).sum()
        };
        let alone = |seen| resection::locate(std::slice::from_ref(seen), self.rig, intrinsics).ok();
        let poses = known.iter().filter_map(alone).map(|located| located.camera_from_world);
        poses.min_by(|a, b| error(a).total_cmp(&error(b)))
    }

    /// What the pictures say; `report` hears of every suspicion that has been looked into.
    ///
    /// # Errors
    /// When they say nothing.
    pub fn verdict(&self, report: &(dyn Fn(&Suspect) + Sync)) -> Result<Drift, DriftError> {
        let problem = self.problem();
        if problem.blocks.is_empty() {
            return Err(DriftError::TooLittle { pictures: self.seen });
        }
        let nothing = solve::explain(&problem, &[], 1.0).ok_or(DriftError::NotConverged)?;
        // Judged by their own spread, residuals of a rig that has drifted do not drown in their own cost.
        let scale = nothing.spread.max(1.0);
        let mut accepted: Vec<Suspect> = Vec::new();
        let mut best = solve::explain(&problem, &[], scale).ok_or(DriftError::NotConverged)?;
        let first = best.clone();
        let mut alone = Vec::new();
        let mut findings = Vec::new();
        loop {
            let suspects = problem.suspects(self.rig, &accepted);
            let trials: Vec<_> = suspects
                .par_iter()
                .filter_map(|suspect| {
                    let all: Vec<Suspect> = accepted.iter().chain([suspect]).copied().collect();
                    let trial = solve::explain_from(&problem, &all, scale, &best)?;
                    report(suspect);
                    let gain = best.cost - trial.cost - 0.5 * suspect.unknowns() as f64;
                    Some((*suspect, gain, trial))
                })
                .collect();
            if accepted.is_empty() {
                alone = verdict::markers(&problem, self.rig, &first, &trials);
            }
            let found = verdict::judge(&problem, self.rig, &trials, &MATTERS);
            let Some((finding, suspect, trial)) = found else { break };
            accepted.push(suspect);
            best = trial;
            findings.push(finding);
        }
        findings.extend(verdict::fixed_cameras(&problem, self.rig, &best, &MATTERS));
        if best.spread > MATTERS.residual {
            findings.push(Finding::Unexplained { ratio: best.spread });
        }
        Ok(Drift {
            pictures: self.seen,
            lost: self.lost,
            cameras: verdict::cameras(&problem, self.rig, &first),
            markers: alone,
            findings,
        })
    }

    /// Everything seen as one problem.
    fn problem(&self) -> Problem<'a> {
        let mut problem = Problem::new(self.rig);
        for (index, camera) in self.rig.cameras.iter().enumerate() {
            let pictures: Vec<&Seen> = self.pictures.iter().filter(|seen| seen.camera == index).collect();
            let limit = if camera.role == Role::Scene {
                MAX_PICTURES
            } else {
                MAX_FIXED_PICTURES
            };
            let chosen = limit.min(pictures.len());
            let chosen = (0..chosen).map(|i| pictures[i * pictures.len() / chosen]);
            let mut fixed = None;
            for seen in chosen {
                let block = match (seen.block.fixed_camera, fixed) {
                    (Some(_), Some(block)) => block,
                    _ => problem.push_block(seen.block),
                };
                if seen.block.fixed_camera.is_some() {
                    fixed = Some(block);
                }
                problem.observe(block, index, &seen.detections);
            }
        }
        problem
    }
}

/// A corner of a marker as it was seen, for the parts of this module.
fn observations(detection: &Detection) -> impl Iterator<Item = (usize, Observation)> {
    let sigma_px = resection::corner_sigma_px(detection);
    detection
        .corners_px
        .into_iter()
        .enumerate()
        .map(move |(corner, pixel)| {
            let seen = Observation {
                block: 0,
                camera: 0,
                marker: 0,
                corner,
                pixel,
                sigma_px,
            };
            (corner, seen)
        })
}

#[cfg(test)]
mod tests;
