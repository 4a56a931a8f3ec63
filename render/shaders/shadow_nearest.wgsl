// The nearest depth of every 2 by 2 texels, level by level: what a large part of a shadow map holds at the nearest.

// The first level reads the map itself, further ones the level before.
override IS_FIRST: bool = true;

@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var finer: texture_2d<f32>;
@group(0) @binding(2) var nearest: texture_storage_2d<r32float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(nearest)) {
        return;
    }
    var least = 1.0;
    for (var i = 0u; i < 4u; i++) {
        let texel = 2u * at.xy + vec2u(i % 2u, i / 2u);
        if IS_FIRST {
            least = min(least, textureLoad(depths, min(texel, textureDimensions(depths) - 1u), 0));
        } else {
            least = min(least, textureLoad(finer, texel, 0).x);
        }
    }
    textureStore(nearest, at.xy, vec4f(least));
}
