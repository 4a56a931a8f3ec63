//! The corners of all pictures, and what may differ from the rig file.

use glam::{DMat3, DVec2, DVec3};

use super::{super::Rig, observations};
use crate::{camera::Intrinsics, pose::Pose, tag::Detection};

/// A part of the rig that may have changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Suspect {
    /// The marker with this index in [`Rig::markers`] is elsewhere.
    Marker(usize),
    /// The lens of the camera with this index in [`Rig::cameras`] has another focal length and another principal point.
    Lens(usize),
}

/// A pose that is to be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    /// Where to start.
    pub(super) camera_from_world: Pose,
    /// Index of the fixed camera that it belongs to; every other one belongs to one picture of the moving camera.
    pub(super) fixed_camera: Option<usize>,
}

/// A corner of a marker, seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observation {
    pub(super) block: usize,
    pub(super) camera: usize,
    pub(super) marker: usize,
    pub(super) corner: usize,
    pub(super) pixel: DVec2,
    /// Standard deviation expected of it in either direction.
    pub(super) sigma_px: f64,
}

/// All of it.
pub(super) struct Problem<'a> {
    pub(super) rig: &'a Rig,
    pub(super) blocks: Vec<Block>,
    pub(super) observations: Vec<Observation>,
}

/// What may differ, as it is assumed now.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    pub(super) poses: Vec<Pose>,
    /// Of every marker of the rig.
    pub(super) world_from_marker: Vec<Pose>,
    /// Of every camera of the rig.
    pub(super) intrinsics: Vec<Intrinsics>,
}

/// A corner's residual and its derivatives.
pub(super) struct Linear {
    pub(super) residual: DVec2,
    /// By the twist of the camera's pose, rotation first, for x and y.
    pub(super) by_pose: [[f64; 6]; 2],
    /// By the twist of the marker in its own frame.
    pub(super) by_marker: [[f64; 6]; 2],
    /// By the logarithm of the focal lengths and by the principal point.
    pub(super) by_lens: [[f64; 3]; 2],
}

impl Suspect {
    /// Numbers that it adds.
    pub(super) fn unknowns(self) -> usize {
        match self {
            Self::Marker(_) => 6,
            Self::Lens(_) => 3,
        }
    }
}

impl<'a> Problem<'a> {
    pub(super) fn new(rig: &'a Rig) -> Self {
        Self {
            rig,
            blocks: Vec::new(),
            observations: Vec::new(),
        }
    }

    /// Adds a pose; gives its index.
    pub(super) fn push_block(&mut self, block: Block) -> usize {
        self.blocks.push(block);
        self.blocks.len() - 1
    }

    /// Adds the corners of markers seen from there. Those that the lens could not show from the start of the pose are left
    /// out.
    pub(super) fn observe(&mut self, block: usize, camera: usize, detections: &[Detection]) {
        let pose = self.blocks[block].camera_from_world;
        for detection in detections {
            let Some(marker) = self.rig.markers.iter().position(|marker| marker.id == detection.id) else {
                continue;
            };
            let corners = self.rig.markers[marker].corners_world();
            for (corner, seen) in observations(detection) {
                let point = pose.transform_point(corners[corner]);
                let is_shown = self.rig.cameras[camera].intrinsics.project(point).is_some();
                if is_shown && seen.pixel.is_finite() {
                    self.observations.push(Observation {
                        block,
                        camera,
                        marker,
                        ..seen
                    });
                }
            }
        }
    }

    /// The rig as its file has it, with the poses that were found picture by picture.
    pub(super) fn start(&self) -> State {
        State {
            poses: self.blocks.iter().map(|block| block.camera_from_world).collect(),
            world_from_marker: self.rig.markers.iter().map(|marker| marker.world_from_marker).collect(),
            intrinsics: self.rig.cameras.iter().map(|camera| camera.intrinsics).collect(),
        }
    }

    /// What may have changed beyond what is known to have. One marker must stay for the others to be held against, and a
    /// marker tells nothing where it is the only one in its pictures.
    pub(super) fn suspects(&self, rig: &Rig, accepted: &[Suspect]) -> Vec<Suspect> {
        let seen: Vec<usize> = (0..rig.markers.len())
            .filter(|marker| self.is_comparable(*marker))
            .collect();
        let moved = accepted.iter().filter(|suspect| matches!(suspect, Suspect::Marker(_)));
        let markers = if moved.count() + 1 < seen.len() {
            seen
        } else {
            Vec::new()
        };
        let lenses =
            (0..rig.cameras.len()).filter(|camera| self.observations.iter().any(|seen| seen.camera == *camera));
        let all = markers
            .into_iter()
            .map(Suspect::Marker)
            .chain(lenses.map(Suspect::Lens));
        all.filter(|suspect| !accepted.contains(suspect)).collect()
    }

    /// Whether a marker shares a pose with another one.
    fn is_comparable(&self, marker: usize) -> bool {
        let mut blocks = self
            .observations
            .iter()
            .filter(|seen| seen.marker == marker)
            .map(|seen| seen.block);
        blocks.any(|block| {
            self.observations
                .iter()
                .any(|other| other.block == block && other.marker != marker)
        })
    }

    /// The corner in its marker's frame.
    fn corner(&self, seen: &Observation) -> DVec3 {
        let half = 0.5 * self.rig.markers[seen.marker].side_m;
        let (x, y) = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][seen.corner];
        DVec3::new(half * x, half * y, 0.0)
    }

    /// Where the corner should be minus where it was seen; `None` when it cannot be seen.
    pub(super) fn residual(&self, state: &State, seen: &Observation) -> Option<DVec2> {
        let world = state.world_from_marker[seen.marker].transform_point(self.corner(seen));
        let pixel = state.intrinsics[seen.camera].project(state.poses[seen.block].transform_point(world))?;
        Some(pixel - seen.pixel)
    }

    /// The same with its derivatives.
    pub(super) fn linear(&self, state: &State, seen: &Observation) -> Option<Linear> {
        let corner = self.corner(seen);
        let camera_from_marker = state.poses[seen.block] * state.world_from_marker[seen.marker];
        let point = camera_from_marker.transform_point(corner);
        let intrinsics = &state.intrinsics[seen.camera];
        let projected = intrinsics.project_with_jacobians(point)?;
        let rotation: DMat3 = camera_from_marker.rotation;
        let row = |turn: DVec3, way: DVec3| [turn.x, turn.y, turn.z, way.x, way.y, way.z];
        let mut linear = Linear {
            residual: projected.pixel - seen.pixel,
            by_pose: [[0.0; 6]; 2],
            by_marker: [[0.0; 6]; 2],
            by_lens: [[0.0; 3]; 2],
        };
        for axis in 0..2 {
            let gradient = projected.by_point[axis];
            // exp(ξ) moves a point p by φ × p + ρ.
            linear.by_pose[axis] = row(point.cross(gradient), gradient);
            let own = rotation.transpose() * gradient;
            linear.by_marker[axis] = row(corner.cross(own), own);
            let by = &projected.by_parameters[axis];
            let scale = by[0] * intrinsics.focal_px.x + by[1] * intrinsics.focal_px.y;
            linear.by_lens[axis] = [scale, by[2], by[3]];
        }
        Some(linear)
    }
}
