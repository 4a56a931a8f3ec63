// Camera picture times ratio and lit by virtual lamps, virtual objects over it, in linear light; back through the camera's own
// response. A pixel without virtual object, with ratio 1 and without lamps keeps its code, bit for bit. CPU twins:
// src/reference/composite.rs and, for the noise that a changed pixel lacks, src/reference/noise.rs.

#import camera
#import noise
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
@group(0) @binding(7) var<uniform> noise: Noise;

// Variance that the picture's own noise has in the mixed signal: the real light, with the noise of the codes `code`, counts
// `weight` times there, in the common RGB. A code at the end of the scale has lost its noise.
fn carried_variance(code: vec3u, linear: vec3f, weight: vec3f, signal: vec3f) -> vec3f {
    let variance = select(noise.shot.xyz * linear + noise.read.xyz, vec3f(0.0), code == vec3u(255u));
    var carried = vec3f(0.0);
    for (var channel = 0; channel < 3; channel++) {
        let light = weight * camera.common_from_camera[channel].xyz / signal[channel];
        let gain = (camera.camera_from_common * vec4f(light, 0.0)).xyz * signal;
        carried += gain * gain * variance[channel];
    }
    return carried;
}

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
    // Where there is no phantom the light stays as it is.
    let ratio = shaded.rgb + (1.0 - shaded.a);
    var codes = code;
    if over.a > 0.0 || any(ratio != vec3f(1.0)) || any(lit > vec3f(0.0)) {
        let linear = vec3f(response[code.r], response[code.g], response[code.b]);
        let signal = camera.signal_per_radiance.xyz * vignetting(camera, vec2f(at.xy));
        let real = (camera.common_from_camera * vec4f(linear / signal, 0.0)).xyz;
        let weight = ratio * (1.0 - over.a);
        let mixed = real * weight + lit * (1.0 - over.a) + over.rgb;
        var y = (camera.camera_from_common * vec4f(mixed, 0.0)).xyz * signal;
        // Light of this strength would have come with this much noise.
        let wanted = noise.shot.xyz * max(y, vec3f(0.0)) + noise.read.xyz;
        let missing = max(wanted - carried_variance(code, linear, weight, signal), vec3f(0.0));
        y += sqrt(missing) * normals_of(at.xy, noise.frame.x);
        codes = vec3u(encode(y.r), encode(y.g), encode(y.b));
    }
    out[at.y * size.x + at.x] = codes.r | (codes.g << 8u) | (codes.b << 16u) | (255u << 24u);
}
