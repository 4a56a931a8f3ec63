//! The passes of a frame; each owns its pipeline and records itself.

pub mod camera_depth;
pub mod composite;
pub mod cylindrical;
pub mod direct;
pub mod downsample;
pub mod harmonics;
pub mod highlight;
pub mod irradiance;
pub mod irradiance_cube;
pub mod lens_surface;
pub(crate) mod lobe_sum;
pub mod local_environment;
pub mod prefilter_phong;
pub mod prefilter_specular;
pub mod radiance_map;
pub mod real_radiance;
pub mod receive;
pub mod separable_blur;
pub mod shade;
pub mod sphere_map;
pub mod surroundings;

/// Edge of the cube of a virtual object's own environment, texels.
pub const ENVIRONMENT_SIZE: u32 = 128;
/// Mips of that cube: 128, 64, 32, 16, 8, 4.
pub const ENVIRONMENT_MIPS: u32 = 6;

/// Workgroups of 8 that cover `texels`.
fn groups(texels: u32) -> u32 {
    texels.div_ceil(8)
}
