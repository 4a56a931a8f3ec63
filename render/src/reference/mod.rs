//! CPU twins of the passes: plain, slow, obviously right.
//!
//! Each file has the stem of its pass and of its shader; `tests/passes.rs` compares the three.
//! Passes that only draw or average (`camera_depth`, `downsample`, `present`) have none.

pub mod composite;
pub mod irradiance;
pub mod prefilter_specular;
pub mod receive;
pub mod shadow_map;

/// Probe picture to radiance cube: `calib` needs it as well, for single pictures.
pub use mirrorball_calib::probe::radiance_map;
