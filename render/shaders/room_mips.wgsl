// A mip of the rooms around all objects from the one above it: the mean of four texels, all layers at once.

@group(0) @binding(0) var above: texture_2d_array<f32>;
@group(0) @binding(1) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(out)) {
        return;
    }
    var sum = vec4f(0.0);
    for (var i = 0u; i < 4u; i++) {
        sum += textureLoad(above, 2u * at.xy + vec2u(i & 1u, i >> 1u), at.z, 0);
    }
    textureStore(out, at.xy, at.z, 0.25 * sum);
}
