// The next smaller mip of a cube: means of 2 × 2 texels.

@group(0) @binding(0) var source: texture_2d_array<f32>;
@group(0) @binding(1) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    if any(texel.xy >= textureDimensions(out)) {
        return;
    }
    let at = vec2i(texel.xy) * 2;
    let face = i32(texel.z);
    let sum = textureLoad(source, at, face, 0) + textureLoad(source, at + vec2i(1, 0), face, 0)
        + textureLoad(source, at + vec2i(0, 1), face, 0) + textureLoad(source, at + vec2i(1, 1), face, 0);
    textureStore(out, texel.xy, face, 0.25 * sum);
}
