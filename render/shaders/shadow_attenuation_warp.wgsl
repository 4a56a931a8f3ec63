// Every surface that a place on the light sees becomes a layer of the view from the light's middle, unless it is one.

#import attenuation

@group(0) @binding(0) var<uniform> frame: AttenuationFrame;
@group(0) @binding(1) var<storage, read> light_places: array<LightPlace>;
@group(0) @binding(2) var depths: texture_depth_2d_array;
@group(0) @binding(3) var<storage, read_write> layers: array<atomic<u32>>;

// Surfaces of a texel less far apart than this many of its widths are one layer.
const THICKNESS = 1.5;

// The surface that a texel of a place's map shows, world; w: 0 where nothing is.
fn seen(at: vec2i, index: u32) -> vec4f {
    let size = i32(frame.counts.x);
    if any(at < vec2i(0)) || any(at >= vec2i(size)) {
        return vec4f(0.0);
    }
    let depth = textureLoad(depths, at, index, 0);
    if depth >= 1.0 {
        return vec4f(0.0);
    }
    let ndc = (vec2f(at) + 0.5) / f32(size) * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    let point = light_places[index].world_from_clip * vec4f(ndc, depth, 1.0);
    return vec4f(point.xyz / point.w, 1.0);
}

// Way along the surface to one of two neighbours, the nearer one: the other may be another surface's.
fn step_along(from_before: vec4f, point: vec3f, after: vec4f) -> vec3f {
    let back = point - from_before.xyz;
    let ahead = after.xyz - point;
    let is_ahead = after.w > 0.0 && (from_before.w == 0.0 || dot(ahead, ahead) < dot(back, back));
    return select(back, ahead, is_ahead);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = frame.counts.x;
    if any(at.xy >= vec2u(size)) {
        return;
    }
    let texel_there = vec2i(at.xy);
    let point = seen(texel_there, at.z);
    if point.w == 0.0 {
        return;
    }
    let there = in_map(frame, point.xyz);
    if there.z <= 0.0 || any(there.xy < vec2f(0.0)) || any(there.xy >= vec2f(f32(size))) {
        return;
    }
    let texel = vec2u(there.xy);
    let first = (texel.y * size + texel.x) * 2u * N_LAYERS;
    let thickness = THICKNESS * texel_m(frame, there.z);
    for (var layer = 0u; layer < N_LAYERS; layer++) {
        let word = first + 2u * layer;
        // A weak exchange may fail without cause.
        loop {
            let old = atomicLoad(&layers[word]);
            if old != 0u {
                break;
            }
            if atomicCompareExchangeWeak(&layers[word], 0u, bitcast<u32>(there.z)).exchanged {
                let right = step_along(seen(texel_there - vec2i(1, 0), at.z), point.xyz, seen(texel_there + vec2i(1, 0), at.z));
                let down = step_along(seen(texel_there - vec2i(0, 1), at.z), point.xyz, seen(texel_there + vec2i(0, 1), at.z));
                let across = cross(right, down);
                let to_light = frame.origin_m.xyz - point.xyz;
                let size_squared = dot(across, across);
                // Towards the light where a surface is too small to have a slope.
                let normal = select(normalize(to_light), across * inverseSqrt(size_squared), size_squared > 1e-24);
                let turned = select(-normal, normal, dot(normal, to_light) > 0.0);
                atomicStore(&layers[word + 1u], packed_layer(fract(there.xy), turned));
                return;
            }
        }
        if abs(bitcast<f32>(atomicLoad(&layers[word])) - there.z) < thickness {
            return;
        }
    }
    // No room: whoever looks for this surface will not find it and asks the places on the light.
}
