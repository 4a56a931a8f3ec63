// Irradiance as Supan 2006 (3.4.1) approximates it: each face of a small cube blurred as a picture, four taps along rows,
// then along columns, again and again. CPU twin: src/reference/separable_blur.rs. One workgroup per face.

// A face of 32 × 32 texels; a thread takes four of a row.
@group(0) @binding(0) var source: texture_2d_array<f32>;
@group(0) @binding(1) var out: texture_storage_2d_array<rgba16float, write>;

const SIZE: i32 = 32;
const ITERATIONS: i32 = 24;

var<workgroup> texels: array<array<vec3f, 32>, 32>;

// Taps at -1.5, -0.5, 0.5 and 1.5 texels lie between two texels each: five texels by 1, 2, 2, 2, 1 eighths.
fn tap(at: vec2i, step: vec2i) -> vec3f {
    var sum = vec3f(0.0);
    for (var i = -2; i <= 2; i++) {
        // At the edge of the picture the last texel repeats.
        let place = clamp(at + i * step, vec2i(0), vec2i(SIZE - 1));
        sum += select(0.25, 0.125, abs(i) == 2) * texels[place.y][place.x];
    }
    return sum;
}

@compute @workgroup_size(8, 32, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) lane: vec3u) {
    let at = vec2i(i32(lane.x) * 4, i32(lane.y));
    for (var i = 0; i < 4; i++) {
        texels[at.y][at.x + i] = textureLoad(source, at + vec2i(i, 0), group.x, 0).rgb;
    }
    for (var pass_index = 0; pass_index < 2 * ITERATIONS; pass_index++) {
        let step = select(vec2i(0, 1), vec2i(1, 0), pass_index % 2 == 0);
        workgroupBarrier();
        var blurred: array<vec3f, 4>;
        for (var i = 0; i < 4; i++) {
            blurred[i] = tap(at + vec2i(i, 0), step);
        }
        workgroupBarrier();
        for (var i = 0; i < 4; i++) {
            texels[at.y][at.x + i] = blurred[i];
        }
    }
    for (var i = 0; i < 4; i++) {
        let irradiance = min(3.1415927 * texels[at.y][at.x + i], vec3f(60000.0));
        textureStore(out, at + vec2i(i, 0), group.x, vec4f(irradiance, 1.0));
    }
}
