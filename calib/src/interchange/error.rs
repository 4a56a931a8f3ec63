//! What can be wrong with another program's file, or with writing one.

use super::Format;
use crate::{pose::PoseError, rig::Place};

/// Why a file cannot be read or written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InterchangeError {
    /// The text is no YAML, or a key is missing or of the wrong type.
    #[error("{place}: {message}")]
    Syntax {
        /// Where.
        place: Place,
        /// What the YAML reader says.
        message: String,
    },
    /// A value is not allowed.
    #[error("{place}: `{key}` is `{found}` (allowed: {allowed})")]
    Value {
        /// Where.
        place: Place,
        /// Key.
        key: &'static str,
        /// The value.
        found: String,
        /// What may stand there.
        allowed: String,
    },
    /// A camera model that this program does not have.
    #[error("{place}: the camera model `{found}` is not supported (allowed: {allowed})")]
    Model {
        /// Where.
        place: Place,
        /// The model, in the file's words.
        found: String,
        /// Those that are, in the file's words.
        allowed: &'static str,
    },
    /// A matrix is not a pose.
    #[error("{place}: `{key}` is not a pose")]
    Pose {
        /// Where.
        place: Place,
        /// Key.
        key: &'static str,
        /// What is wrong with the matrix.
        source: PoseError,
    },
    /// The format has no words for something.
    #[error("camera `{camera}`: a file of {format} cannot hold {problem} (allowed: {allowed})")]
    NotExpressible {
        /// The camera.
        camera: String,
        /// The format.
        format: Format,
        /// What it cannot hold.
        problem: String,
        /// What it can.
        allowed: String,
    },
    /// The number of cameras does not fit the format.
    #[error("a file of {format} holds {allowed} (there are: {present})")]
    Count {
        /// The format.
        format: Format,
        /// How many it holds.
        allowed: &'static str,
        /// Names of the cameras.
        present: String,
    },
}

impl InterchangeError {
    /// What to do about it, if there is something to say beyond the message.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Syntax { .. } => Some(concat!(
                "an OpenCV or ROS file needs `image_width`, `image_height`, `camera_matrix` and `distortion_coefficients`; ",
                "a Kalibr file `camera_model`, `intrinsics`, `distortion_model`, `distortion_coeffs` and `resolution` per camera"
            )),
            Self::Model { .. } => Some("calibrate anew with one of these models"),
            Self::NotExpressible { .. } => Some("calibrate anew with a model that the other program has"),
            Self::Count { .. } => Some("choose one with `--camera`"),
            Self::Pose { .. } => Some("a pose is four rows `[r00, r01, r02, t]`, the last one 0 0 0 1; metres"),
            Self::Value { .. } => None,
        }
    }
}
