//! Substances of points and their radiance, without pictures.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::{Affine2, Mat2, Vec2, Vec3, Vec4, Vec4Swizzles};
use mirrorball_render::config::Facets;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::reference::material::{MeshPoint, Substance, substance};
use mirrorball_render::reference::substance_light::{SurfaceLight, sent_radiance};
use mirrorball_render::scene::Material;
use mirrorball_render::scene::material::{
    Alpha, Clearcoat, Image, Model, NormalMap, Sheen, Texture, UvSet, Volume, Wrap,
};
use mirrorball_render::scene_materials::SceneMaterials;

use crate::support::{self, Errors, directions, spread};

/// What facets do here; pictures show them with single scattering.
const FACETS: Facets = Facets::Multiple;

const PROBE: &str = "
#import lights
#import material
#import substance_light

struct Point {
    normal: vec4f,
    tangent: vec4f,
    uvs: vec4f,
    color: vec4f,
    // Irradiance, mirrored, coat mirrored, through.
    light: array<vec4f, 4>,
    // w: index of the material.
    to_eye: vec4f,
}

struct Found {
    base_color: vec4f,
    normal: vec4f,
    dielectric: vec4f,
    emission: vec4f,
    coat_normal: vec4f,
    sheen: vec4f,
    // Metallic, roughness, coat, coat roughness; transmission, thickness.
    rest: vec4f,
    more: vec4f,
    sent: vec4f,
}

@group(0) @binding(0) var<storage, read> points: array<Point>;
@group(0) @binding(1) var<storage, read_write> found: array<Found>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&points) {
        return;
    }
    let point = points[id.x];
    let made = substance_at(MeshPoint(point.normal.xyz, point.tangent, point.uvs.xy, point.uvs.zw, point.color, u32(point.to_eye.w)));
    let light = SurfaceLight(point.light[0].xyz, point.light[1].xyz, point.light[2].xyz, point.light[3].xyz);
    found[id.x] = Found(
        made.base_color,
        vec4f(made.normal, made.occlusion),
        vec4f(made.dielectric_f0, made.dielectric_f90),
        vec4f(made.emission, 0.0),
        vec4f(made.coat_normal, 0.0),
        vec4f(made.sheen, made.sheen_roughness),
        vec4f(made.metallic, made.roughness, made.coat, made.coat_roughness),
        vec4f(made.transmission, made.thickness_m, 0.0, 0.0),
        vec4f(sent_radiance(made, point.to_eye.xyz, light), 0.0),
    );
}
";

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Point {
    normal: Vec4,
    tangent: Vec4,
    uvs: Vec4,
    color: Vec4,
    light: [Vec4; 4],
    to_eye: Vec4,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Found {
    base_color: Vec4,
    normal: Vec4,
    dielectric: Vec4,
    emission: Vec4,
    coat_normal: Vec4,
    sheen: Vec4,
    rest: Vec4,
    more: Vec4,
    sent: Vec4,
}

impl Point {
    /// A point that looks along its normal (0, 0, 1) at `cosine` to the eye, in white light of radiance 1 from all around.
    fn in_white_light(cosine: f32, material: usize) -> Self {
        Self {
            normal: Vec4::Z,
            tangent: Vec4::new(1.0, 0.0, 0.0, 1.0),
            uvs: Vec4::ZERO,
            color: Vec4::ONE,
            light: [Vec4::splat(std::f32::consts::PI), Vec4::ONE, Vec4::ONE, Vec4::ONE],
            to_eye: Vec4::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine, material as f32),
        }
    }

    fn mesh_point(&self) -> MeshPoint {
        MeshPoint {
            normal: self.normal.xyz(),
            tangent: self.tangent,
            uv: [self.uvs.xy(), self.uvs.zw()],
            color: self.color,
        }
    }

    fn surface_light(&self) -> SurfaceLight {
        let [irradiance, mirrored, coat_mirrored, through] = self.light.map(Vec4Swizzles::xyz);
        SurfaceLight {
            irradiance,
            mirrored,
            coat_mirrored,
            through,
        }
    }

    fn expected(&self, materials: &[Material]) -> (Substance, Vec3) {
        let made = substance(&materials[self.to_eye.w as usize], &self.mesh_point());
        (
            made,
            sent_radiance(&made, self.to_eye.xyz(), &self.surface_light(), FACETS),
        )
    }
}

/// What the shaders make of points of some materials.
fn found(gpu: &Gpu, materials: &[Material], points: &[Point]) -> Vec<Found> {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("test"),
        source: wgpu::ShaderSource::Wgsl(mirrorball_render::gpu::shader::resolve(PROBE).into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("test"),
        layout: None,
        module: &module,
        entry_point: None,
        compilation_options: wgpu::PipelineCompilationOptions {
            constants: &[("FACETS", 1.0)],
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    });
    let out = Readback::new(gpu, "test: results", size_of::<Found>() as u64 * points.len() as u64);
    let given = gpu.buffer("test: points", points);
    let bindings = gpu.bind(
        "test",
        &pipeline.get_bind_group_layout(0),
        &[given.as_entire_binding(), out.buffer().as_entire_binding()],
    );
    let materials = SceneMaterials::new(gpu, materials).expect("they fit");
    let group = materials.bind(gpu, &pipeline.get_bind_group_layout(1));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.set_bind_group(1, &group, &[]);
        pass.dispatch_workgroups((points.len() as u32).div_ceil(64), 1, 1);
    }
    out.record(&mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let mut items = vec![Found::zeroed(); points.len()];
    out.read(gpu, &mut items).expect("the device works");
    items
}

