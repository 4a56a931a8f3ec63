// What a point of an object is made of (glTF 2.0, 3.9, and its material extensions). Group 1 (src/scene_materials.rs); needs
// `lights`.

@group(1) @binding(0) var<storage, read> materials: array<Material>;
@group(1) @binding(1) var map_sampler: sampler;
// Pictures of colours, decoded from sRGB, and of plain values.
@group(1) @binding(2) var color_maps: texture_2d_array<f32>;
@group(1) @binding(3) var value_maps: texture_2d_array<f32>;
// x, y: factors of the reflectances at normal and at grazing incidence; z: albedo of a white sheen. Columns: cosine to the
// normal; rows: perceptual roughness (src/directional_albedo.rs).
@group(1) @binding(4) var albedos: texture_2d<f32>;

// Models of a material.
const METALLIC_ROUGHNESS = 0u;
const GLOSS_IN_ALPHA = 1u;
const UNLIT = 2u;
// What alpha means.
const OPAQUE = 0u;
const MASK = 1u;
const BLEND = 2u;
// Pictures of a material (`Material::textures` in src/scene/material.rs).
const BASE_COLOR_MAP = 0u;
const METALLIC_ROUGHNESS_MAP = 1u;
const NORMAL_MAP = 2u;
const OCCLUSION_MAP = 3u;
const EMISSION_MAP = 4u;
const SPECULAR_MAP = 5u;
const SPECULAR_COLOR_MAP = 6u;
const TRANSMISSION_MAP = 7u;
const THICKNESS_MAP = 8u;
const COAT_MAP = 9u;
const COAT_ROUGHNESS_MAP = 10u;
const COAT_NORMAL_MAP = 11u;
const SHEEN_COLOR_MAP = 12u;
const SHEEN_ROUGHNESS_MAP = 13u;
const NO_LAYER = 0xffffffffu;

// A point of a mesh as the vertices give it, world frame.
struct MeshPoint {
    // Unit, interpolated, on the eye's side.
    normal: vec3f,
    // xyz: tangent; w: the bitangent's sense.
    tangent: vec4f,
    uv: vec2f,
    uv1: vec2f,
    color: vec4f,
    material: u32,
}

struct Substance {
    // Linear; a: opacity, or what the model makes of it.
    base_color: vec4f,
    // Unit, normal map included.
    normal: vec3f,
    metallic: f32,
    // Perceptual.
    roughness: f32,
    // Reflectance at normal and at grazing incidence, dielectric and metal mixed.
    f0: vec3f,
    f90: f32,
    // Those of the dielectric alone.
    dielectric_f0: vec3f,
    dielectric_f90: f32,
    // Radiance that it sends by itself.
    emission: vec3f,
    // Share of the light from all around that arrives.
    occlusion: f32,
    // Share that is coated, its perceptual roughness, its unit normal.
    coat: f32,
    coat_roughness: f32,
    coat_normal: vec3f,
    // Linear colour and perceptual roughness of the sheen.
    sheen: vec3f,
    sheen_roughness: f32,
    // Share of the light that enters and goes through.
    transmission: f32,
    // Index of refraction.
    ior: f32,
    // Thickness below the surface, metres; 0 for a thin wall.
    thickness_m: f32,
    // xyz: colour of white light after the distance w, metres.
    attenuation: vec4f,
    model: u32,
}

// A unit normal on the eye's side: one seen from behind (an open mesh), or turned away at the outline by interpolation or by
// a normal map, is bent into the outline.
fn turned_to_eye(normal: vec3f, to_eye: vec3f) -> vec3f {
    let cosine = dot(normal, to_eye);
    return select(normal, normalize(normal - 1.01 * cosine * to_eye), cosine < 0.0);
}

fn wrapped(x: f32, mode: u32, edge: f32) -> f32 {
    switch mode {
        case 1u: {
            return clamp(abs(x - 2.0 * round(0.5 * x)), edge, 1.0 - edge);
        }
        case 2u: {
            return clamp(x, edge, 1.0 - edge);
        }
        default: {
            return x;
        }
    }
}

// xy: place in a picture; z: mip whose texels are as wide as `spread` (of both sets of coordinates, 0 for the sharpest).
fn map_place(map: Map, point: MeshPoint, spread: vec2f, size: u32) -> vec3f {
    let is_second = map.facts.y == 1u;
    let uv = mat2x2f(map.matrix.xy, map.matrix.zw) * select(point.uv, point.uv1, is_second) + map.place.xy;
    let mip = log2(max(select(spread.x, spread.y, is_second) * map.place.z * f32(size), 1.0));
    // The sampler repeats: at mirrored and clamped edges it must not reach over to the other side.
    let edge = min(0.5 * exp2(ceil(mip)) / f32(size), 0.5);
    return vec3f(wrapped(uv.x, map.facts.z, edge), wrapped(uv.y, map.facts.w, edge), mip);
}

