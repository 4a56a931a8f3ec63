//! CPU twins of the passes: plain, slow, obviously right.
//!
//! Each file has the stem of its pass and of its shader; the tests in `tests/` compare the three: `passes.rs` and those of
//! one topic each.
//! Passes that only draw (`camera_depth`, `inset`, `present`) have none.

pub mod composite;
pub mod cylindrical;
pub mod display;
pub mod dome_maps;
pub mod downsample;
pub mod harmonics;
pub mod highlight;
pub mod irradiance;
pub mod irradiance_cube;
pub mod lamp_light;
pub mod lamp_receive;
pub mod lobe_sum;
pub mod look_blur;
pub mod material;
pub mod noise;
pub mod prefilter_phong;
pub mod prefilter_specular;
pub mod protect;
pub mod real_radiance;
pub mod receive;
pub mod reproject;
pub mod separable_blur;
pub mod shadow_rays;
pub mod shadow_wedges;
pub mod sphere_map;
pub mod substance_light;

/// Probe picture to radiance cube: `calib` needs it as well, for single pictures.
pub use mirrorball_calib::probe::radiance_map;
