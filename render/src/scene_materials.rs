//! The scene's materials as the GPU holds them: group 1 of every pass that imports `material`.
//!
//! All pictures lie in two arrays, one of colours (sRGB) and one of plain values, each with its mips and as large as its
//! largest picture; smaller ones are enlarged. Wrapping at the edges is the shader's work.

use std::sync::Arc;

use glam::{Affine2, Vec4};

use crate::directional_albedo;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::types::{GpuMap, GpuMaterial};
use crate::scene::Material;
use crate::scene::material::{Alpha, Image, Model, N_TEXTURES, NormalMap, Sides, Texture, UvSet, Wrap};

/// Largest edge of a picture, texels.
const MAX_EDGE: u32 = 2048;
/// Smallest edge that pictures are reduced to so that all fit.
const MIN_EDGE: u32 = 64;
/// Memory that the pictures of one array may take; they are halved until they do.
const MAX_BYTES: u64 = 512 << 20;

/// Whether the textures of [`Material::textures`] hold colours, in their order. Those read in alpha alone lie with the
/// colours, which often share a picture with them: alpha is never sRGB.
const IS_COLOR: [bool; N_TEXTURES] = [
    true, false, false, false, true, true, true, false, false, false, false, false, true, true,
];

/// Materials, their pictures, and the table of how much surfaces reflect.
#[derive(Debug)]
pub struct SceneMaterials {
    buffer: wgpu::Buffer,
    sampler: wgpu::Sampler,
    colors: wgpu::TextureView,
    values: wgpu::TextureView,
    albedos: wgpu::TextureView,
}

impl SceneMaterials {
    /// Uploads materials in their order.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more pictures than the adapter has layers for, or than fit into half a gigabyte at
    /// 64 texels.
    pub fn new(gpu: &Gpu, materials: &[Material]) -> Result<Self, RenderError> {
        let (mut colors, mut values) = (Layers::default(), Layers::default());
        let mut all: Vec<GpuMaterial> = materials
            .iter()
            .map(|material| gpu_material(material, &mut colors, &mut values))
            .collect();
        all.push(gpu_material(&Material::default(), &mut colors, &mut values));
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("materials"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        Ok(Self {
            buffer: gpu.buffer("materials", &all),
            sampler,
            colors: colors.upload(gpu, "materials: colours", wgpu::TextureFormat::Rgba8UnormSrgb)?,
            values: values.upload(gpu, "materials: values", wgpu::TextureFormat::Rgba8Unorm)?,
            albedos: upload_albedos(gpu),
        })
    }

    /// The materials alone.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Group 1 of a pass that asks for whole substances, for the group's `layout`.
    #[must_use]
    pub fn bind(&self, gpu: &Gpu, layout: &wgpu::BindGroupLayout) -> wgpu::BindGroup {
        let [materials, sampler, colors, values] = self.shape_resources();
        let albedos = wgpu::BindingResource::TextureView(&self.albedos);
        gpu.bind("materials", layout, &[materials, sampler, colors, values, albedos])
    }

    /// Group 1 of a pass that asks for coverage and normals alone.
    #[must_use]
    pub fn bind_shape(&self, gpu: &Gpu, layout: &wgpu::BindGroupLayout) -> wgpu::BindGroup {
        gpu.bind("materials: shape", layout, &self.shape_resources())
    }

    fn shape_resources(&self) -> [wgpu::BindingResource<'_>; 4] {
        [
            self.buffer.as_entire_binding(),
            wgpu::BindingResource::Sampler(&self.sampler),
            wgpu::BindingResource::TextureView(&self.colors),
            wgpu::BindingResource::TextureView(&self.values),
        ]
    }
}

/// The pictures of one array, each once.
#[derive(Debug, Default)]
struct Layers {
    images: Vec<Arc<Image>>,
}

impl Layers {
    fn layer_of(&mut self, image: &Arc<Image>) -> u32 {
        let known = self.images.iter().position(|known| Arc::ptr_eq(known, image));
        known.unwrap_or_else(|| {
            self.images.push(image.clone());
            self.images.len() - 1
        }) as u32
    }

