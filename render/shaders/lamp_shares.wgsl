// The share of each virtual lamp's light that reaches a surface past all objects, by a few rays per pixel. The pixels of a
// 4 × 4 tile look at different places on a lamp; `lamp_light` puts them together.

#import bvh
#import scene_ray
#import sampling
#import lamp
#import lamp_ray

@group(0) @binding(4) var<uniform> lamps: Lamps;
// Place and normal of the surface that a pixel shows; place's w: 0 where there is none.
@group(0) @binding(5) var places: texture_2d<f32>;
@group(0) @binding(6) var normals: texture_2d<f32>;
// Four lamps per layer.
@group(0) @binding(7) var out: texture_storage_2d_array<rgba16float, write>;

const RAYS = 4u;
// Rays start so far off the surface, metres: more than a rasterised place is wrong, less than a shadow's edge shows.
const START_M = 3e-4;

fn is_blocked(origin: vec3f, direction: vec3f, reach_m: f32) -> bool {
    for (var i = 0u; i < arrayLength(&instances); i++) {
        let root = instances[i].facts.x;
        if instances[i].facts.y == 0u || root == NO_ROOT {
            continue;
        }
        let start = (instances[i].object_from_world * vec4f(origin, 1.0)).xyz;
        let way = (instances[i].object_from_world * vec4f(direction, 0.0)).xyz;
        let scale = length(way);
        let towards = way / scale;
        let sphere = instances[i].sphere_m;
        let to_center = sphere.xyz - start;
        let along = dot(to_center, towards);
        let off2 = dot(to_center, to_center) - along * along;
        if off2 > sphere.w * sphere.w || along < -sphere.w || along - sphere.w > reach_m * scale {
            continue;
        }
        if any_hit(root, start, towards, reach_m * scale) {
            return true;
        }
    }
    return false;
}

// What a pixel spans of its surface along one axis of the picture, metres: towards the neighbour that lies on it.
fn span(pixel: vec2i, step: vec2i, place: vec3f, normal: vec3f) -> vec3f {
    for (var side = 1; side >= -1; side -= 2) {
        let at = pixel + side * step;
        if any(at < vec2i(0)) || any(at >= vec2i(textureDimensions(places))) {
            continue;
        }
        let there = textureLoad(places, at, 0);
        let between = there.xyz - place;
        if there.w > 0.0 && abs(dot(between, normal)) < 0.2 * length(between) {
            return f32(side) * between;
        }
    }
    return vec3f(0.0);
}

// Share of lamp `index` that is seen from all over a pixel.
fn share_of(index: u32, tile: u32, place: vec3f, normal: vec3f, spans: array<vec3f, 2>) -> f32 {
    // A grid turned so that no two of its points share a row or a column.
    const OFFSETS = array(vec2f(-0.125, -0.375), vec2f(0.375, -0.125), vec2f(-0.375, 0.125), vec2f(0.125, 0.375));
    let lamp = lamps.all[index];
    var offsets = OFFSETS;
    var all = 0.0;
    var seen = 0.0;
    for (var i = 0u; i < RAYS; i++) {
        let ray = lamp_ray(lamp, place, sample_2d(RAYS * tile + i, index, 0u));
        let arriving = ray.strength * max(dot(ray.towards, normal), 0.0);
        all += arriving;
        if arriving <= 0.0 {
            continue;
        }
        let origin = place + offsets[i].x * spans[0] + offsets[i].y * spans[1] + START_M * normal;
        seen += select(arriving, 0.0, is_blocked(origin, ray.towards, ray.reach_m));
    }
    return seen / max(all, 1e-20);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var shares = array<vec4f, 2>();
    if place.w > 0.0 {
        let normal = textureLoad(normals, at.xy, 0).xyz;
        let spans = array(
            span(vec2i(at.xy), vec2i(1, 0), place.xyz, normal),
            span(vec2i(at.xy), vec2i(0, 1), place.xyz, normal),
        );
        let tile = (at.x & 3u) + 4u * (at.y & 3u);
        for (var i = 0u; i < lamps.counts.x; i++) {
            shares[i / 4u][i % 4u] = share_of(i, tile, place.xyz, normal, spans);
        }
    }
    textureStore(out, at.xy, 0, shares[0]);
    textureStore(out, at.xy, 1, shares[1]);
}
