// Virtual objects as radiance: light from afar past all objects, light from near things, reflections.

#import brdf
#import camera
#import lights
#import sh

#import direct
#import material
#import substance_light
#import lamp
#import lamp_shine

@group(0) @binding(8) var specular: texture_cube_array<f32>;
@group(0) @binding(9) var linear_sampler: sampler;
@group(0) @binding(10) var irradiance_cubes: texture_cube_array<f32>;
// Nine coefficients per environment, sixteen apart: all its light.
@group(0) @binding(11) var<uniform> harmonics: array<vec4f, 256>;
// Two layers per environment: radiance, irradiance.
@group(0) @binding(12) var sphere_maps: texture_2d_array<f32>;

// Place of the surface that the light from afar belongs to; w: 1 where there is one.
@group(0) @binding(13) var light_places: texture_2d<f32>;
// xyz: its normal; w: index of the object.
@group(0) @binding(14) var light_normals: texture_2d<f32>;
// What rays from the surface have found: mean radiance over the lobe around the mirrored direction.
@group(0) @binding(15) var traced_reflection: texture_2d<f32>;
// Radiance through it, where it is of glass.
@group(0) @binding(16) var traced_refraction: texture_2d<f32>;

// Where diffuse light comes from: 0 lights, 1 irradiance cube, 2 harmonics, 3 sphere map (src/passes/shade.rs).
override DIFFUSE: u32 = 0u;
// Where reflections come from: 0 GGX lobes, 1 Phong lobes, 2 sphere map, 3 rays, 4 GGX lobes in a small cube.
override SPECULAR: u32 = 0u;

// Mips of the specular cube: roughness 0 in the first, 1 in the last.
const LAST_SPECULAR_MIP: f32 = 5.0;
// Its mip of 16 texels.
const SMALL_CUBE_MIP: f32 = 3.0;
// Steps along a reflected ray: 4 mm to 4 m in 24 of them.
const FIRST_STEP_M: f32 = 0.004;
const STEP_GROWTH: f32 = 1.35;
// Angle of a texel of the specular cube's first mip, radians.
const TEXEL_RAD: f32 = 0.0123;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) @interpolate(flat) object: u32,
    @location(4) @interpolate(flat) material: u32,
    @location(5) uv1: vec2f,
    @location(6) tangent: vec4f,
    @location(7) color: vec4f,
}

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @location(2) normal: vec3f,
    @location(3) material: u32,
    @location(4) uv: vec2f,
    @location(5) uv1: vec2f,
    @location(6) tangent: vec4f,
    @location(7) color: vec4f,
) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let world = (world_from_object * vec4f(position, 1.0)).xyz;
    let direction = (world_from_object * vec4f(normal, 0.0)).xyz;
    let along = (world_from_object * vec4f(tangent.xyz, 0.0)).xyz;
    return Corner(clip_of(camera, world), world, direction, uv, object, material, uv1, vec4f(along, tangent.w), color);
}

// Direction in which environment `slot`, taken at its own place, shows what a ray from `point` meets. The cube's alpha
// holds distances, so the ray is followed in growing steps until it lies behind what the cube shows there, and the
// crossing is then narrowed by halves (Szirmay-Kalos et al. 2005, "Approximate ray-tracing on the GPU with distance
// impostors", with a search in place of their secant).
fn parallax_corrected(slot: u32, point: vec3f, direction: vec3f) -> vec3f {
    let from_center = point - environments[slot].position_m.xyz;
    var before = 0.0;
    var after = FIRST_STEP_M;
    for (var i = 0; i < 24; i++) {
        let place = from_center + direction * after;
        if dot(place, place) > pow(textureSampleLevel(specular, linear_sampler, place, slot, 0.0).a, 2.0) {
            break;
        }
        before = after;
        after *= STEP_GROWTH;
    }
    for (var i = 0; i < 6; i++) {
        let middle = 0.5 * (before + after);
        let place = from_center + direction * middle;
        if dot(place, place) > pow(textureSampleLevel(specular, linear_sampler, place, slot, 0.0).a, 2.0) {
            after = middle;
        } else {
            before = middle;
        }
    }
    return from_center + direction * after;
}

// Where a sphere map in eye space shows what a surface half way between the two directions mirrors (Supan 2006, eq. 2.8 to
// 2.11).
fn sphere_map_at(direction: vec3f, to_eye: vec3f) -> vec2f {
    let half_vector = normalize((camera.camera_from_world * vec4f(direction + to_eye, 0.0)).xyz);
    // The camera's y points down, as the map's rows do.
    return 0.5 * half_vector.xy + 0.5;
}

// Irradiance of all the light around environment `slot`, from a map; nothing shades it.
fn mapped_irradiance(slot: u32, normal: vec3f, to_eye: vec3f) -> vec3f {
    if DIFFUSE == 1u {
        return textureSampleLevel(irradiance_cubes, linear_sampler, normal, slot, 0.0).rgb;
    }
    if DIFFUSE == 3u {
        return textureSampleLevel(sphere_maps, linear_sampler, sphere_map_at(normal, to_eye), 2u * slot + 1u, 0.0).rgb;
    }
    let basis = sh_basis(normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * harmonics[16u * slot + i].rgb;
    }
    return max(sum, vec3f(0.0));
}