/// A picture of smooth random texels, `EDGE` along an edge.
fn picture(seed: usize) -> Arc<Image> {
    const EDGE: usize = 16;
    let texel = |i: usize| 255.0 * (0.5 + 0.5 * (spread(i / 4, 0.37 * (seed + i % 4) as f64) * 6.0).sin());
    Arc::new(Image {
        name: format!("{seed}"),
        size_px: [EDGE as u32; 2],
        rgba: (0..4 * EDGE * EDGE).map(|i| texel(i) as u8).collect(),
    })
}

fn texture(seed: usize) -> Texture {
    const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    Texture {
        image: picture(seed),
        uv_set: if seed.is_multiple_of(2) {
            UvSet::First
        } else {
            UvSet::Second
        },
        picture_from_uv: Affine2::from_mat2_translation(
            Mat2::from_angle(seed as f32) * Mat2::from_diagonal(Vec2::new(0.7, 1.3)),
            Vec2::new(0.1 * seed as f32, -0.2),
        ),
        wrap: [WRAPS[seed % 3], WRAPS[seed / 3 % 3]],
    }
}

/// A material that has every texture there is.
fn all_textures() -> Material {
    let normal = |seed, scale| {
        Some(NormalMap {
            texture: texture(seed),
            scale,
        })
    };
    Material {
        base_color: [0.9, 0.8, 0.7],
        opacity: 0.9,
        base_color_texture: Some(texture(0)),
        alpha: Alpha::Blend,
        metallic: 0.8,
        roughness: 0.9,
        metallic_roughness_texture: Some(texture(1)),
        normal: normal(2, 0.8),
        occlusion_texture: Some(texture(3)),
        occlusion_strength: 0.6,
        emission: [1.0, 2.0, 3.0],
        emission_texture: Some(texture(4)),
        dielectric_f0: [0.04, 0.05, 0.06],
        dielectric_f90: 0.9,
        specular_texture: Some(texture(5)),
        specular_color_texture: Some(texture(6)),
        transmission: 0.7,
        transmission_texture: Some(texture(7)),
        volume: Volume {
            thickness_m: 0.02,
            thickness_texture: Some(texture(8)),
            ..Volume::default()
        },
        clearcoat: Clearcoat {
            factor: 0.9,
            texture: Some(texture(9)),
            roughness: 0.5,
            roughness_texture: Some(texture(10)),
            normal: normal(11, 1.2),
        },
        sheen: Sheen {
            color: [0.3, 0.4, 0.5],
            color_texture: Some(texture(12)),
            roughness: 0.8,
            roughness_texture: Some(texture(13)),
        },
        ..Material::default()
    }
}

fn random_points(n: usize, n_materials: usize) -> Vec<Point> {
    let number = |i: usize, offset: f64| spread(i, offset) as f32;
    directions(n)
        .enumerate()
        .map(|(i, normal)| {
            let aside = normal.any_orthonormal_vector();
            let cosine = 0.05 + 0.95 * number(i, 0.15);
            let to_eye = cosine * normal + (1.0 - cosine * cosine).sqrt() * normal.cross(aside);
            let light = |offset: f64| {
                Vec4::new(
                    number(i, offset),
                    number(i, offset + 0.1),
                    number(i, offset + 0.23),
                    0.0,
                )
            };
            Point {
                normal: normal.extend(0.0),
                tangent: (aside + 0.2 * normal).extend(if i % 2 == 0 { 1.0 } else { -1.0 }),
                uvs: 4.0 * Vec4::new(number(i, 0.2), number(i, 0.4), number(i, 0.6), number(i, 0.8)) - 2.0,
                color: Vec4::new(0.5 + 0.5 * number(i, 0.9), 1.0, 0.8, 0.9),
                light: [3.0 * light(0.3), light(0.5), light(0.7), light(0.95)],
                to_eye: to_eye.normalize().extend((i % n_materials) as f32),
            }
        })
        .collect()
}

