// Layered attenuation maps (src/shadow/attenuation.rs): the middle of the light's view in layers, and places on the light
// with a depth map each.

struct AttenuationFrame {
    // Where the view from the light's middle stands; w: 1 for an orthographic one.
    origin_m: vec4f,
    // Unit axes of the view; w of the first: half its width, metres, at distance 1 for a perspective one.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    // Edge of all maps, texels; number of places on the light.
    counts: vec4u,
}

struct LightPlace {
    position_m: vec4f,
    clip_from_world: mat4x4f,
    world_from_clip: mat4x4f,
}

// Layers of a texel. Each is two words: its depth as a float (0: free); where in the texel it was met and its normal, see
// `packed_layer`.
const N_LAYERS = 8u;
// How far a surface's point is moved off it before maps are asked, texel widths: half a texel's diagonal and some.
const OFFSET = 1.0;

// Eight bits each of a place within a texel and of a normal folded onto a square (Cigolle et al. 2014, "A survey of efficient
// representations for independent unit vectors").
fn packed_layer(within: vec2f, normal: vec3f) -> u32 {
    let flat = normal.xy / (abs(normal.x) + abs(normal.y) + abs(normal.z));
    let signs = select(vec2f(-1.0), vec2f(1.0), flat >= vec2f(0.0));
    let folded = select((1.0 - abs(flat.yx)) * signs, flat, normal.z >= 0.0);
    return pack4x8unorm(vec4f(within, 0.5 * folded + 0.5));
}

fn packed_normal(word: u32) -> vec3f {
    let folded = 2.0 * unpack4x8unorm(word).zw - 1.0;
    let z = 1.0 - abs(folded.x) - abs(folded.y);
    let signs = select(vec2f(-1.0), vec2f(1.0), folded >= vec2f(0.0));
    return normalize(vec3f(select((1.0 - abs(folded.yx)) * signs, folded, z >= 0.0), z));
}

// Column and row of a point in the map of the light's middle, and its depth, metres.
fn in_map(frame: AttenuationFrame, point: vec3f) -> vec3f {
    let offset = point - frame.origin_m.xyz;
    let depth = dot(offset, frame.forward.xyz);
    let half_width = frame.right.w * select(depth, 1.0, frame.origin_m.w > 0.0);
    let at = vec2f(dot(offset, frame.right.xyz), dot(offset, frame.up.xyz)) / half_width;
    return vec3f((0.5 * at + 0.5) * f32(frame.counts.x), depth);
}

// The point at a column and row of the map, and a depth.
fn from_map(frame: AttenuationFrame, at: vec3f) -> vec3f {
    let half_width = frame.right.w * select(at.z, 1.0, frame.origin_m.w > 0.0);
    let offset = (2.0 * at.xy / f32(frame.counts.x) - 1.0) * half_width;
    return frame.origin_m.xyz + offset.x * frame.right.xyz + offset.y * frame.up.xyz + at.z * frame.forward.xyz;
}

// Width of a texel at a depth, metres.
fn texel_m(frame: AttenuationFrame, depth: f32) -> f32 {
    return 2.0 * frame.right.w * select(depth, 1.0, frame.origin_m.w > 0.0) / f32(frame.counts.x);
}
