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
// Those of the above that lie with the colours (`IS_COLOR` in src/scene_materials.rs), one bit each.
const COLOR_MAPS = 1u << BASE_COLOR_MAP | 1u << EMISSION_MAP | 1u << SPECULAR_MAP | 1u << SPECULAR_COLOR_MAP
    | 1u << SHEEN_COLOR_MAP | 1u << SHEEN_ROUGHNESS_MAP;

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

// Picture of a material, one that it has: a colour or values.
fn map_texel(index: u32, point: MeshPoint, spread: vec2f) -> vec4f {
    let map = materials[point.material].maps[index];
    if (COLOR_MAPS >> index & 1u) == 1u {
        let place = map_place(map, point, spread, textureDimensions(color_maps).x);
        return textureSampleLevel(color_maps, map_sampler, place.xy, map.facts.x, place.z);
    }
    let place = map_place(map, point, spread, textureDimensions(value_maps).x);
    return textureSampleLevel(value_maps, map_sampler, place.xy, map.facts.x, place.z);
}

fn has_map(material: u32, index: u32) -> bool {
    return (materials[material].kinds.w >> index & 1u) == 1u;
}

// Unit normal of a normal map's texel (glTF 2.0, 3.9.3).
fn turned_normal(texel: vec4f, point: MeshPoint, scale: f32) -> vec3f {
    let stored = 2.0 * texel.xyz - 1.0;
    let along = point.tangent.xyz - dot(point.tangent.xyz, point.normal) * point.normal;
    let tangent = along * inverseSqrt(max(dot(along, along), 1e-20));
    let bitangent = cross(point.normal, tangent) * point.tangent.w;
    let turned = scale * (stored.x * tangent + stored.y * bitangent) + stored.z * point.normal;
    return select(point.normal, normalize(turned), dot(turned, turned) > 1e-12);
}

// Unit normal, normal map included.
fn mapped_normal(point: MeshPoint, spread: vec2f) -> vec3f {
    if !has_map(point.material, NORMAL_MAP) {
        return point.normal;
    }
    let scale = materials[point.material].surface.z;
    return turned_normal(map_texel(NORMAL_MAP, point, spread), point, scale);
}

// Base colour and opacity.
fn base_color_at(point: MeshPoint, spread: vec2f) -> vec4f {
    let color = materials[point.material].base_color * point.color;
    if !has_map(point.material, BASE_COLOR_MAP) {
        return color;
    }
    return color * map_texel(BASE_COLOR_MAP, point, spread);
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

// What a point is made of, pictures averaged over `spread` of either set of texture coordinates. A loop over the pictures that
// the material has: most have few, and a shader with one place that reads pictures is much smaller than one with fourteen.
fn substance_over(point: MeshPoint, spread: vec2f) -> Substance {
    let material = materials[point.material];
    var made = bare_substance(point);
    var specular = 1.0;
    for (var left = material.kinds.w; left != 0u; left &= left - 1u) {
        let index = firstTrailingBit(left);
        let texel = map_texel(index, point, spread);
        switch index {
            case BASE_COLOR_MAP: {
                made.base_color *= texel;
            }
            case METALLIC_ROUGHNESS_MAP: {
                made.metallic *= texel.b;
                made.roughness *= texel.g;
            }
            case NORMAL_MAP: {
                made.normal = turned_normal(texel, point, material.surface.z);
            }
            case OCCLUSION_MAP: {
                made.occlusion = 1.0 + material.emission.w * (texel.r - 1.0);
            }
            case EMISSION_MAP: {
                made.emission *= texel.rgb;
            }
            case SPECULAR_MAP: {
                specular = texel.a;
            }
            case SPECULAR_COLOR_MAP: {
                made.dielectric_f0 *= texel.rgb;
            }
            case TRANSMISSION_MAP: {
                made.transmission *= texel.r;
            }
            case THICKNESS_MAP: {
                made.thickness_m *= texel.g;
            }
            case COAT_MAP: {
                made.coat *= texel.r;
            }
            case COAT_ROUGHNESS_MAP: {
                made.coat_roughness *= texel.g;
            }
            case COAT_NORMAL_MAP: {
                made.coat_normal = turned_normal(texel, point, material.coat.z);
            }
            case SHEEN_COLOR_MAP: {
                made.sheen *= texel.rgb;
            }
            case SHEEN_ROUGHNESS_MAP: {
                made.sheen_roughness *= texel.a;
            }
            default: {}
        }
    }
    made.dielectric_f0 *= specular;
    made.dielectric_f90 *= specular;
    made.f0 = mix(made.dielectric_f0, made.base_color.rgb, made.metallic);
    made.f90 = mix(made.dielectric_f90, 1.0, made.metallic);
    return made;
}

// A material's own factors, its pictures left out; `f0` and `f90` are not set.
fn bare_substance(point: MeshPoint) -> Substance {
    let material = materials[point.material];
    var made: Substance;
    made.model = material.kinds.x;
    made.base_color = material.base_color * point.color;
    made.normal = point.normal;
    made.metallic = material.surface.x;
    made.roughness = material.surface.y;
    made.dielectric_f0 = material.dielectric.rgb;
    made.dielectric_f90 = material.dielectric.w;
    made.emission = material.emission.rgb;
    made.occlusion = 1.0;
    made.coat = material.coat.x;
    made.coat_roughness = material.coat.y;
    made.coat_normal = point.normal;
    made.sheen = material.sheen.rgb;
    made.sheen_roughness = material.sheen.w;
    made.transmission = material.glass.x;
    made.ior = material.glass.y;
    made.thickness_m = material.glass.z;
    made.attenuation = material.attenuation;
    return made;
}

// What a point is made of, pictures at their sharpest.
fn substance_at(point: MeshPoint) -> Substance {
    return substance_over(point, vec2f(0.0));
}
