//! CPU twins of the passes: plain, slow, obviously right.
//!
//! Each file has the stem of its pass and of its shader; `tests/passes.rs` compares the three.
//! Passes that only draw or average (`camera_depth`, `downsample`, `present`) have none.

pub mod composite;
pub mod irradiance;
pub mod prefilter_specular;
pub mod radiance_map;
pub mod receive;
pub mod shadow_map;