// Where the light on a point is stored.
struct LightPixel {
    at: vec2i,
    // Whether it is the light of the same object: not where something half transparent is in front of or behind another.
    is_own: bool,
}

// The pixel at or next to `pixel` whose light from afar is that of `point`: at an outline or an edge the pixel's own may
// belong to another surface, or to none.
fn light_pixel(pixel: vec2u, point: vec3f, normal: vec3f, object: u32) -> LightPixel {
    const OTHER_OBJECT = 1e3;
    var best = vec2i(pixel);
    var least = 1e9;
    let size = vec2i(textureDimensions(light_places));
    for (var dy = -1; dy <= 1; dy++) {
        for (var dx = -1; dx <= 1; dx++) {
            let at = vec2i(pixel) + vec2i(dx, dy);
            if any(at < vec2i(0)) || any(at >= size) {
                continue;
            }
            let there = textureLoad(light_places, at, 0);
            let normal_there = textureLoad(light_normals, at, 0);
            let turned = 1.0 - dot(normal_there.xyz, normal);
            // The pixel itself goes first where it is as near as its neighbours; another side of the object goes last.
            let off = distance(there.xyz, point) + 0.1 * turned + select(1e-5, 0.0, dx == 0 && dy == 0)
                + select(OTHER_OBJECT, 0.0, normal_there.w == f32(object)) + 1e6 * (1.0 - there.w);
            if off < least {
                least = off;
                best = at;
            }
        }
    }
    return LightPixel(best, least < OTHER_OBJECT);
}

// Share of the light from afar that virtual objects let through. Real things are in the map already.
fn share_past_virtual(pixel: vec2i) -> vec3f {
    let without = textureLoad(light_without, pixel, 0).rgb;
    return (textureLoad(light_with, pixel, 0).rgb + 1e-6) / (without + 1e-6);
}

// Mip of the specular cube for a perceptual roughness.
fn specular_mip(roughness: f32) -> f32 {
    if SPECULAR == 0u || SPECULAR >= 3u {
        return clamp(roughness, 0.0, 1.0) * LAST_SPECULAR_MIP;
    }
    // Exponents are 4 ^ (last mip - mip) (src/passes/prefilter_phong.rs).
    let alpha = max(roughness * roughness, 1e-3);
    let exponent = 0.5 * (1.0 / (alpha * alpha) - 1.0);
    return clamp(LAST_SPECULAR_MIP - 0.5 * log2(max(exponent, 1e-3)), 0.0, LAST_SPECULAR_MIP);
}

// Radiance from around the mirrored direction.
fn reflected_radiance(slot: u32, point: vec3f, mirrored: vec3f, roughness: f32) -> vec3f {
    if SPECULAR == 2u {
        let to_eye = normalize(camera.position_m.xyz - point);
        return textureSampleLevel(sphere_maps, linear_sampler, sphere_map_at(mirrored, to_eye), 2u * slot, 0.0).rgb;
    }
    if SPECULAR == 4u {
        let mip = max(specular_mip(roughness), SMALL_CUBE_MIP);
        return textureSampleLevel(specular, linear_sampler, mirrored, slot, mip).rgb;
    }
    let towards = parallax_corrected(slot, point, mirrored);
    return textureSampleLevel(specular, linear_sampler, towards, slot, specular_mip(roughness)).rgb;
}

// Irradiance on a point, virtual lamps included.
fn irradiance_on(corner: Corner, made: Substance, to_eye: vec3f) -> vec3f {
    let slot = objects[corner.object].environment.x;
    let lit = light_pixel(vec2u(corner.clip.xy), corner.position, made.normal, corner.object);
    if !lit.is_own {
        // All the light around the object, without shadows.
        return made.occlusion * mapped_irradiance(slot, made.normal, to_eye);
    }
    // Lights that are nowhere else: no environment holds a lamp.
    if DIFFUSE == 0u {
        // Harmonics stand in where no pixel has followed the light from near things: a thing too thin for one.
        let near = textureLoad(light_near, lit.at, 0);
        let around = select(near_irradiance(slot, made.normal), near.rgb, near.a > 0.0) + textureLoad(light_with, lit.at, 0).rgb;
        return made.occlusion * around + textureLoad(light_lamps, lit.at, 0).rgb;
    }
    let around = mapped_irradiance(slot, made.normal, to_eye) * share_past_virtual(lit.at);
    return made.occlusion * around + textureLoad(light_lamps, lit.at, 0).rgb;
}

// Radiance from around the mirrored direction: what rays have found, or what the surroundings' map shows where the pixel's
// rays belong to another object.
fn mirrored_light(corner: Corner, made: Substance, to_eye: vec3f, roughness: f32) -> vec3f {
    let lit = light_pixel(vec2u(corner.clip.xy), corner.position, made.normal, corner.object);
    if SPECULAR == 3u && lit.is_own {
        return textureLoad(traced_reflection, lit.at, 0).rgb;
    }
    let slot = objects[corner.object].environment.x;
    return reflected_radiance(slot, corner.position, reflect(-to_eye, made.normal), roughness);
}

