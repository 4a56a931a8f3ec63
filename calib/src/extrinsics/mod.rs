//! Where things are to each other: markers, cameras, a headset's tracker, an eye and its display.
//!
//! [`markers`] and [`cameras`] are bundle adjustments of one kind: cameras on a carrier, markers, and one pose of the
//! carrier for every *station*, a moment at which it stood somewhere. A camera that moves has a station per picture; a
//! camera that stands still has one for all of its pictures; two cameras that are screwed together share theirs.
//! [`hand_eye`] compares poses that two systems measured, [`display`] finds an eye from what it saw aligned.
//!
//! Every result comes with its covariance, for errors as large as the residuals say they are.

mod bundle;
pub mod cameras;
pub mod display;
pub mod hand_eye;
pub mod markers;
#[cfg(test)]
mod simulation;
mod start;

use nalgebra::{Matrix3, Matrix6};

use crate::tag::Detection;

pub use bundle::{BundleError, RejectedDetection, ViewResult};

/// A picture, and the markers seen in it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Name of the picture.
    pub name: String,
    /// What was seen; of a marker that is seen twice the one that fits is used.
    pub detections: Vec<Detection>,
}

/// How sure a pose is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSigma {
    /// Standard deviation of the rotation about its worst axis, in radians.
    pub rotation_rad: f64,
    /// Standard deviation of the place along its worst direction, in metres.
    pub place_m: f64,
}

impl PoseSigma {
    /// From the covariance of a twist, rotation first.
    ///
    /// A twist that is applied in the frame whose origin is in question moves that origin by its translation, turned at
    /// most: its worst direction is as long.
    #[must_use]
    pub fn of(covariance: &Matrix6<f64>) -> Self {
        let worst = |start: usize| {
            let block: Matrix3<f64> = covariance.fixed_view::<3, 3>(start, start).into_owned();
            block.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        Self {
            rotation_rad: worst(0),
            place_m: worst(3),
        }
    }
}
