//! Pictures that a probe camera would have taken of a known environment, at any exposure.
//!
//! Measured recordings have one exposure and one light; brackets, lamps that go out and many noises of one picture are made
//! here from the true environment map. Plain and slow, and written for this purpose alone: nothing is shared with the code
//! that it measures, so an error in one does not hide in the other. Wherever the rig format says the same, the formulas are
//! those of `configs/README.md`.
//!
//! Not simulated: motion, defocus, flare, the probe camera's own colour matrix, a rough ball.

mod camera;
mod probe_picture;
mod recording;
mod sensor;

pub use camera::{Ball, Camera, Lens, Photometry, Response, SimulatedRig};
pub use probe_picture::{RadiancePicture, Surroundings, ball_picture, fisheye_picture};
pub use recording::{ProbeShot, RecordingWriter};
pub use sensor::{Exposure, Noise};
