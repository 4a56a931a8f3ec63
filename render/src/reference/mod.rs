//! CPU twins of the passes: plain, slow, obviously right.
//!
//! Each file has the stem of its pass and of its shader; `tests/passes.rs`, `tests/light_maps.rs`,
//! `tests/comparison_maps.rs` and `tests/look.rs` compare the three.
//! Passes that only draw (`camera_depth`, `present`) have none.

pub mod composite;
pub mod cylindrical;
pub mod dome_maps;
pub mod downsample;
pub mod harmonics;
pub mod highlight;
pub mod irradiance;
pub mod irradiance_cube;
pub mod lobe_sum;
pub mod look_blur;
pub mod noise;
pub mod prefilter_phong;
pub mod prefilter_specular;
pub mod real_radiance;
pub mod receive;
pub mod separable_blur;
pub mod shadow_rays;
pub mod shadow_wedges;
pub mod sphere_map;

/// Probe picture to radiance cube: `calib` needs it as well, for single pictures.
pub use mirrorball_calib::probe::radiance_map;
