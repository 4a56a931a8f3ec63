// Light from near things on virtual objects: cosine-distributed rays, other ones in each pixel of a tile of 4 × 4, which
// `dome_filter` puts together. Virtual surfaces on the way pass on their light, and nothing is counted that comes straight
// from afar.

#import camera
#import lights
#import sampling
#import brdf
#import bvh
#import scene_ray
#import far_lights
#import near_scene
#import material
#import hit_substance
#import seen
#import real_memory
#import near_path

// Rays of a pixel.
const RAYS = 8u;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, id.xy, 0);
    if place.w == 0.0 {
        textureStore(out, id.xy, vec4f(0.0));
        return;
    }
    let to_eye = normalize(camera.position_m.xyz - place.xyz);
    var normal = normalize(textureLoad(normals, id.xy, 0).xyz);
    if dot(normal, to_eye) < 0.0 {
        // Seen from behind, or an interpolated normal turned away at the outline.
        normal = normalize(normal - 1.01 * dot(normal, to_eye) * to_eye);
    }
    let axes = basis_around(normal);
    var sum = vec3f(0.0);
    for (var i_ray = 0u; i_ray < RAYS; i_ray++) {
        let ray = rank_in_tile(id.xy) + 16u * i_ray;
        let direction = axes * cosine_direction(sample_2d(ray, 0u, 0u));
        let origin = place.xyz + START_M * normal;
        sum += near_radiance(scene_hit(ALL_OBJECTS, origin, direction, FAR_M), origin, direction, ray);
    }
    textureStore(out, id.xy, vec4f(min(sum * (3.1415927 / f32(RAYS)), vec3f(60000.0)), 1.0));
}
