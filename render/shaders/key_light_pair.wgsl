// Irradiance of one light past its shadow and of all others without, past the real things and past all things. The shadow
// comes from a pinhole view: the pixel there whose place is nearest.

#import dome
#import key_light
#import view

@group(0) @binding(2) var<uniform> key: KeyLight;
@group(0) @binding(3) var<uniform> view: View;
@group(0) @binding(4) var places: texture_2d<f32>;
@group(0) @binding(5) var normals: texture_2d<f32>;
@group(0) @binding(6) var seen_places: texture_2d<f32>;
@group(0) @binding(7) var past_real: texture_2d<f32>;
@group(0) @binding(8) var past_all: texture_2d<f32>;
@group(0) @binding(9) var without: texture_storage_2d<rgba16float, write>;
@group(0) @binding(10) var with_virtual: texture_storage_2d<rgba16float, write>;

// Shares of the key light past the real things and past all; 1 outside the view.
fn shares(place: vec3f) -> vec2f {
    let clip = view.clip_from_world * vec4f(place, 1.0);
    if clip.w <= 0.0 || any(abs(clip.xy) >= vec2f(clip.w)) {
        return vec2f(1.0);
    }
    let pixel = (clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * view.size_px.xy - 0.5;
    let size = vec2i(view.size_px.xy);
    var sum = vec2f(0.0);
    var weight = 0.0;
    let corner = vec2i(floor(pixel));
    let f = pixel - floor(pixel);
    // How much farther than the nearest a neighbour may lie, metres: a pixel at this distance spans about this much.
    let span = 4.0 * clip.w / (view.size_px.x * abs(view.clip_from_world[0][0]) + 1.0);
    for (var i = 0; i < 4; i++) {
        let offset = vec2i(i & 1, i >> 1u);
        let at = clamp(corner + offset, vec2i(0), size - 1);
        let there = textureLoad(seen_places, at, 0);
        let bilinear = mix(1.0 - f.x, f.x, f32(offset.x)) * mix(1.0 - f.y, f.y, f32(offset.y)) + 1e-4;
        let off = distance(there.xyz, place) / span;
        let share = there.w * bilinear / (1.0 + off * off * off * off);
        sum += share * vec2f(textureLoad(past_real, at, 0).x, textureLoad(past_all, at, 0).x);
        weight += share;
    }
    if weight <= 0.0 {
        return vec2f(1.0);
    }
    return sum / weight;
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= frame.sizes.yz) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(without, at.xy, vec4f(0.0));
        textureStore(with_virtual, at.xy, vec4f(0.0));
        return;
    }
    let normal = textureLoad(normals, at.xy, 0).xyz;
    var sum = vec3f(0.0);
    for (var i = 0u; i < frame.counts.x; i++) {
        sum += lights[i].intensity.rgb * unshadowed(lights[i].position_m.xyz, place.xyz, normal);
    }
    let share = shares(place.xyz);
    let direct = unshadowed_key(key, place.xyz, normal);
    textureStore(without, at.xy, vec4f(sum + direct * share.x, 1.0));
    textureStore(with_virtual, at.xy, vec4f(sum + direct * min(share.x, share.y), 1.0));
}
