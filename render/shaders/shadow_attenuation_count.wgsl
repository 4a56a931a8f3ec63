// How much of the light sees each layer.
//
// Agrawala et al. count how often a layer was met while the maps were warped. Texels of a map seen aslant land on some texels
// twice and on others never, so here every layer asks all maps instead.

#import attenuation

@group(0) @binding(0) var<uniform> frame: AttenuationFrame;
@group(0) @binding(1) var<storage, read> light_places: array<LightPlace>;
@group(0) @binding(2) var depths: texture_depth_2d_array;
@group(0) @binding(3) var<storage, read> layers: array<u32>;
@group(0) @binding(4) var<storage, read_write> shares: array<f32>;

#import light_places

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = frame.counts.x;
    if any(at.xy >= vec2u(size)) {
        return;
    }
    let first = (at.y * size + at.x) * N_LAYERS;
    for (var layer = 0u; layer < N_LAYERS; layer++) {
        let depth = layers[2u * (first + layer)];
        if depth == 0u {
            return;
        }
        let met = layers[2u * (first + layer) + 1u];
        let point = from_map(frame, vec3f(vec2f(at.xy) + unpack4x8unorm(met).xy, bitcast<f32>(depth)));
        let off_m = OFFSET * texel_m(frame, bitcast<f32>(depth));
        shares[first + layer] = lit_share(point, packed_normal(met), off_m, frame.counts.y);
    }
}