    fn upload(
        &self,
        gpu: &Gpu,
        label: &'static str,
        format: wgpu::TextureFormat,
    ) -> Result<wgpu::TextureView, RenderError> {
        let n = self.images.len() as u64;
        let limits = gpu.device.limits();
        let layers = u64::from(limits.max_texture_array_layers);
        gpu.within(
            "a number of pictures of materials",
            n,
            layers.min(MAX_BYTES / mipped_bytes(MIN_EDGE)),
        )?;
        let edge = self.edge(limits.max_texture_dimension_2d.min(MAX_EDGE));
        let mips = edge.ilog2() + 1;
        let shape = TextureShape {
            mips,
            ..TextureShape::layered([edge; 2], (n as u32).max(1))
        };
        let texture = gpu.texture(label, shape, format);
        for (layer, image) in self.images.iter().enumerate() {
            let mut texels = Mips::new(image, edge, format.is_srgb());
            for mip in 0..mips {
                write_mip(gpu, (&texture, mip, layer as u32), &texels.encoded());
                texels.halve();
            }
        }
        Ok(texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..wgpu::TextureViewDescriptor::default()
        }))
    }

    /// Edge of the array's first mip, a power of two: that of the largest picture, or less so that all fit.
    fn edge(&self, most: u32) -> u32 {
        let largest = self.images.iter().flat_map(|image| image.size_px).max().unwrap_or(1);
        let wanted = largest.max(1).min(most).next_power_of_two();
        let mut edge = if wanted > most { wanted / 2 } else { wanted };
        while edge > MIN_EDGE && self.images.len() as u64 * mipped_bytes(edge) > MAX_BYTES {
            edge /= 2;
        }
        if edge < largest {
            tracing::warn!(
                "{} pictures of materials are reduced to {edge} texels; the largest has {largest}",
                self.images.len()
            );
        }
        edge
    }
}

/// Bytes of a layer with its mips.
fn mipped_bytes(edge: u32) -> u64 {
    u64::from(edge).pow(2) * 4 * 4 / 3
}

/// A picture at one mip, linear.
struct Mips {
    texels: Vec<Vec4>,
    edge: u32,
    is_srgb: bool,
}

impl Mips {
    fn new(image: &Image, edge: u32, is_srgb: bool) -> Self {
        let [width, height] = image.size_px;
        let picture = image::RgbaImage::from_raw(width, height, image.rgba.clone()).unwrap_or_default();
        let scaled = if [width, height] == [edge; 2] {
            picture
        } else {
            image::imageops::resize(&picture, edge, edge, image::imageops::FilterType::Triangle)
        };
        let decode = |code: u8| {
            let x = f32::from(code) / 255.0;
            if !is_srgb {
                x
            } else if x <= 0.04045 {
                x / 12.92
            } else {
                ((x + 0.055) / 1.055).powf(2.4)
            }
        };
        let linear: Vec<f32> = (0..=255).map(decode).collect();
        let texels = scaled.pixels().map(|pixel| {
            let [r, g, b, a] = pixel.0;
            let color = [r, g, b].map(|code| linear[usize::from(code)]);
            Vec4::new(color[0], color[1], color[2], f32::from(a) / 255.0)
        });
        Self {
            texels: texels.collect(),
            edge,
            is_srgb,
        }
    }

    /// The next mip: means of four.
    fn halve(&mut self) {
        let (edge, before) = (self.edge / 2, self.edge);
        let at = |column: u32, row: u32| self.texels[(row * before + column) as usize];
        self.texels = (0..edge * edge)
            .map(|i| {
                let (column, row) = (2 * (i % edge), 2 * (i / edge));
                0.25 * (at(column, row) + at(column + 1, row) + at(column, row + 1) + at(column + 1, row + 1))
            })
            .collect();
        self.edge = edge;
    }

    fn encoded(&self) -> Vec<u8> {
        let encode = |x: f32| {
            let x = if !self.is_srgb {
                x
            } else if x <= 0.003_130_8 {
                12.92 * x
            } else {
                1.055 * x.powf(1.0 / 2.4) - 0.055
            };
            (255.0 * x).round() as u8
        };
        let texel = |t: &Vec4| [encode(t.x), encode(t.y), encode(t.z), (255.0 * t.w).round() as u8];
        self.texels.iter().flat_map(texel).collect()
    }
}

fn write_mip(gpu: &Gpu, (texture, mip, layer): (&wgpu::Texture, u32, u32), rgba: &[u8]) {
    let edge = texture.width() >> mip;
    gpu.queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            mip_level: mip,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            ..texture.as_image_copy()
        },
        rgba,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4 * edge),
            rows_per_image: Some(edge),
        },
        wgpu::Extent3d {
            width: edge,
            height: edge,
            depth_or_array_layers: 1,
        },
    );
}

fn upload_albedos(gpu: &Gpu) -> wgpu::TextureView {
    let [columns, rows] = directional_albedo::TABLE_SIZE;
    let texture = gpu.texture(
        "materials: albedos",
        TextureShape::plain([columns, rows]),
        RADIANCE_FORMAT,
    );
    let texels: Vec<[half::f16; 4]> = directional_albedo::table()
        .iter()
        .map(|albedo| [albedo.scale, albedo.offset, albedo.sheen, 0.0].map(half::f16::from_f32))
        .collect();
    gpu.queue.write_texture(
        texture.as_image_copy(),
        bytemuck::cast_slice(&texels),
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(8 * columns),
            rows_per_image: Some(rows),
        },
        texture.size(),
    );
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