// Radiance of the virtual lamps that a surface and its coat mirror. The metal's and the dielectric's highlights are one, its
// reflectance between theirs.
fn mirrored_lamps(corner: Corner, made: Substance, to_eye: vec3f, least_roughness: f32) -> vec3f {
    let lit = light_pixel(vec2u(corner.clip.xy), corner.position, made.normal, corner.object);
    let alpha = pow(max(made.roughness, least_roughness), 2.0);
    if made.model == GLOSS_IN_ALPHA {
        let mirror = Gloss(made.normal, to_eye, alpha, vec3f(1.0), 1.0);
        return made.base_color.rgb * (1.0 - made.base_color.a) * lamp_highlights(lit.at, corner.position, mirror);
    }
    var radiance = lamp_highlights(lit.at, corner.position, Gloss(made.normal, to_eye, alpha, made.f0, made.f90));
    if made.coat > 0.0 {
        let coat_alpha = pow(max(made.coat_roughness, least_roughness), 2.0);
        let coat = Gloss(made.coat_normal, to_eye, coat_alpha, vec3f(0.04), 1.0);
        let coat_cosine = clamp(dot(made.coat_normal, to_eye), 0.0, 1.0);
        // As in substance_light.wgsl: what the coat reflects does not come to the base.
        radiance *= 1.0 - made.coat * layer_albedo(vec3f(0.04), 1.0, made.coat_roughness, coat_cosine);
        radiance += made.coat * lamp_highlights(lit.at, corner.position, coat);
    }
    return radiance;
}

fn virtual_radiance(corner: Corner, point: MeshPoint, spread: vec2f, swept_rad: f32) -> vec3f {
    let slot = objects[corner.object].environment.x;
    let to_eye = normalize(camera.position_m.xyz - corner.position);
    var made = substance_over(point, spread);
    if made.model == UNLIT {
        // The signal that is the colour: the finished picture has the lens's darkening in it.
        return made.base_color.rgb / (camera.signal_per_radiance.y * vignetting(camera, corner.clip.xy - 0.5));
    }
    made.normal = turned_to_eye(made.normal, to_eye);
    made.coat_normal = turned_to_eye(made.coat_normal, to_eye);
    // What a pixel's reflection sweeps is no sharper than a lobe as wide: its deviation is 0.29 of the sweep, that of a
    // reflected GGX lobe about 3 alpha.
    let least_roughness = sqrt(0.1 * max(swept_rad - TEXEL_RAD, 0.0));
    let roughness = max(made.roughness, least_roughness);
    var light = SurfaceLight(vec3f(0.0), vec3f(0.0), vec3f(0.0), vec3f(0.0));
    if made.metallic < 1.0 || largest(made.sheen) > 0.0 {
        light.irradiance = irradiance_on(corner, made, to_eye);
    }
    if largest(made.f0) > 0.0 || made.f90 > 0.0 || made.model == GLOSS_IN_ALPHA {
        light.mirrored = made.occlusion * mirrored_light(corner, made, to_eye, roughness);
    }
    if made.coat > 0.0 {
        let mirrored = reflect(-to_eye, made.coat_normal);
        light.coat_mirrored = made.occlusion * reflected_radiance(slot, corner.position, mirrored, max(made.coat_roughness, least_roughness));
    }
    if made.transmission > 0.0 {
        // KHR_materials_volume: Beer's law along the surface's own thickness.
        let kept = pow(max(made.attenuation.rgb, vec3f(1e-6)), vec3f(made.thickness_m / made.attenuation.w));
        let lit = light_pixel(vec2u(corner.clip.xy), corner.position, made.normal, corner.object);
        light.through = kept * textureLoad(traced_refraction, lit.at, 0).rgb;
    }
    return sent_radiance(made, to_eye, light) + mirrored_lamps(corner, made, to_eye, least_roughness);
}

// Radiance times coverage, and coverage.
@fragment
fn fragment(corner: Corner, @builtin(front_facing) is_front: bool) -> @location(0) vec4f {
    let to_eye = normalize(camera.position_m.xyz - corner.position);
    let interpolated = normalize(corner.normal);
    // The sweep is long and thin at outlines and bent edges, the lobe round: its width is between the two.
    let mirrored = reflect(-to_eye, interpolated);
    let swept_rad = sqrt(length(dpdx(mirrored)) * length(dpdy(mirrored)));
    let spread = vec2f(
        max(length(dpdx(corner.uv)), length(dpdy(corner.uv))),
        max(length(dpdx(corner.uv1)), length(dpdy(corner.uv1))),
    );
    let normal = turned_to_eye(interpolated, to_eye);
    let point = MeshPoint(normal, corner.tangent, corner.uv, corner.uv1, corner.color, corner.material);
    let coverage = coverage_at(point, spread, is_front);
    if coverage <= 0.0 {
        discard;
    }
    return coverage * vec4f(min(virtual_radiance(corner, point, spread, swept_rad), vec3f(60000.0)), 1.0);
}
