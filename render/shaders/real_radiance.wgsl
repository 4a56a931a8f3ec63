// The camera's picture as radiance, times the ratio by which virtual objects change the light on real ones. CPU twin:
// src/reference/real_radiance.rs.

#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> response: array<f32>;
@group(0) @binding(2) var picture: texture_2d<u32>;
@group(0) @binding(3) var phantom_ratio: texture_2d<f32>;
// Radiance that virtual lamps add.
@group(0) @binding(4) var added: texture_2d<f32>;
@group(0) @binding(5) var out: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(picture)) {
        return;
    }
    let code = textureLoad(picture, at.xy, 0).rgb;
    let linear = vec3f(response[code.r], response[code.g], response[code.b]);
    let signal = camera.signal_per_radiance.xyz * vignetting(camera, vec2f(at.xy));
    let real = (camera.common_from_camera * vec4f(linear / signal, 0.0)).xyz;
    let ratio = textureLoad(phantom_ratio, at.xy, 0);
    let lit = select(real, real * ratio.rgb, ratio.a > 0.0) + textureLoad(added, at.xy, 0).rgb;
    textureStore(out, at.xy, vec4f(min(lit, vec3f(60000.0)), 1.0));
}
