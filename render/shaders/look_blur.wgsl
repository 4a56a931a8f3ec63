// One line of taps of the camera's blur (src/look/kernel.rs). Runs three times, with three lines. CPU twin:
// src/reference/look_blur.rs.

struct Line {
    // xy: from one tap to the next, pixels; z: taps on each side of the middle; w: unused.
    step: vec4i,
    // Weights from the middle outwards.
    weights: array<vec4f, 5>,
}

@group(0) @binding(0) var<uniform> line: Line;
@group(0) @binding(1) var source: texture_2d<f32>;
@group(0) @binding(2) var out: texture_storage_2d<rgba16float, write>;

// The picture goes on beyond its edge as it is there.
fn texel(at: vec2i) -> vec4f {
    return textureLoad(source, clamp(at, vec2i(0), vec2i(textureDimensions(source)) - 1), 0);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(source)) {
        return;
    }
    let at = vec2i(id.xy);
    let middle = texel(at);
    var sum = line.weights[0].x * middle;
    var is_flat = true;
    for (var i = 1; i <= line.step.z; i++) {
        let before = texel(at - i * line.step.xy);
        let after = texel(at + i * line.step.xy);
        sum += line.weights[i / 4][i % 4] * (before + after);
        is_flat = is_flat && all(before == middle) && all(after == middle);
    }
    // Where there is nothing to blur, not a bit changes: pixels far from virtual objects stay the camera's.
    textureStore(out, at, select(sum, middle, is_flat));
}
