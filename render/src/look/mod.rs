//! The camera's look: what its lens, its shutter and its sensor do to light, measured, so that virtual pixels get the same.
//!
//! - [`sharpness`]: how blurred the picture is, off the edges of the markers in it;
//! - [`kernel`]: a blur of that covariance, in three lines of taps.
//!
//! Noise needs no measurement per frame: the rig has it ([`GpuNoise`](crate::gpu::types::GpuNoise)).

mod edge;
pub mod kernel;
pub mod sharpness;
