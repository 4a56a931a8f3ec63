// The light that arrives at one virtual object: the probe's light moved there, real things near it at their true places.

#import camera
#import cube
#import lights

@group(0) @binding(0) var<uniform> environment: Environment;
@group(0) @binding(1) var<uniform> camera: Camera;
@group(0) @binding(2) var<storage, read> response: array<f32>;
@group(0) @binding(3) var picture: texture_2d<u32>;
// Distance to the first phantom from the object, per texel of its cube, metres; huge where there is none.
@group(0) @binding(4) var<storage, read> hit_m: array<f32>;
@group(0) @binding(5) var probe_radiance: texture_cube<f32>;
@group(0) @binding(6) var far_radiance: texture_cube<f32>;
@group(0) @binding(7) var linear_sampler: sampler;
@group(0) @binding(8) var camera_depth: texture_depth_2d;
// rgb radiance; a: distance to what is seen, metres.
@group(0) @binding(9) var out: texture_storage_2d_array<rgba16float, write>;

#import picture

// Radiance of a real surface at a point: from the scene camera's picture where that sees the point, else from the probe.
fn surface_radiance(point: vec3f) -> vec3f {
    let in_camera = (camera.camera_from_world * vec4f(point, 1.0)).xyz;
    if is_imaged(camera, in_camera) {
        let pixel = pixel_of(camera, in_camera);
        if is_inside(camera, pixel) {
            let seen_m = depth_m(camera, textureLoad(camera_depth, vec2i(round(pixel)), 0));
            if abs(seen_m - in_camera.z) < 0.004 + 0.01 * in_camera.z {
                return sample_picture(camera, pixel).radiance;
            }
        }
    }
    return textureSampleLevel(probe_radiance, linear_sampler, point - environment.probe_m.xyz, 0.0).rgb;
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = textureDimensions(out).x;
    let direction = texel_direction(size, texel, vec2f(0.5));
    let hit = hit_m[(texel.z * size + texel.y) * size + texel.x];
    let room_m = environment.position_m.w;
    var radiance: vec3f;
    var distance = hit;
    if hit < 1e6 {
        radiance = surface_radiance(environment.position_m.xyz + direction * hit);
    } else {
        // Where the ray leaves the sphere that the room is taken for.
        let from_probe = environment.position_m.xyz - environment.probe_m.xyz;
        let b = dot(from_probe, direction);
        let inside = max(room_m * room_m - dot(from_probe, from_probe), 1e-4);
        distance = -b + sqrt(b * b + inside);
        radiance = textureSampleLevel(far_radiance, linear_sampler, from_probe + direction * distance, 0.0).rgb;
    }
    textureStore(out, texel.xy, texel.z, vec4f(min(radiance, vec3f(60000.0)), min(distance, 60000.0)));
}
