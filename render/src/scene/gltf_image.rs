//! Pictures and textures of glTF files.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{Affine2, Mat2, Vec2};
use gltf::image::{Format, Source};
use gltf::texture::WrappingMode;
use serde::Deserialize;

use super::material::{Image, Texture, UvSet, Wrap};

/// A texture as a material of the file names it, scale and strength included.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureInfo {
    index: usize,
    #[serde(default)]
    tex_coord: u32,
    /// Of a normal texture.
    #[serde(default = "one")]
    pub(super) scale: f32,
    /// Of an occlusion texture.
    #[serde(default = "one")]
    pub(super) strength: f32,
    #[serde(default)]
    extensions: TextureExtensions,
}

#[derive(Debug, Clone, Default, Deserialize)]
struct TextureExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<TextureTransform>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct TextureTransform {
    offset: [f32; 2],
    rotation: f32,
    scale: [f32; 2],
    tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            tex_coord: None,
        }
    }
}

pub(super) fn one() -> f32 {
    1.0
}

/// The pictures of a file, each decoded when it is first wanted.
pub(super) struct Images<'a> {
    document: &'a gltf::Document,
    folder: Option<&'a Path>,
    buffers: &'a [gltf::buffer::Data],
    known: HashMap<usize, Arc<Image>>,
}

impl<'a> Images<'a> {
    pub(super) fn new(
        document: &'a gltf::Document,
        folder: Option<&'a Path>,
        buffers: &'a [gltf::buffer::Data],
    ) -> Self {
        Self {
            document,
            folder,
            buffers,
            known: HashMap::new(),
        }
    }

    /// The texture that `info` names; the message says what is wrong with it.
    pub(super) fn texture(&mut self, info: &TextureInfo) -> Result<Texture, String> {
        let texture = self
            .document
            .textures()
            .nth(info.index)
            .ok_or_else(|| format!("there is no texture {}", info.index))?;
        let transform = info.extensions.transform.clone().unwrap_or_default();
        let picture_from_uv = transform.matrix();
        if !picture_from_uv.is_finite() {
            return Err(format!("texture {} has a transform that is not finite", info.index));
        }
        let sampler = texture.sampler();
        Ok(Texture {
            uv_set: uv_set(transform.tex_coord.unwrap_or(info.tex_coord))?,
            picture_from_uv,
            wrap: [sampler.wrap_s(), sampler.wrap_t()].map(wrap),
            image: self.image(&texture.source())?,
        })
    }

    fn image(&mut self, image: &gltf::Image<'_>) -> Result<Arc<Image>, String> {
        if let Some(known) = self.known.get(&image.index()) {
            return Ok(known.clone());
        }
        let name = title(image);
        let decoded = self.decode(image).map_err(|message| format!("{name}: {message}"))?;
        let read = Arc::new(Image {
            size_px: [decoded.width, decoded.height],
            rgba: rgba(&decoded),
            name,
        });
        self.known.insert(image.index(), read.clone());
        Ok(read)
    }

    fn decode(&self, image: &gltf::Image<'_>) -> Result<gltf::image::Data, String> {
        if let Source::View { view, .. } = image.source() {
            let held = self.buffers.get(view.buffer().index()).map_or(0, |data| data.0.len());
            // `from_source` takes this for granted.
            if view.offset().checked_add(view.length()).is_none_or(|end| end > held) {
                return Err(format!("its buffer view {} goes beyond its buffer", view.index()));
            }
        }
        gltf::image::Data::from_source(image.source(), self.folder, self.buffers).map_err(|error| error.to_string())
    }
}

impl TextureTransform {
    /// KHR_texture_transform: translation · rotation · scale, angles counterclockwise as the picture lies.
    fn matrix(&self) -> Affine2 {
        let (sin, cos) = self.rotation.sin_cos();
        let rotation = Mat2::from_cols(Vec2::new(cos, -sin), Vec2::new(sin, cos));
        let scale = Mat2::from_diagonal(Vec2::from(self.scale));
        Affine2::from_mat2_translation(rotation * scale, Vec2::from(self.offset))
    }
}

fn uv_set(index: u32) -> Result<UvSet, String> {
    match index {
        0 => Ok(UvSet::First),
        1 => Ok(UvSet::Second),
        other => Err(format!("a texture goes by TEXCOORD_{other}; there may be 0 and 1")),
    }
}

fn wrap(mode: WrappingMode) -> Wrap {
    match mode {
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
        WrappingMode::Repeat => Wrap::Repeat,
    }
}

fn title(image: &gltf::Image<'_>) -> String {
    match (image.name(), image.source()) {
        (_, Source::Uri { uri, .. }) if !uri.starts_with("data:") => format!("picture `{uri}`"),
        (Some(name), _) => format!("picture `{name}`"),
        (None, _) => format!("picture {}", image.index()),
    }
}

/// All formats as 8-bit RGBA: grey goes into all three channels, 16 bits are rounded.
fn rgba(data: &gltf::image::Data) -> Vec<u8> {
    let pixels = &data.pixels;
    let wide = || -> Vec<u8> {
        let word = |b: &[u8]| u32::from(u16::from_ne_bytes([b[0], b[1]]));
        pixels
            .chunks_exact(2)
            .map(|b| ((word(b) * 255 + 32767) / 65535) as u8)
            .collect()
    };
    let float = || -> Vec<u8> {
        let word = |b: &[u8]| f32::from_ne_bytes([b[0], b[1], b[2], b[3]]);
        pixels
            .chunks_exact(4)
            .map(|b| (255.0 * word(b)).round() as u8)
            .collect()
    };
    match data.format {
        Format::R8 => spread::<1>(pixels),
        Format::R8G8 => spread::<2>(pixels),
        Format::R8G8B8 => spread::<3>(pixels),
        Format::R8G8B8A8 => pixels.clone(),
        Format::R16 => spread::<1>(&wide()),
        Format::R16G16 => spread::<2>(&wide()),
        Format::R16G16B16 => spread::<3>(&wide()),
        Format::R16G16B16A16 => wide(),
        Format::R32G32B32FLOAT => spread::<3>(&float()),
        Format::R32G32B32A32FLOAT => float(),
    }
}

/// Grey, grey and alpha, or RGB, by the number of channels, as RGBA.
fn spread<const CHANNELS: usize>(bytes: &[u8]) -> Vec<u8> {
    bytes
        .chunks_exact(CHANNELS)
        .flat_map(|p| match *p {
            [r, g, b] => [r, g, b, 255],
            [grey, alpha] => [grey, grey, grey, alpha],
            _ => [p[0], p[0], p[0], 255],
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transform_turns_as_the_extension_says() {
        // The extension's example: the upper left quarter, turned by 90 degrees.
        let transform = TextureTransform {
            offset: [0.0, 1.0],
            rotation: std::f32::consts::FRAC_PI_2,
            scale: [0.5, 0.5],
            tex_coord: None,
        };
        let found = transform.matrix().transform_point2(Vec2::new(1.0, 0.0));
        assert!(found.distance(Vec2::new(0.0, 0.5)) < 1e-6, "{found}");
    }

    #[test]
    fn sixteen_bits_are_rounded() {
        let words = [0u16, 128, 129, 65535];
        let data = gltf::image::Data {
            pixels: words.iter().flat_map(|w| w.to_ne_bytes()).collect(),
            format: Format::R16G16B16A16,
            width: 1,
            height: 1,
        };
        assert_eq!(rgba(&data), [0, 0, 1, 255]);
    }
}
