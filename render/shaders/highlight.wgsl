// What of a radiance cube is brighter than a threshold, for the highlights of plastics. CPU twin: src/reference/highlight.rs.

// x: threshold in means of the light.
@group(0) @binding(0) var<uniform> threshold: vec4f;
@group(0) @binding(1) var source: texture_2d_array<f32>;
// Nine coefficients of the light, rgb.
@group(0) @binding(2) var<storage, read> harmonics: array<vec4f>;
@group(0) @binding(3) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    if any(texel.xy >= textureDimensions(out)) {
        return;
    }
    let luminance = vec3f(0.2126, 0.7152, 0.0722);
    // The mean over the sphere is c00 Y00.
    let dark = threshold.x * 0.2820948 * dot(luminance, harmonics[0].rgb);
    let found = textureLoad(source, texel.xy, texel.z, 0);
    let bright = dot(luminance, found.rgb);
    let kept = max(bright - dark, 0.0) / max(bright, 1e-9);
    textureStore(out, texel.xy, texel.z, vec4f(kept * found.rgb, found.a));
}
