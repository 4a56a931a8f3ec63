//! What surfaces are made of: the materials of glTF 2.0 with their textures.

use std::sync::Arc;

use glam::{Affine2, Vec2};

use super::Vertex;

/// Textures of a material at most, in the order of [`Material::textures`] and of `shared/material.wgsl`.
pub const N_TEXTURES: usize = 14;

/// A picture, rows from the top, as its file stores it: nothing is decoded from sRGB. 16-bit pictures are rounded to 8 bits.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// What messages call it.
    pub name: String,
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// Four bytes per texel.
    pub rgba: Vec<u8>,
}

/// What lies beyond the edges of a picture (glTF 2.0, sampler `wrapS` and `wrapT`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The picture again.
    #[default]
    Repeat,
    /// The picture mirrored.
    Mirror,
    /// Its edge.
    Clamp,
}

/// Which texture coordinates of a vertex a picture is looked up with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UvSet {
    /// `TEXCOORD_0`.
    #[default]
    First,
    /// `TEXCOORD_1`.
    Second,
}

impl UvSet {
    /// 0 or 1, as glTF counts.
    #[must_use]
    pub fn index(self) -> u32 {
        match self {
            Self::First => 0,
            Self::Second => 1,
        }
    }
}

/// A picture on a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// The picture; shared among all textures that show it.
    pub image: Arc<Image>,
    /// The vertices' coordinates that it goes by.
    pub uv_set: UvSet,
    /// Coordinates in the picture, (0, 0) its top left corner, from those of the vertices (KHR_texture_transform).
    pub picture_from_uv: Affine2,
    /// What lies beyond the edges along u and v.
    pub wrap: [Wrap; 2],
}

impl Texture {
    /// A picture on the first set of coordinates, repeated.
    #[must_use]
    pub fn plain(image: Arc<Image>) -> Self {
        Self {
            image,
            uv_set: UvSet::First,
            picture_from_uv: Affine2::IDENTITY,
            wrap: [Wrap::Repeat; 2],
        }
    }

    /// Place in the picture that a vertex shows, wrapping left out.
    #[must_use]
    pub fn place_of(&self, vertex: &Vertex) -> Vec2 {
        self.picture_from_uv.transform_point2(match self.uv_set {
            UvSet::First => Vec2::from(vertex.uv),
            UvSet::Second => Vec2::from(vertex.uv1),
        })
    }
}

/// A picture of normals in the frame of tangent, bitangent and normal, with the scale of its x and y.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalMap {
    /// RGB: normal, 0 ..= 1 for -1 ..= 1.
    pub texture: Texture,
    /// Factor of x and y.
    pub scale: f32,
}

/// How a surface turns the light it gets into radiance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Model {
    /// glTF 2.0, appendix B.
    #[default]
    MetallicRoughness,
    /// Colour times mirrored light where the base colour's alpha is 0, times diffuse light where it is 1, mixed between; no
    /// Fresnel term (material `extras` with `"mirrorball_gloss_in_alpha": true`).
    GlossInAlpha,
    /// The base colour as the camera's pictures would show it, whatever the light: 1 is full signal (KHR_materials_unlit).
    Unlit,
}

/// What a material's alpha means.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Alpha {
    /// Nothing.
    #[default]
    Opaque,
    /// There is no surface where alpha is below `cutoff`.
    Mask {
        /// 0 ..= 1, glTF's default is 0.5.
        cutoff: f32,
    },
    /// Share of the background that the surface covers.
    Blend,
}

/// From where a surface is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sides {
    /// From its front alone: the side from which its triangles run counterclockwise.
    Front,
    /// From both sides.
    #[default]
    Both,
}

/// A clear coat over everything else (KHR_materials_clearcoat), index of refraction 1.5.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Clearcoat {
    /// Share of the surface that is coated, 0 ..= 1.
    pub factor: f32,
    /// Factor of `factor` in R.
    pub texture: Option<Texture>,
    /// Perceptual roughness, 0 ..= 1.
    pub roughness: f32,
    /// Factor of `roughness` in G.
    pub roughness_texture: Option<Texture>,
    /// Normals of the coat; without one it is as smooth as the mesh.
    pub normal: Option<NormalMap>,
}

/// Fibres on a surface (KHR_materials_sheen).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sheen {
    /// Linear reflectance; black for none.
    pub color: [f32; 3],
    /// Factor of `color`, sRGB.
    pub color_texture: Option<Texture>,
    /// Perceptual roughness, 0 ..= 1.
    pub roughness: f32,
    /// Factor of `roughness` in A.
    pub roughness_texture: Option<Texture>,
}

/// What fills a transparent thing (KHR_materials_volume).
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Thickness below the surface, metres; 0 for a thin wall.
    pub thickness_m: f32,
    /// Factor of `thickness_m` in G.
    pub thickness_texture: Option<Texture>,
    /// Way after which white light has `attenuation_color`, metres; infinite where nothing is absorbed.
    pub attenuation_distance_m: f32,
    /// Linear colour.
    pub attenuation_color: [f32; 3],
}

