// Many hard shadows from places all over a rectangular light, added up: one batch of maps after the other. Each counts by the
// light that its place gives the surface.

#import map_view

struct Batch {
    // x: first view; y: number of views; z: 1 for the first batch; w: 1 for the last.
    range: vec4u,
}

@group(0) @binding(0) var<uniform> atlas: Atlas;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<storage, read> views: array<MapView>;
@group(0) @binding(3) var depths: texture_depth_2d;
@group(0) @binding(4) var places: texture_2d<f32>;
@group(0) @binding(5) var normals: texture_2d<f32>;
// Per pixel: light that arrives, and that would without casters.
@group(0) @binding(6) var<storage, read_write> sums: array<vec2f>;
@group(0) @binding(7) var visibility: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size_px = textureDimensions(places);
    if any(at.xy >= size_px) {
        return;
    }
    let index = at.y * size_px.x + at.x;
    var sum = vec2f(0.0);
    if batch.range.z == 0u {
        sum = sums[index];
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w > 0.0 {
        sum += batch_sum(place.xyz, textureLoad(normals, at.xy, 0).xyz);
    }
    if batch.range.w == 1u {
        var share = select(0.0, sum.x / max(sum.y, 1e-30), sum.y > 0.0);
        share = select(1.0, share, place.w > 0.0);
        textureStore(visibility, at.xy, vec4f(vec3f(share), 1.0));
    } else {
        sums[index] = sum;
    }
}

fn batch_sum(point: vec3f, normal: vec3f) -> vec2f {
    var sum = vec2f(0.0);
    for (var i = 0u; i < batch.range.y; i++) {
        let view = views[batch.range.x + i];
        let to_light = view.position_m.xyz - point;
        let squared = dot(to_light, to_light);
        let weight = max(dot(normal, to_light), 0.0) * max(-dot(view.forward.xyz, to_light), 0.0) / (squared * squared);
        if weight > 0.0 {
            sum += weight * vec2f(share_lit(i, view, point, normal), 1.0);
        }
    }
    return sum;
}

fn share_lit(i: u32, view: MapView, point: vec3f, normal: vec3f) -> f32 {
    let seen = seen_from(view, atlas.shape.x, point, normal);
    if !seen.is_seen {
        return 1.0;
    }
    let texel = vec2i(floor(seen.texel));
    return lit_at(depths, map_origin(atlas, i), i32(atlas.shape.x), texel, seen, depth_bias(seen, 0.5));
}
