// Sphere maps in eye space (Supan 2006, eq. 2.3): what a mirror ball far before the camera shows of an environment, and
// the same of its irradiance. CPU twin: src/reference/sphere_map.rs.

#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var radiance: texture_cube<f32>;
@group(0) @binding(2) var irradiance: texture_cube<f32>;
@group(0) @binding(3) var linear_sampler: sampler;
// Two layers: radiance, irradiance.
@group(0) @binding(4) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = textureDimensions(out).x;
    if any(texel.xy >= vec2u(size)) {
        return;
    }
    // Half vector in eye space: x right, y up, z to the eye. Beyond the rim the rim repeats.
    var half_vector = vec3f((vec2f(texel.xy) + 0.5) / f32(size) * 2.0 - 1.0, 0.0);
    half_vector.y = -half_vector.y;
    half_vector = vec3f(half_vector.xy / max(length(half_vector.xy), 1.0), 0.0);
    half_vector.z = sqrt(max(1.0 - dot(half_vector.xy, half_vector.xy), 0.0));
    let in_eye = 2.0 * half_vector.z * half_vector - vec3f(0.0, 0.0, 1.0);
    // The camera looks along its z with y down. The vector on the left multiplies by the transpose: camera to world.
    let direction = (vec4f(in_eye.x, -in_eye.y, -in_eye.z, 0.0) * camera.camera_from_world).xyz;
    textureStore(out, texel.xy, 0, textureSampleLevel(radiance, linear_sampler, direction, 0.0));
    textureStore(out, texel.xy, 1, textureSampleLevel(irradiance, linear_sampler, direction, 0.0));
}
