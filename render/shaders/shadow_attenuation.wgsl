// The share of the light that arrives, looked up in the layer that the pixel's place is on.

#import attenuation

@group(0) @binding(0) var<uniform> frame: AttenuationFrame;
@group(0) @binding(1) var<storage, read> light_places: array<LightPlace>;
@group(0) @binding(2) var depths: texture_depth_2d_array;
@group(0) @binding(3) var<storage, read> layers: array<u32>;
@group(0) @binding(4) var<storage, read> shares: array<f32>;
@group(0) @binding(5) var places: texture_2d<f32>;
@group(0) @binding(6) var normals: texture_2d<f32>;
@group(0) @binding(7) var visibility: texture_storage_2d<rgba16float, write>;

#import light_places

// Layers as many texel widths from a place are still its own: a surface as steep as this.
const REACH = 3.0;
// Cosine of how far their normals may differ from the place's.
const ALIKE = 0.5;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(visibility, at.xy, vec4f(1.0));
        return;
    }
    let there = in_map(frame, place.xyz);
    let normal = textureLoad(normals, at.xy, 0).xyz;
    var share = 0.0;
    var weights = 0.0;
    if there.z > 0.0 {
        let reach = REACH * texel_m(frame, there.z);
        // Halfway between the middles of four texels.
        let corner = floor(there.xy - 0.5);
        let part = there.xy - 0.5 - corner;
        for (var i = 0u; i < 4u; i++) {
            let step = vec2f(f32(i & 1u), f32(i >> 1u));
            let texel = corner + step;
            if any(texel < vec2f(0.0)) || any(texel >= vec2f(f32(frame.counts.x))) {
                continue;
            }
            let first = (u32(texel.y) * frame.counts.x + u32(texel.x)) * N_LAYERS;
            var nearest = reach;
            var found = -1.0;
            for (var layer = 0u; layer < N_LAYERS; layer++) {
                let depth = layers[2u * (first + layer)];
                if depth == 0u {
                    break;
                }
                let off = abs(bitcast<f32>(depth) - there.z);
                let alike = dot(packed_normal(layers[2u * (first + layer) + 1u]), normal);
                if off < nearest && alike > ALIKE {
                    nearest = off;
                    found = shares[first + layer];
                }
            }
            if found >= 0.0 {
                let sides = mix(1.0 - part, part, step);
                share += sides.x * sides.y * found;
                weights += sides.x * sides.y;
            }
        }
    }
    if weights < 0.999 {
        // At the edge of what the light sees, in a texel with too many layers, or no caster and so on no map.
        let off_m = OFFSET * texel_m(frame, max(there.z, 0.0));
        share = lit_share(place.xyz, normal, off_m, frame.counts.y);
    }
    textureStore(visibility, at.xy, vec4f(vec3f(share), 1.0));
}