#[test]
fn substances_are_those_of_the_twin() {
    let Some(gpu) = support::gpu() else { return };
    let materials = [all_textures(), Material::default()];
    let points = random_points(600, 2);
    let found = found(&gpu, &materials, &points);
    let mut errors = Vec::new();
    let mut normals = Vec::new();
    for (point, found) in points.iter().zip(&found) {
        let (made, _) = point.expected(&materials);
        errors.extend((found.base_color - made.base_color).to_array());
        errors.extend((found.dielectric - made.dielectric_f0.extend(made.dielectric_f90)).to_array());
        errors.extend((found.sheen - made.sheen.extend(made.sheen_roughness)).to_array());
        errors.extend(((found.emission.xyz() - made.emission) / 3.0).to_array());
        let rest = Vec4::new(made.metallic, made.roughness, made.coat, made.coat_roughness);
        errors.extend((found.rest - rest).to_array());
        errors.extend([
            found.more.x - made.transmission,
            found.more.y - made.thickness_m,
            found.normal.w - made.occlusion,
        ]);
        normals.push(found.normal.xyz().angle_between(made.normal));
        normals.push(found.coat_normal.xyz().angle_between(made.coat_normal));
    }
    // Adapters weigh texels in 1/256ths and may round the sampled value to 8 bits; normals are divided by their length,
    // which pictures of random values make short.
    let errors = Errors::of("substance", errors);
    assert!(errors.mean < 0.002 && errors.worst < 0.02, "{errors:?}");
    let normals = Errors::of("normals, radians", normals);
    assert!(normals.mean < 0.01 && normals.worst < 0.3, "{normals:?}");
}

/// Materials with every layer at many strengths.
fn layered() -> Vec<Material> {
    let mut all = Vec::new();
    for i in 0..60 {
        let number = |offset: f64| spread(i, offset) as f32;
        let dielectric = if i % 5 == 0 { 0.0 } else { 0.04 };
        all.push(Material {
            model: if i % 10 == 3 {
                Model::GlossInAlpha
            } else {
                Model::MetallicRoughness
            },
            base_color: [number(0.1), number(0.2), number(0.3)],
            opacity: number(0.35),
            metallic: [0.0, 1.0, number(0.4)][i % 3],
            roughness: number(0.5),
            dielectric_f0: [dielectric, 0.8 * dielectric, dielectric],
            dielectric_f90: if i % 5 == 0 { 0.0 } else { 1.0 },
            emission: [number(0.6), 0.0, 0.1],
            transmission: [0.0, number(0.7)][i % 2],
            clearcoat: Clearcoat {
                factor: [0.0, number(0.8)][i / 2 % 2],
                roughness: number(0.9),
                ..Clearcoat::default()
            },
            sheen: Sheen {
                color: [[0.0; 3], [number(0.15), 0.5, 0.9]][i / 4 % 2],
                roughness: number(0.25),
                ..Sheen::default()
            },
            ..Material::default()
        });
    }
    all
}

#[test]
fn radiance_is_that_of_the_twin() {
    let Some(gpu) = support::gpu() else { return };
    let materials = layered();
    let points = random_points(3000, materials.len());
    let found = found(&gpu, &materials, &points);
    let errors = Errors::of(
        "radiance",
        points.iter().zip(&found).map(|(point, found)| {
            let (_, expected) = point.expected(&materials);
            (found.sent.xyz() - expected).abs().max_element()
        }),
    );
    // Light is at most 1 here; the table holds albedos every 1/64 of the cosine and every 1/32 of the roughness.
    assert!(errors.mean < 0.001 && errors.worst < 0.02, "{errors:?}");
}

/// In light that comes from everywhere alike, what keeps all light cannot be seen.
#[test]
fn white_materials_keep_the_light_and_none_makes_any() {
    let Some(gpu) = support::gpu() else { return };
    let mut materials = Vec::new();
    for step in 0..=10 {
        let roughness = step as f32 / 10.0;
        let metal = Material {
            metallic: 1.0,
            roughness,
            ..Material::default()
        };
        let glossy = Material {
            roughness,
            dielectric_f0: [0.04; 3],
            dielectric_f90: 1.0,
            ..Material::default()
        };
        let glass = Material {
            transmission: 1.0,
            ..glossy.clone()
        };
        let coated = Material {
            clearcoat: Clearcoat {
                factor: 1.0,
                roughness: 1.0 - roughness,
                ..Clearcoat::default()
            },
            ..glossy.clone()
        };
        let cloth = Material {
            sheen: Sheen {
                color: [1.0; 3],
                roughness,
                ..Sheen::default()
            },
            ..glossy.clone()
        };
        materials.extend([metal, glossy, glass, coated, cloth]);
    }
    let cosines: Vec<f32> = (1..=20).map(|i| i as f32 / 20.0).collect();
    let points: Vec<Point> = (0..materials.len())
        .flat_map(|material| {
            cosines
                .iter()
                .map(move |&cosine| Point::in_white_light(cosine, material))
        })
        .collect();
    let found = found(&gpu, &materials, &points);
    let kept = found.iter().map(|found| found.sent.x - 1.0);
    let errors = Errors::of("light kept, less 1", kept);
    assert!(errors.worst < 0.005, "{errors:?}");
    // Without what facets pass on to each other a rough metal would lose more than a third.
    let single = mirrorball_render::directional_albedo::albedo(1.0, 1.0);
    assert!(single.scale + single.offset < 0.7, "{single:?}");
}
