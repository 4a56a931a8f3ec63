// A texture, small, over a part of the finished picture. Each pixel takes the texel at its place.

#import camera
#import srgb

struct Tile {
    place_px: vec4u,
    parameters: vec4u,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> tile: Tile;
// One layer, or the six faces of a cube.
@group(0) @binding(2) var source: texture_2d_array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<u32>;

fn source_at(pixel: vec2u) -> vec4f {
    let n_layers = textureNumLayers(source);
    let faces = select(vec2u(1u), vec2u(3u, 2u), n_layers == 6u);
    let size = textureDimensions(source);
    let at = (2u * pixel + 1u) * size * faces / (2u * tile.place_px.zw);
    let face = at / size;
    return textureLoad(source, at % size, face.y * faces.x + face.x, 0);
}

// Linear light of the display; the numbers are those of `How` in src/passes/inset.rs.
fn shown(value: vec4f) -> vec3f {
    let exposure = camera.signal_per_radiance.y;
    switch tile.parameters.y {
        case 0u: { return exposure * value.rgb; }
        case 1u: { return exposure * 0.31830987 * value.rgb; }
        case 2u: { return 0.5 + exposure * 0.31830987 * value.rgb; }
        case 3u: { return 0.5 * value.rgb; }
        case 4u: { return vec3f(value.a); }
        case 5u: { return select(vec3f(0.0), fract(10.0 * value.xyz), value.w > 0.0); }
        default: { return 0.5 + 0.5 * value.xyz; }
    }
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= tile.place_px.zw) {
        return;
    }
    let pixel = tile.place_px.xy + at.xy;
    out[pixel.y * tile.parameters.x + pixel.x] = packed_srgb(shown(source_at(at.xy)));
}
