// Camera picture times ratio and lit by virtual lamps, virtual objects over it, in linear light; back through the camera's own response.
// A pixel without virtual object, with ratio 1 and without lamps keeps its code, bit for bit. CPU twin: src/reference/composite.rs.

#import camera
#import response

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> response: array<f32>;
@group(0) @binding(2) var picture: texture_2d<u32>;
@group(0) @binding(3) var virtual_radiance: texture_2d<f32>;
@group(0) @binding(4) var phantom_ratio: texture_2d<f32>;
// One pixel per element, red in the lowest byte.
@group(0) @binding(5) var<storage, read_write> out: array<u32>;
// Radiance that virtual lamps add to real things.
@group(0) @binding(6) var added: texture_2d<f32>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = textureDimensions(picture);
    if any(at.xy >= size) {
        return;
    }
    let code = textureLoad(picture, at.xy, 0).rgb;
    let over = textureLoad(virtual_radiance, at.xy, 0);
    let shaded = textureLoad(phantom_ratio, at.xy, 0);
    let lit = textureLoad(added, at.xy, 0).rgb;
    var ratio = vec3f(1.0);
    if shaded.a > 0.0 {
        ratio = shaded.rgb / shaded.a;
    }
    var codes = code;
    if over.a > 0.0 || any(ratio != vec3f(1.0)) || any(lit > vec3f(0.0)) {
        let linear = vec3f(response[code.r], response[code.g], response[code.b]);
        let signal = camera.signal_per_radiance.xyz * vignetting(camera, vec2f(at.xy));
        let real = (camera.common_from_camera * vec4f(linear / signal, 0.0)).xyz;
        let mixed = (real * ratio + lit) * (1.0 - over.a) + over.rgb;
        let y = (camera.camera_from_common * vec4f(mixed, 0.0)).xyz * signal;
        codes = vec3u(encode(y.r), encode(y.g), encode(y.b));
    }
    out[at.y * size.x + at.x] = codes.r | (codes.g << 8u) | (codes.b << 16u) | (255u << 24u);
}
