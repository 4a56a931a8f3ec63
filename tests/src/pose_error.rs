//! Error of the tracked camera poses against the true ones.

use crate::{outputs::Outputs, statistics::Spread, truth::Truth};
use glam::{DMat3, DMat4, DVec3};
use serde::Serialize;

/// Pose error over the frames of a run.
#[derive(Clone, Debug, Serialize)]
pub struct PoseError {
    /// Distance between tracked and true camera centre, in millimetres; `None` when no frame was tracked.
    pub centre_mm: Option<Spread>,
    /// Angle of the rotation between tracked and true orientation, in degrees; `None` when no frame was tracked.
    pub rotation_deg: Option<Spread>,
    /// Root mean square reprojection error as the run reports it, in pixels.
    pub reported_reprojection_px: Option<Spread>,
    /// Every compared frame.
    pub frames: Vec<FramePoseError>,
    /// Frames with a true pose and no tracked one.
    pub lost: Vec<LostFrame>,
    /// Frames of the run that the truth does not speak of; they are not compared.
    pub without_truth: Vec<u32>,
}

/// Pose error of one frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FramePoseError {
    /// Sequence number of the scene frame.
    pub frame: u32,
    /// Distance between tracked and true camera centre, in millimetres.
    pub centre_mm: f64,
    /// Angle of the rotation between tracked and true orientation, in degrees.
    pub rotation_deg: f64,
}

/// A frame that was not tracked.
#[derive(Clone, Debug, Serialize)]
pub struct LostFrame {
    /// Sequence number of the scene frame.
    pub frame: u32,
    /// Why, in the words of the run.
    pub reason: String,
}

impl PoseError {
    /// Compares every frame that has a true pose.
    pub fn measure(outputs: &Outputs, truth: &Truth) -> Self {
        let mut frames = Vec::new();
        let mut lost = Vec::new();
        for true_frame in &truth.scene_frames {
            let frame = true_frame.index;
            let output = outputs.frame(frame);
            match output.and_then(|output| output.camera_from_world) {
                Some(pose) => frames.push(compare(frame, pose, true_frame.camera_from_marker)),
                None => lost.push(LostFrame {
                    frame,
                    reason: match output {
                        Some(output) => output.reason.clone().unwrap_or_else(|| "no reason given".to_owned()),
                        None => "missing from frames.jsonl".to_owned(),
                    },
                }),
            }
        }
        let of_run = outputs.frames.iter();
        Self {
            centre_mm: Spread::of(frames.iter().map(|error: &FramePoseError| error.centre_mm).collect()),
            rotation_deg: Spread::of(frames.iter().map(|error| error.rotation_deg).collect()),
            reported_reprojection_px: Spread::of(of_run.clone().filter_map(|f| f.reprojection_error_px).collect()),
            frames,
            lost,
            without_truth: of_run
                .map(|f| f.frame)
                .filter(|&frame| truth.scene_frame(frame).is_none())
                .collect(),
        }
    }
}

/// Measures one pose against the true one.
fn compare(frame: u32, camera_from_world: DMat4, true_camera_from_world: DMat4) -> FramePoseError {
    FramePoseError {
        frame,
        centre_mm: 1e3 * camera_centre(camera_from_world).distance(camera_centre(true_camera_from_world)),
        rotation_deg: rotation_angle(rotation(camera_from_world), rotation(true_camera_from_world)).to_degrees(),
    }
}

/// Returns the rotation of a rigid motion.
fn rotation(pose: DMat4) -> DMat3 {
    DMat3::from_mat4(pose)
}

/// Returns where the camera stands in the world: -Rᵀ t.
fn camera_centre(camera_from_world: DMat4) -> DVec3 {
    -(rotation(camera_from_world).transpose() * camera_from_world.w_axis.truncate())
}

/// Returns the angle of the rotation between two orientations, in radians, accurate also where it is tiny.
///
/// For rotations ‖A - B‖ = 2√2 sin(θ/2) in the Frobenius norm, from ‖A - B‖² = 6 - 2 tr(AᵀB) and tr = 1 + 2 cos θ;
/// the usual arc cosine of the trace would lose everything below 1e-8.
fn rotation_angle(a: DMat3, b: DMat3) -> f64 {
    let difference = a - b;
    let norm = difference
        .to_cols_array()
        .iter()
        .map(|entry| entry * entry)
        .sum::<f64>()
        .sqrt();
    2.0 * (norm / 8_f64.sqrt()).min(1.0).asin()
}

/// Returns how far the upper left 3×3 block is from a rotation: largest entry of RᵀR - 1 or |det R - 1|.
pub fn rigid_deviation(pose: DMat4) -> f64 {
    let r = rotation(pose);
    let gram = r.transpose() * r - DMat3::IDENTITY;
    gram.to_cols_array()
        .iter()
        .fold((r.determinant() - 1.0).abs(), |worst, entry| worst.max(entry.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn pose(axis: DVec3, angle_rad: f64, centre: DVec3) -> DMat4 {
        let rotation = DQuat::from_axis_angle(axis.normalize(), angle_rad);
        DMat4::from_rotation_translation(rotation, -(rotation * centre))
    }

    #[test]
    fn a_known_rotation_and_shift_are_found() {
        let axis = DVec3::new(0.3, -1.0, 0.6);
        let truth = pose(axis, 0.7, DVec3::new(0.1, -0.5, 0.6));
        for angle_deg in [1e-7, 0.05, 2.0, 90.0, 179.0] {
            let angle_rad = f64::to_radians(angle_deg);
            let found = compare(0, pose(axis, 0.7 + angle_rad, DVec3::new(0.1, -0.497, 0.604)), truth);
            assert!((found.rotation_deg - angle_deg).abs() < 1e-9, "{found:?}");
            assert!((found.centre_mm - 5.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_scaled_or_mirrored_matrix_is_not_rigid() {
        assert!(rigid_deviation(pose(DVec3::X, 1.0, DVec3::ONE)) < 1e-12);
        assert!(rigid_deviation(DMat4::from_scale(DVec3::splat(1.01))) > 0.02);
        assert!(rigid_deviation(DMat4::from_scale(DVec3::new(1.0, 1.0, -1.0))) > 1.9);
    }
}
