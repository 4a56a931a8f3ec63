//! The passes of a frame; each owns its pipeline and records itself.

pub mod ball_mirror;
pub mod camera_depth;
pub mod composite;
pub mod cylindrical;
pub mod direct;
pub mod display;
pub mod downsample;
pub mod harmonics;
pub mod highlight;
pub mod inset;
pub mod irradiance;
pub mod irradiance_cube;
pub mod lamp_light;
pub mod lamp_receive;
pub mod lens_surface;
pub(crate) mod lobe_sum;
pub mod local_environment;
pub mod look_blur;
pub mod memory;
pub mod near_light;
pub mod phantom_edge;
pub mod prefilter_phong;
pub mod prefilter_specular;
pub mod protect;
pub mod radiance_map;
pub mod ray_light;
pub mod real_radiance;
pub mod receive;
pub mod reflect;
pub mod refract;
pub mod reproject;
pub mod room_mips;
pub mod separable_blur;
pub mod shade;
pub mod sphere_map;
pub mod surroundings;
pub mod virtual_surface;

/// Edge of the cube of a virtual object's own environment, texels.
pub const ENVIRONMENT_SIZE: u32 = 128;
/// Mips of that cube: 128, 64, 32, 16, 8, 4.
pub const ENVIRONMENT_MIPS: u32 = 6;

/// Workgroups of 8 that cover `texels`.
fn groups(texels: u32) -> u32 {
    texels.div_ceil(8)
}
