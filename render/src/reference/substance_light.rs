//! Radiance of a substance from the light that it gets.

use glam::Vec3;

use super::material::Substance;
use crate::config::Facets;
use crate::directional_albedo::albedo;
use crate::scene::material::Model;

/// Light on a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceLight {
    /// Irradiance.
    pub irradiance: Vec3,
    /// Radiance from around the mirrored direction.
    pub mirrored: Vec3,
    /// The same for the coat.
    pub coat_mirrored: Vec3,
    /// Radiance from behind.
    pub through: Vec3,
}

/// Radiance towards `to_eye` (unit): glTF 2.0, appendix B, each layer passing on what it does not reflect of light from all
/// around, with the layers of KHR_materials_sheen and KHR_materials_clearcoat. [`Model::Unlit`] sends its base colour.
#[must_use]
pub fn sent_radiance(made: &Substance, to_eye: Vec3, light: &SurfaceLight, facets: Facets) -> Vec3 {
    let white = light.irradiance / std::f32::consts::PI;
    let base = made.base_color.truncate();
    match made.model {
        Model::Unlit => return base,
        Model::GlossInAlpha => return made.emission + base * light.mirrored.lerp(white, made.base_color.w),
        Model::MetallicRoughness => {}
    }
    let cosine = made.normal.dot(to_eye).clamp(0.0, 1.0);
    let layer = |f0, f90, roughness, cosine| layer_albedo((f0, f90), roughness, cosine, facets);
    let dielectric = layer(made.dielectric_f0, made.dielectric_f90, made.roughness, cosine);
    let metal = layer(base, 1.0, made.roughness, cosine) * light.mirrored;
    let entering = (1.0 - dielectric.max_element()) * base;
    let below = entering * white.lerp(light.through, made.transmission);
    let bare = (dielectric * light.mirrored + below).lerp(metal, made.metallic);
    let sheen = albedo(made.sheen_roughness, cosine).sheen;
    let clothed = (1.0 - made.sheen.max_element() * sheen) * bare + made.sheen * sheen * white + made.emission;
    let coat_cosine = made.coat_normal.dot(to_eye).clamp(0.0, 1.0);
    let coat = made.coat * layer(Vec3::splat(0.04), 1.0, made.coat_roughness, coat_cosine);
    (1.0 - coat) * clothed + coat * light.coat_mirrored
}

/// Share of light from all around that a rough layer reflects (Turquin 2019, eq. 16, for all scattering).
fn layer_albedo((f0, f90): (Vec3, f32), roughness: f32, cosine: f32, facets: Facets) -> Vec3 {
    let split = albedo(roughness, cosine);
    let single = f0 * split.scale + f90 * split.offset;
    let white = split.scale + split.offset;
    match facets {
        Facets::Single => single,
        Facets::Multiple => single * (1.0 + f0 * (1.0 - white) / white),
    }
}
