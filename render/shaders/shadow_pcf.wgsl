// A shadow map's comparison (Williams 1978), alone or percentage-closer filtered (Reeves, Salesin, Cook 1987): TAPS by TAPS
// bilinear comparisons a texel apart, which are one comparison for each of the TAPS + 1 by TAPS + 1 texels around.

#import map_view

override TAPS: i32 = 1;

@group(0) @binding(0) var<uniform> atlas: Atlas;
@group(0) @binding(1) var<storage, read> views: array<MapView>;
@group(0) @binding(2) var depths: texture_depth_2d;
@group(0) @binding(3) var places: texture_2d<f32>;
@group(0) @binding(4) var normals: texture_2d<f32>;
@group(0) @binding(5) var visibility: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var share = 1.0;
    if place.w > 0.0 {
        share = share_lit(place.xyz, textureLoad(normals, at.xy, 0).xyz);
    }
    textureStore(visibility, at.xy, vec4f(vec3f(share), 1.0));
}

fn share_lit(point: vec3f, normal: vec3f) -> f32 {
    var face = 0u;
    if atlas.shape.z > 1u {
        face = cube_face(point - views[0].position_m.xyz);
    }
    let seen = seen_from(views[face], atlas.shape.x, point, normal);
    if seen.cosine <= 0.0 {
        // Turned away from the light: in its own shadow.
        return 0.0;
    }
    if !seen.is_seen {
        return 1.0;
    }
    let origin = map_origin(atlas, face);
    let size = i32(atlas.shape.x);
    let bias = depth_bias(seen, 1.0);
    let bias_per_texel = corner_bias(seen);
    if TAPS == 1 {
        return lit_at(depths, origin, size, vec2i(floor(seen.texel)), seen, bias);
    }
    let first = floor(seen.texel - 0.5);
    let beyond = seen.texel - 0.5 - first;
    var sum = 0.0;
    for (var y = 0; y <= TAPS; y++) {
        var row = 0.0;
        for (var x = 0; x <= TAPS; x++) {
            let texel = vec2i(first) + vec2i(x, y) - (TAPS - 1) / 2;
            let offset = abs(vec2f(texel) + 0.5 - seen.texel);
            let away = max(max(offset.x, offset.y) - 0.7, 0.0);
            row += edge_weight(x, beyond.x) * lit_at(depths, origin, size, texel, seen, bias + away * bias_per_texel);
        }
        sum += edge_weight(y, beyond.y) * row;
    }
    return sum / f32(TAPS * TAPS);
}

// How much nearer to the light than the surface's plane a wall at right angles to it is, in depth per texel beyond the
// corner: less is no shadow, or a filter would darken the lit side of every corner. A cone-shaped bias (Burley 2006,
// "Shadow map bias cone and improved soft shadows").
fn corner_bias(seen: Seen) -> f32 {
    let tangent = slant(seen);
    return (tangent + 1.0 / max(tangent, 0.5)) * texel_depth(seen);
}

// Weight of texel `i` of 0 ..= TAPS: what the bilinear comparisons on both sides give it.
fn edge_weight(i: i32, beyond: f32) -> f32 {
    if i == 0 {
        return 1.0 - beyond;
    }
    return select(1.0, beyond, i == TAPS);
}