impl Default for Volume {
    /// A thin wall that absorbs nothing.
    fn default() -> Self {
        Self {
            thickness_m: 0.0,
            thickness_texture: None,
            attenuation_distance_m: f32::INFINITY,
            attenuation_color: [1.0; 3],
        }
    }
}

/// Material of glTF 2.0 with the extensions clearcoat, emissive_strength, ior, sheen, specular, transmission, unlit and volume.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// How light becomes radiance.
    pub model: Model,
    /// Linear base colour factor.
    pub base_color: [f32; 3],
    /// Alpha's factor, 0 ..= 1.
    pub opacity: f32,
    /// Base colour, sRGB, with alpha; multiplied with the factors.
    pub base_color_texture: Option<Texture>,
    /// What alpha means.
    pub alpha: Alpha,
    /// From where it is seen.
    pub sides: Sides,
    /// 0 dielectric ..= 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 ..= 1; GGX alpha is its square.
    pub roughness: f32,
    /// Factors of roughness in G and of metallic in B.
    pub metallic_roughness_texture: Option<Texture>,
    /// Finer shape.
    pub normal: Option<NormalMap>,
    /// Share of the light from all around that arrives, in R.
    pub occlusion_texture: Option<Texture>,
    /// How much of the occlusion counts, 0 ..= 1.
    pub occlusion_strength: f32,
    /// Radiance that it sends by itself, linear RGB, in the units of the measured light: factor times strength.
    pub emission: [f32; 3],
    /// Factor of the emission, sRGB.
    pub emission_texture: Option<Texture>,
    /// Reflectance of a dielectric at normal incidence, linear RGB: that of its index of refraction times the extension's
    /// factors.
    pub dielectric_f0: [f32; 3],
    /// Reflectance of a dielectric at grazing incidence: the extension's factor, 1 without it.
    pub dielectric_f90: f32,
    /// Factor of a dielectric's reflectance in A.
    pub specular_texture: Option<Texture>,
    /// Factor of its reflectance at normal incidence, sRGB.
    pub specular_color_texture: Option<Texture>,
    /// Share of the light that enters a dielectric and goes through it, 0 ..= 1.
    pub transmission: f32,
    /// Factor of `transmission` in R.
    pub transmission_texture: Option<Texture>,
    /// Index of refraction, 1 or more.
    pub ior: f32,
    /// What is below the surface of a transparent thing.
    pub volume: Volume,
    /// Clear coat.
    pub clearcoat: Clearcoat,
    /// Sheen.
    pub sheen: Sheen,
}

impl Default for Material {
    /// White, matt and opaque, without any gloss, seen from both sides.
    fn default() -> Self {
        Self {
            model: Model::MetallicRoughness,
            base_color: [1.0; 3],
            opacity: 1.0,
            base_color_texture: None,
            alpha: Alpha::Opaque,
            sides: Sides::Both,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal: None,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            emission: [0.0; 3],
            emission_texture: None,
            dielectric_f0: [0.0; 3],
            dielectric_f90: 0.0,
            specular_texture: None,
            specular_color_texture: None,
            transmission: 0.0,
            transmission_texture: None,
            ior: 1.5,
            volume: Volume::default(),
            clearcoat: Clearcoat::default(),
            sheen: Sheen::default(),
        }
    }
}

impl Material {
    /// Whether anything mirrors or goes through it, so that the environment's radiance is looked up.
    #[must_use]
    pub fn is_glossy(&self) -> bool {
        match self.model {
            Model::MetallicRoughness => {
                self.metallic > 0.0
                    || self.dielectric_f0.iter().any(|&f| f > 0.0)
                    || self.transmission > 0.0
                    || self.clearcoat.factor > 0.0
            }
            Model::GlossInAlpha => true,
            Model::Unlit => false,
        }
    }

    /// All textures that it has, by their purpose.
    #[must_use]
    pub fn textures(&self) -> [Option<&Texture>; N_TEXTURES] {
        [
            self.base_color_texture.as_ref(),
            self.metallic_roughness_texture.as_ref(),
            self.normal.as_ref().map(|map| &map.texture),
            self.occlusion_texture.as_ref(),
            self.emission_texture.as_ref(),
            self.specular_texture.as_ref(),
            self.specular_color_texture.as_ref(),
            self.transmission_texture.as_ref(),
            self.volume.thickness_texture.as_ref(),
            self.clearcoat.texture.as_ref(),
            self.clearcoat.roughness_texture.as_ref(),
            self.clearcoat.normal.as_ref().map(|map| &map.texture),
            self.sheen.color_texture.as_ref(),
            self.sheen.roughness_texture.as_ref(),
        ]
    }

    /// The sets of coordinates that its textures go by.
    pub fn uv_sets(&self) -> impl Iterator<Item = UvSet> + '_ {
        self.textures().into_iter().flatten().map(|texture| texture.uv_set)
    }
}