// Picture of a colour; white where there is none.
fn color_map(index: u32, point: MeshPoint, spread: vec2f) -> vec4f {
    let map = materials[point.material].maps[index];
    if map.facts.x == NO_LAYER {
        return vec4f(1.0);
    }
    let place = map_place(map, point, spread, textureDimensions(color_maps).x);
    return textureSampleLevel(color_maps, map_sampler, place.xy, map.facts.x, place.z);
}

// Picture of values; all 1 where there is none.
fn value_map(index: u32, point: MeshPoint, spread: vec2f) -> vec4f {
    let map = materials[point.material].maps[index];
    if map.facts.x == NO_LAYER {
        return vec4f(1.0);
    }
    let place = map_place(map, point, spread, textureDimensions(value_maps).x);
    return textureSampleLevel(value_maps, map_sampler, place.xy, map.facts.x, place.z);
}

// Unit normal of a normal map (glTF 2.0, 3.9.3).
fn mapped_normal(index: u32, point: MeshPoint, spread: vec2f, scale: f32) -> vec3f {
    if materials[point.material].maps[index].facts.x == NO_LAYER {
        return point.normal;
    }
    let stored = 2.0 * value_map(index, point, spread).xyz - 1.0;
    let along = point.tangent.xyz - dot(point.tangent.xyz, point.normal) * point.normal;
    let tangent = along * inverseSqrt(max(dot(along, along), 1e-20));
    let bitangent = cross(point.normal, tangent) * point.tangent.w;
    let turned = scale * (stored.x * tangent + stored.y * bitangent) + stored.z * point.normal;
    return select(point.normal, normalize(turned), dot(turned, turned) > 1e-12);
}

// Base colour and opacity.
fn base_color_at(point: MeshPoint, spread: vec2f) -> vec4f {
    return materials[point.material].base_color * point.color * color_map(BASE_COLOR_MAP, point, spread);
}

// Share of a point that there is: 0 behind a surface that is seen from its front alone, 0 or 1 by a mask, else opacity.
fn coverage_at(point: MeshPoint, spread: vec2f, is_front: bool) -> f32 {
    let material = materials[point.material];
    if material.kinds.z == 0u && !is_front {
        return 0.0;
    }
    if material.kinds.y == OPAQUE {
        return 1.0;
    }
    let alpha = base_color_at(point, spread).a;
    return select(alpha, select(0.0, 1.0, alpha >= material.surface.w), material.kinds.y == MASK);
}

// What a point is made of, pictures averaged over `spread` of either set of texture coordinates.
fn substance_over(point: MeshPoint, spread: vec2f) -> Substance {
    let material = materials[point.material];
    var made: Substance;
    made.model = material.kinds.x;
    made.base_color = base_color_at(point, spread);
    made.normal = mapped_normal(NORMAL_MAP, point, spread, material.surface.z);
    let metallic_roughness = value_map(METALLIC_ROUGHNESS_MAP, point, spread);
    made.metallic = material.surface.x * metallic_roughness.b;
    made.roughness = material.surface.y * metallic_roughness.g;
    let specular = color_map(SPECULAR_MAP, point, spread).a;
    made.dielectric_f0 = material.dielectric.rgb * color_map(SPECULAR_COLOR_MAP, point, spread).rgb * specular;
    made.dielectric_f90 = material.dielectric.w * specular;
    made.f0 = mix(made.dielectric_f0, made.base_color.rgb, made.metallic);
    made.f90 = mix(made.dielectric_f90, 1.0, made.metallic);
    made.emission = material.emission.rgb * color_map(EMISSION_MAP, point, spread).rgb;
    made.occlusion = 1.0 + material.emission.w * (value_map(OCCLUSION_MAP, point, spread).r - 1.0);
    made.coat = material.coat.x * value_map(COAT_MAP, point, spread).r;
    made.coat_roughness = material.coat.y * value_map(COAT_ROUGHNESS_MAP, point, spread).g;
    made.coat_normal = mapped_normal(COAT_NORMAL_MAP, point, spread, material.coat.z);
    made.sheen = material.sheen.rgb * color_map(SHEEN_COLOR_MAP, point, spread).rgb;
    made.sheen_roughness = material.sheen.w * color_map(SHEEN_ROUGHNESS_MAP, point, spread).a;
    made.transmission = material.glass.x * value_map(TRANSMISSION_MAP, point, spread).r;
    made.ior = material.glass.y;
    made.thickness_m = material.glass.z * value_map(THICKNESS_MAP, point, spread).g;
    made.attenuation = material.attenuation;
    return made;
}

// What a point is made of, pictures at their sharpest.
fn substance_at(point: MeshPoint) -> Substance {
    return substance_over(point, vec2f(0.0));
}
