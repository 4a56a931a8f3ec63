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
// The room without phantoms and without the strong lights.
@group(0) @binding(6) var behind_radiance: texture_cube<f32>;
@group(0) @binding(7) var linear_sampler: sampler;
// Places of the phantoms that the camera sees; w: 0 where there is none.
@group(0) @binding(8) var real_places: texture_2d<f32>;
// rgb radiance; a: distance to what is seen, metres.
@group(0) @binding(9) var out: texture_storage_2d_array<rgba16float, write>;
// The room without phantoms; a: number of the strong light that the texel shows, from 1, 0 for none.
@group(0) @binding(10) var far_faces: texture_2d_array<f32>;
@group(0) @binding(11) var<uniform> strong: Strong;
// The room alone, as if no phantom stood before it: rgb radiance; a: distance to what is seen, metres.
@group(0) @binding(12) var room_out: texture_storage_2d_array<rgba16float, write>;

struct Strong {
    lights: array<vec4f, 6>,
    cones: array<vec4f, 6>,
}

// Places along the edge of a texel at which strong lights are looked for: they are small beside it and bright.
const SUBSAMPLES: u32 = 4u;

#import picture

#import seen

// Radiance of a real surface at a point: from the scene camera's picture where that sees the point, else from the probe.
fn surface_radiance(point: vec3f) -> vec3f {
    let pixel = seen_at(point);
    if pixel.x >= 0.0 {
        return sample_picture(camera, pixel).radiance;
    }
    return textureSampleLevel(probe_radiance, linear_sampler, point - environment.probe_m.xyz, 0.0).rgb;
}

// Distance along unit `direction` from `start` to the sphere of `radius` around the origin, `start` taken as inside.
fn to_sphere(start: vec3f, direction: vec3f, radius: f32) -> f32 {
    let b = dot(start, direction);
    return -b + sqrt(b * b + max(radius * radius - dot(start, start), 1e-4));
}

// Whether strong light `k` may show within `margin` radians of a direction, from a place relative to the probe.
fn may_show(k: u32, from_probe: vec3f, direction: vec3f, margin: f32) -> bool {
    let light = strong.lights[k];
    let to_light = light.xyz * light.w - from_probe;
    let seen_m = length(to_light);
    // Half angles grow as the light comes nearer; a little more for lights that are not round.
    let half_angle = 1.2 * strong.cones[k].x * light.w / max(seen_m, 0.05) + margin;
    return light.w > 0.0 && (half_angle > 1.5 || dot(direction, to_light) > seen_m * cos(half_angle));
}

// What strong light `k` shows in a direction: rgb radiance; a: its distance, metres, 0 beside it.
fn strong_light(k: u32, from_probe: vec3f, direction: vec3f) -> vec4f {
    let distance_m = to_sphere(from_probe, direction, strong.lights[k].w);
    let place = from_probe + direction * distance_m;
    let size = textureDimensions(far_faces).x;
    let index = texel_index(size, place);
    let texel = vec2u(index % size, index / size % size);
    let found = textureLoad(far_faces, texel, index / (size * size), 0);
    return select(vec4f(0.0), vec4f(found.rgb, distance_m), u32(found.a + 0.5) == k + 1u);
}

// Light from the room: the strong ones where they stand, before the rest on the sphere that the room is taken for, which
// shows `behind` (rgb radiance; a: distance, metres).
fn room_radiance(texel: vec3u, size: u32, from_probe: vec3f, behind: vec4f) -> vec4f {
    let direction = texel_direction(size, texel, vec2f(0.5));
    // Half a texel's diagonal, at the middle of a face.
    let margin = 1.5 / f32(size);
    var candidates = 0u;
    for (var k = 0u; k < 6u; k++) {
        candidates |= select(0u, 1u << k, may_show(k, from_probe, direction, margin));
    }
    if candidates == 0u {
        return behind;
    }
    var sum = vec4f(0.0);
    for (var i = 0u; i < SUBSAMPLES * SUBSAMPLES; i++) {
        let offset = (vec2f(f32(i % SUBSAMPLES), f32(i / SUBSAMPLES)) + 0.5) / f32(SUBSAMPLES);
        let there = texel_direction(size, texel, offset);
        var found = vec4f(0.0);
        for (var k = 0u; k < 6u && found.a == 0.0; k++) {
            if (candidates >> k & 1u) == 1u {
                found = strong_light(k, from_probe, there);
            }
        }
        sum += select(behind, found, found.a > 0.0);
    }
    return sum / f32(SUBSAMPLES * SUBSAMPLES);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = textureDimensions(out).x;
    let direction = texel_direction(size, texel, vec2f(0.5));
    let hit = hit_m[(texel.z * size + texel.y) * size + texel.x];
    let from_probe = environment.position_m.xyz - environment.probe_m.xyz;
    let distance = to_sphere(from_probe, direction, environment.position_m.w);
    let behind = textureSampleLevel(behind_radiance, linear_sampler, from_probe + direction * distance, 0.0).rgb;
    let room = room_radiance(texel, size, from_probe, vec4f(behind, distance));
    textureStore(room_out, texel.xy, texel.z, min(room, vec4f(60000.0)));
    var seen = vec4f(room.rgb, distance);
    if hit < 1e6 {
        seen = vec4f(surface_radiance(environment.position_m.xyz + direction * hit), hit);
    }
    textureStore(out, texel.xy, texel.z, min(seen, vec4f(60000.0)));
}