fn gpu_material(material: &Material, colors: &mut Layers, values: &mut Layers) -> GpuMaterial {
    let with = |[x, y, z]: [f32; 3], w: f32| Vec4::new(x, y, z, w);
    let scale = |map: &Option<NormalMap>| map.as_ref().map_or(1.0, |map| map.scale);
    let textures = material.textures();
    let maps = std::array::from_fn(|i| {
        let layers = if IS_COLOR[i] { &mut *colors } else { &mut *values };
        gpu_map(textures[i], layers)
    });
    let has_map = |i: usize| u32::from(textures[i].is_some()) << i;
    let volume = &material.volume;
    let distance_m = volume.attenuation_distance_m.min(1e30);
    let coat = &material.clearcoat;
    GpuMaterial {
        base_color: with(material.base_color, material.opacity),
        dielectric: with(material.dielectric_f0, material.dielectric_f90),
        emission: with(material.emission, material.occlusion_strength),
        attenuation: with(volume.attenuation_color, distance_m),
        sheen: with(material.sheen.color, material.sheen.roughness),
        surface: Vec4::new(
            material.metallic,
            material.roughness,
            scale(&material.normal),
            cutoff(material),
        ),
        coat: Vec4::new(coat.factor, coat.roughness, scale(&coat.normal), 0.0),
        glass: Vec4::new(material.transmission, material.ior, volume.thickness_m, 0.0),
        kinds: [
            model_code(material.model),
            alpha_code(material.alpha),
            sides_code(material.sides),
            (0..N_TEXTURES).map(has_map).sum(),
        ],
        maps,
    }
}

fn cutoff(material: &Material) -> f32 {
    match material.alpha {
        Alpha::Mask { cutoff } => cutoff,
        Alpha::Opaque | Alpha::Blend => 0.0,
    }
}

fn model_code(model: Model) -> u32 {
    match model {
        Model::MetallicRoughness => 0,
        Model::GlossInAlpha => 1,
        Model::Unlit => 2,
    }
}

fn alpha_code(alpha: Alpha) -> u32 {
    match alpha {
        Alpha::Opaque => 0,
        Alpha::Mask { .. } => 1,
        Alpha::Blend => 2,
    }
}

fn sides_code(sides: Sides) -> u32 {
    match sides {
        Sides::Front => 0,
        Sides::Both => 1,
    }
}

fn gpu_map(texture: Option<&Texture>, layers: &mut Layers) -> GpuMap {
    let Some(texture) = texture else {
        return bytemuck::Zeroable::zeroed();
    };
    let Affine2 { matrix2, translation } = texture.picture_from_uv;
    let [x_axis, y_axis] = [matrix2.x_axis, matrix2.y_axis];
    let wrap = |wrap: Wrap| match wrap {
        Wrap::Repeat => 0,
        Wrap::Mirror => 1,
        Wrap::Clamp => 2,
    };
    let set = match texture.uv_set {
        UvSet::First => 0,
        UvSet::Second => 1,
    };
    GpuMap {
        matrix: Vec4::new(x_axis.x, x_axis.y, y_axis.x, y_axis.y),
        // What a step in the vertices' coordinates becomes at most.
        place: translation.extend(x_axis.length().max(y_axis.length())).extend(0.0),
        facts: [
            layers.layer_of(&texture.image),
            set,
            wrap(texture.wrap[0]),
            wrap(texture.wrap[1]),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(edge: u32, rgba: [u8; 4]) -> Arc<Image> {
        Arc::new(Image {
            name: String::new(),
            size_px: [edge; 2],
            rgba: rgba.repeat((edge * edge) as usize),
        })
    }

    #[test]
    fn pictures_are_halved_until_they_fit() {
        let few = Layers {
            images: vec![image(4, [0; 4]), image(3, [0; 4])],
        };
        assert_eq!(few.edge(2048), 4);
        let many = Layers {
            images: vec![image(2048, [0; 4]); 30],
        };
        assert_eq!(many.edge(2048), 1024);
        assert_eq!(many.edge(1000), 512);
    }

    #[test]
    fn mips_are_means_of_linear_light() {
        let board = Image {
            name: String::new(),
            size_px: [2, 2],
            rgba: [[0, 0, 0, 0], [255; 4], [255; 4], [0, 0, 0, 0]].concat(),
        };
        for (is_srgb, half) in [(true, 188), (false, 128)] {
            let mut mips = Mips::new(&board, 2, is_srgb);
            assert_eq!(mips.encoded(), board.rgba);
            mips.halve();
            assert_eq!(mips.encoded(), [half, half, half, 128]);
        }
    }
}
