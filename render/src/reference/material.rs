//! What a point of a mesh is made of, picture by picture, at their sharpest.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::scene::Material;
use crate::scene::material::{Image, Model, NormalMap, Texture, UvSet, Wrap};

/// A point of a mesh as its vertices give it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshPoint {
    /// Unit normal.
    pub normal: Vec3,
    /// xyz: tangent; w: the bitangent's sense.
    pub tangent: Vec4,
    /// Both sets of texture coordinates.
    pub uv: [Vec2; 2],
    /// Linear colour and opacity.
    pub color: Vec4,
}

/// What a point is made of; members as in `shared/material.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Substance {
    /// How light becomes radiance.
    pub model: Model,
    /// Linear colour, opacity.
    pub base_color: Vec4,
    /// Unit normal.
    pub normal: Vec3,
    /// 0 dielectric ..= 1 metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Reflectance of the dielectric at normal incidence.
    pub dielectric_f0: Vec3,
    /// At grazing incidence.
    pub dielectric_f90: f32,
    /// Emitted radiance.
    pub emission: Vec3,
    /// Share of the light from all around that arrives.
    pub occlusion: f32,
    /// Share that is coated.
    pub coat: f32,
    /// Perceptual roughness of the coat.
    pub coat_roughness: f32,
    /// Unit normal of the coat.
    pub coat_normal: Vec3,
    /// Colour of the sheen.
    pub sheen: Vec3,
    /// Its perceptual roughness.
    pub sheen_roughness: f32,
    /// Share of the light that enters and goes through.
    pub transmission: f32,
    /// Thickness below the surface, metres.
    pub thickness_m: f32,
}

/// The substance of `material` at a point.
#[must_use]
pub fn substance(material: &Material, point: &MeshPoint) -> Substance {
    let color = |texture: &Option<Texture>| look_up(texture.as_ref(), point, decoded);
    let value = |texture: &Option<Texture>| look_up(texture.as_ref(), point, |x| x);
    let metallic_roughness = value(&material.metallic_roughness_texture);
    let specular = color(&material.specular_texture).w;
    let coat = &material.clearcoat;
    let sheen = &material.sheen;
    Substance {
        model: material.model,
        base_color: Vec3::from(material.base_color).extend(material.opacity)
            * point.color
            * color(&material.base_color_texture),
        normal: normal(material.normal.as_ref(), point),
        metallic: material.metallic * metallic_roughness.z,
        roughness: material.roughness * metallic_roughness.y,
        dielectric_f0: Vec3::from(material.dielectric_f0) * color(&material.specular_color_texture).xyz() * specular,
        dielectric_f90: material.dielectric_f90 * specular,
        emission: Vec3::from(material.emission) * color(&material.emission_texture).xyz(),
        occlusion: 1.0 + material.occlusion_strength * (value(&material.occlusion_texture).x - 1.0),
        coat: coat.factor * value(&coat.texture).x,
        coat_roughness: coat.roughness * value(&coat.roughness_texture).y,
        coat_normal: normal(coat.normal.as_ref(), point),
        sheen: Vec3::from(sheen.color) * color(&sheen.color_texture).xyz(),
        sheen_roughness: sheen.roughness * color(&sheen.roughness_texture).w,
        transmission: material.transmission * value(&material.transmission_texture).x,
        thickness_m: material.volume.thickness_m * value(&material.volume.thickness_texture).y,
    }
}

fn normal(map: Option<&NormalMap>, point: &MeshPoint) -> Vec3 {
    let Some(NormalMap { texture, scale }) = map else {
        return point.normal;
    };
    let stored = 2.0 * look_up(Some(texture), point, |x| x).xyz() - 1.0;
    let tangent = point.tangent.xyz().reject_from_normalized(point.normal).normalize();
    let bitangent = point.normal.cross(tangent) * point.tangent.w;
    (scale * (stored.x * tangent + stored.y * bitangent) + stored.z * point.normal).normalize()
}

/// Linear from sRGB (IEC 61966-2-1).
fn decoded(x: f32) -> f32 {
    if x <= 0.04045 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    }
}

/// The picture between its four nearest texels, white without picture; alpha is never decoded.
fn look_up(texture: Option<&Texture>, point: &MeshPoint, decode: impl Fn(f32) -> f32) -> Vec4 {
    let Some(texture) = texture else {
        return Vec4::ONE;
    };
    let uv = texture.picture_from_uv.transform_point2(match texture.uv_set {
        UvSet::First => point.uv[0],
        UvSet::Second => point.uv[1],
    });
    let size = Vec2::from(texture.image.size_px.map(|n| n as f32));
    let place = uv * size - 0.5;
    let corner = place.floor();
    let part = place - corner;
    let mut sum = Vec4::ZERO;
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let weight = if dx == 1 { part.x } else { 1.0 - part.x } * if dy == 1 { part.y } else { 1.0 - part.y };
        let [width, height] = texture.image.size_px;
        let column = texel_index(corner.x as i64 + dx, width, texture.wrap[0]);
        let row = texel_index(corner.y as i64 + dy, height, texture.wrap[1]);
        sum += weight * texel(&texture.image, column, row, &decode);
    }
    sum
}

fn texel_index(index: i64, n: u32, wrap: Wrap) -> usize {
    let n = i64::from(n);
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(n),
        Wrap::Mirror => {
            let twice = index.rem_euclid(2 * n);
            twice.min(2 * n - 1 - twice)
        }
        Wrap::Clamp => index.clamp(0, n - 1),
    };
    inside as usize
}

fn texel(image: &Image, column: usize, row: usize, decode: impl Fn(f32) -> f32) -> Vec4 {
    let first = 4 * (row * image.size_px[0] as usize + column);
    let [r, g, b, a] = std::array::from_fn(|i| f32::from(image.rgba[first + i]) / 255.0);
    Vec4::new(decode(r), decode(g), decode(b), a)
}
