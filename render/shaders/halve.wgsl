// A mip from the one above it: the mean of four texels, of what there is at the far edges.

@group(0) @binding(0) var above: texture_2d<f32>;
@group(0) @binding(1) var out: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(out)) {
        return;
    }
    let last = textureDimensions(above) - 1u;
    var sum = vec4f(0.0);
    for (var i = 0u; i < 4u; i++) {
        sum += textureLoad(above, min(2u * at.xy + vec2u(i & 1u, i >> 1u), last), 0);
    }
    textureStore(out, at.xy, 0.25 * sum);
}
