// The nearest depth of every 2 by 2 texels, level by level: what a large part of a shadow map holds at the nearest.

struct Level {
    // x: edge of this level; y: where it starts; z: where the finer one starts; w: 1 for the first, which reads the map.
    place: vec4u,
}

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var depths: texture_depth_2d;
@group(0) @binding(2) var<storage, read_write> nearest: array<f32>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let edge = level.place.x;
    if any(at.xy >= vec2u(edge)) {
        return;
    }
    var least = 1.0;
    for (var i = 0u; i < 4u; i++) {
        let texel = 2u * at.xy + vec2u(i % 2u, i / 2u);
        if level.place.w == 1u {
            least = min(least, textureLoad(depths, min(texel, textureDimensions(depths) - 1u), 0));
        } else {
            least = min(least, nearest[level.place.z + 2u * edge * texel.y + texel.x]);
        }
    }
    nearest[level.place.y + edge * at.y + at.x] = least;
}
