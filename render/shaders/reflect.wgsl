// What virtual objects mirror, per pixel: the mean radiance over the lobe of the substance around the mirrored direction, each
// direction weighted by the facets that show it to the eye and are not hidden from its light (GGX with Smith's masking; Heitz
// 2014). Shade multiplies it with the lobe's reflectance.

#import bvh
#import scene_ray
#import camera
#import lights
#import sh
#import brdf
#import microfacets
#import material
#import hit_substance
#import sampling
#import pixel_spots
#import seen
#import ray_light
#import real_memory
#import virtual_hit

// xyz: place of the virtual surface; w: 1 where there is one.
@group(0) @binding(13) var places: texture_2d<f32>;
// xyz: normal of the substance; w: perceptual roughness.
@group(0) @binding(14) var gloss: texture_2d<f32>;
// xyz: normal of the mesh; w: index of the object, from 1.
@group(0) @binding(15) var meshes: texture_2d<f32>;
@group(0) @binding(16) var<storage, read> objects: array<Object>;
@group(0) @binding(17) var out: texture_storage_2d<rgba16float, write>;

// Rays per pixel of a rough surface; 16 pixels share a set of points.
const RAYS = 8u;
// Below this a surface is a perfect mirror (src/passes/reflect.rs).
override MIRROR_ROUGHNESS: f32 = 0.05;
// Every ray stands for so many times the solid angle that is its own, so that neighbouring rays overlap (Křivánek and Colbert
// 2008, "Real-time shading with filtered importance sampling").
const OVERLAP = 4.0;
const POINTS = 16u * RAYS;
// Rank of a pixel in its tile: Bayer's order.
const ORDER = array<u32, 16>(0u, 8u, 2u, 10u, 12u, 4u, 14u, 6u, 3u, 11u, 1u, 9u, 15u, 7u, 13u, 5u);

// The direction, turned up where a normal map would have it lead under the surface that it starts on.
fn above(direction: vec3f, normal: vec3f) -> vec3f {
    let height = dot(direction, normal);
    return normalize(direction + max(0.01 - height, 0.0) * normal);
}

// A ray and how much it counts.
struct Weighted {
    beam: Beam,
    weight: f32,
}

// Ray `i` of a mirror: lines spread over the pixel.
fn mirror_ray(shape: PixelShape, here: Spot, mesh_normal: vec3f, i: u32) -> Weighted {
    let spot = spot_of(shape, here, i);
    let from_eye = spot.place - camera.position_m.xyz;
    let spread = shape.width_m / length(from_eye) + 2.0 * shape.turned;
    let direction = above(reflect(normalize(from_eye), spot.normal), mesh_normal);
    let start = spot.place + mesh_normal * (lift_m(spot.place) + shape.rise_m);
    return Weighted(Beam(start, direction, shape.width_m, spread), 1.0);
}

// Ray `i` of a rough surface, drawn from its lobe and as wide as its share of it.
fn rough_ray(here: Spot, mesh_normal: vec3f, alpha: f32, i: u32) -> Weighted {
    let basis = basis_around(here.normal);
    var outgoing = normalize(camera.position_m.xyz - here.place) * basis;
    // Normal maps may turn a surface away from the eye.
    outgoing = normalize(vec3f(outgoing.xy, max(outgoing.z, 1e-3)));
    let out_lambda = smith_lambda(outgoing, alpha);
    let middle = visible_normal(outgoing, alpha, sample_2d(i, 0u, 0u));
    let incoming = reflect(-outgoing, middle);
    let slope = middle.xy / alpha;
    let stretched = dot(slope, slope) + middle.z * middle.z;
    // Density of visible normals over 4 cos of the half angle (Heitz 2018, eq. 3 and 17).
    let density = 1.0 / (3.1415927 * alpha * alpha * stretched * stretched * 4.0 * outgoing.z * (1.0 + out_lambda));
    let own_sr = OVERLAP / (f32(POINTS) * density);
    let direction = above(basis * incoming, mesh_normal);
    let beam = Beam(here.place + mesh_normal * lift_m(here.place), direction, 0.0, min(sqrt(own_sr), 2.0));
    if incoming.z <= 0.0 {
        return Weighted(beam, 0.0);
    }
    return Weighted(beam, (1.0 + out_lambda) / (1.0 + out_lambda + smith_lambda(incoming, alpha)));
}

// Mean radiance over the lobe of the surface that a pixel shows.
fn mirrored_light(pixel: vec2u, place: vec3f) -> vec3f {
    let substance = textureLoad(gloss, pixel, 0);
    let mesh = textureLoad(meshes, pixel, 0);
    let slot = objects[u32(mesh.w + 0.5) - 1u].environment.x;
    let here = Spot(place, substance.xyz);
    let shape = pixel_shape(vec2i(pixel), here);
    let is_mirror = substance.w < MIRROR_ROUGHNESS;
    let first = RAYS * ORDER[(pixel.y & 3u) * 4u + (pixel.x & 3u)];
    var sum = vec3f(0.0);
    var weight = 0.0;
    for (var i = 0u; i < select(RAYS, SPOTS * SPOTS, is_mirror); i++) {
        var ray: Weighted;
        if is_mirror {
            ray = mirror_ray(shape, here, mesh.xyz, i);
        } else {
            ray = rough_ray(here, mesh.xyz, substance.w * substance.w, first + i);
        }
        if ray.weight > 0.0 {
            sum += ray.weight * light_along(ray.beam, slot);
            weight += ray.weight;
        }
    }
    return sum / max(weight, 1e-6);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var radiance = vec3f(0.0);
    if place.w > 0.0 {
        radiance = mirrored_light(at.xy, place.xyz);
    }
    textureStore(out, at.xy, vec4f(min(radiance, vec3f(60000.0)), place.w));
}
