// Light along rays through real and virtual things: bindings 0 to 15 of group 0 (src/passes/ray_light.rs). World frame,
// metres. Needs `bvh`, `scene_ray`, `camera`, `lights`, `sh`, `brdf`, `material`, `hit_substance`, `seen`,
// `real_memory` and `virtual_hit`.

// Where the light was measured, and the mirror ball.
struct LightProbe {
    // xyz: the probe's place; w: distance of the room from it.
    position_m: vec4f,
    // xyz: the ball's centre; w: its radius, 0 where there is none.
    ball_m: vec4f,
    // xyz: its linear reflectance; w: 1 where the camera's picture shows the room too.
    ball_reflectance: vec4f,
}

@group(0) @binding(4) var<uniform> camera: Camera;
@group(0) @binding(5) var<uniform> environments: array<Environment, 16>;
@group(0) @binding(6) var<uniform> harmonics: array<vec4f, 256>;
@group(0) @binding(7) var<uniform> probe: LightProbe;
@group(0) @binding(8) var linear_sampler: sampler;
// The rooms around the objects, without phantoms; a: distance.
@group(0) @binding(9) var room: texture_cube_array<f32>;
// The camera's picture as radiance, with mips.
@group(0) @binding(10) var real: texture_2d<f32>;
// Places of the phantoms that it sees; w: 0 where there is none.
@group(0) @binding(11) var real_places: texture_2d<f32>;
// Radiance per vertex of the scene, where real things are.
@group(0) @binding(12) var<storage, read> real_memory: array<vec4f>;

// A line, or a cone around it that stands for many.
struct Beam {
    origin: vec3f,
    // Unit.
    direction: vec3f,
    // Across at the origin, metres.
    width_m: f32,
    // What is added to the width per metre.
    spread: f32,
}

// Surfaces that a beam meets at most before it is taken to see far light.
const MEETINGS = 4u;
// How far off a surface that they have met rays go on, metres.
const LIFT_M = 2e-4;
// Angle of a texel of the rooms' first mip, radians.
const ROOM_TEXEL_RAD = 0.0123;
const LAST_ROOM_MIP = 5.0;
// A share of the light below this is left out.
const LEAST_SHARE = 0.01;
// Above this part of the brightest code a camera's picture says only "at least so bright".
const CLIPS = 0.9;

// How far off a surface that the camera sees at `place` rays start, metres: part of a pixel, so that meshes with bent normals
// do not meet themselves.
fn lift_m(place: vec3f) -> f32 {
    return 0.3 * distance(place, camera.position_m.xyz) / camera.focal_and_principal_px.x;
}

// Distance from a point to the sphere around the probe that the room is taken for.
fn to_room_m(point: vec3f, direction: vec3f) -> f32 {
    let start = point - probe.position_m.xyz;
    let b = dot(start, direction);
    let radius = probe.position_m.w;
    return -b + sqrt(b * b + max(radius * radius - dot(start, start), 1e-4));
}

// The room behind all phantoms as the camera's picture shows it: rgb radiance; a: 1 where it does.
fn room_in_picture(point: vec3f, spread: f32) -> vec4f {
    let in_camera = (camera.camera_from_world * vec4f(point, 1.0)).xyz;
    if probe.ball_reflectance.w == 0.0 || !is_imaged(camera, in_camera) {
        return vec4f(0.0);
    }
    let pixel = pixel_of(camera, in_camera);
    let across_px = spread * camera.focal_and_principal_px.x;
    let margin = 1.0 + across_px;
    if any(pixel < vec2f(margin)) || any(pixel > camera.limits.zw - 1.0 - margin) {
        return vec4f(0.0);
    }
    // As wide as what is averaged there must be no phantom.
    for (var i = 0u; i < 4u; i++) {
        let corner = vec2f(f32(i & 1u), f32(i >> 1u)) * 2.0 - 1.0;
        if textureLoad(real_places, vec2i(round(pixel + corner * margin)), 0).w > 0.0 {
            return vec4f(0.0);
        }
    }
    let radiance = textureSampleLevel(real, linear_sampler, (pixel + 0.5) / camera.limits.zw, log2(max(across_px, 1.0))).rgb;
    let signal = (camera.camera_from_common * vec4f(radiance, 0.0)).xyz * camera.signal_per_radiance.xyz
        * vignetting(camera, pixel);
    return vec4f(radiance, select(0.0, 1.0, all(signal < vec3f(CLIPS))));
}

// Light of the room along a beam that no thing stops.
fn room_light(slot: u32, beam: Beam) -> vec3f {
    let way_m = to_room_m(beam.origin, beam.direction);
    let seen = room_in_picture(beam.origin + beam.direction * way_m, beam.spread);
    if seen.a > 0.0 {
        return seen.rgb;
    }
    let mip = clamp(log2(max(beam.spread, 1e-6) / ROOM_TEXEL_RAD), 0.0, LAST_ROOM_MIP);
    // The cube is taken at the object's middle; what it shows stands at the distance in its alpha, so two steps find the
    // direction under which the middle sees what the beam meets.
    let from_center = beam.origin - environments[slot].position_m.xyz;
    var towards = from_center + beam.direction * way_m;
    for (var i = 0u; i < 2u; i++) {
        let away_m = textureSampleLevel(room, linear_sampler, towards, slot, mip).a;
        let b = dot(from_center, beam.direction);
        towards = from_center + beam.direction * (-b + sqrt(b * b + max(away_m * away_m - dot(from_center, from_center), 1e-6)));
    }
    return textureSampleLevel(room, linear_sampler, towards, slot, mip).rgb;
}

fn is_on_ball(place: vec3f) -> bool {
    return abs(distance(place, probe.ball_m.xyz) - probe.ball_m.w) < 0.02 * probe.ball_m.w;
}

// The beam that leaves a smooth surface whose curvature is 1 / `radius_m`.
fn mirrored(beam: Beam, distance_m: f32, place: vec3f, normal: vec3f, radius_m: f32) -> Beam {
    let width_m = beam.width_m + beam.spread * distance_m;
    return Beam(place + LIFT_M * normal, reflect(beam.direction, normal), width_m, beam.spread + 2.0 * width_m / radius_m);
}

// Radiance towards the origin of a beam, near environment `slot`.
fn light_along(start: Beam, slot: u32) -> vec3f {
    var beam = start;
    var around = slot;
    var share = vec3f(1.0);
    var sum = vec3f(0.0);
    for (var i = 0u; i < MEETINGS; i++) {
        let hit = scene_hit(ALL_OBJECTS, beam.origin, beam.direction, FAR_M);
        if hit.object == NOTHING {
            return sum + share * room_light(around, beam);
        }
        let place = beam.origin + beam.direction * hit.distance_m;
        if (instances[hit.object].facts.y & PHANTOMS) != 0u {
            if !is_on_ball(place) {
                return sum + share * real_hit_radiance(hit, beam.origin, beam.direction, beam.width_m + beam.spread * hit.distance_m);
            }
            beam = mirrored(beam, hit.distance_m, place, normalize(place - probe.ball_m.xyz), probe.ball_m.w);
            share *= probe.ball_reflectance.rgb;
            continue;
        }
        let met = virtual_hit(hit, beam.origin, beam.direction);
        around = instances[hit.object].facts.z;
        sum += share * met.radiance;
        if max(met.through.r, max(met.through.g, met.through.b)) > max(met.mirrored.r, max(met.mirrored.g, met.mirrored.b)) {
            // Glass that is seen by way of other things does not bend what is behind it.
            beam = Beam(met.place - LIFT_M * met.normal, beam.direction, beam.width_m + beam.spread * hit.distance_m, beam.spread);
            share *= met.through;
            continue;
        }
        share *= met.mirrored;
        if max(share.r, max(share.g, share.b)) < LEAST_SHARE {
            return sum;
        }
        beam = mirrored(beam, hit.distance_m, met.place, met.normal, FAR_M);
        // The width of a GGX lobe: half of its facets are turned by less than atan alpha, the light by twice that, to all sides.
        beam.spread += 4.0 * met.roughness * met.roughness;
    }
    return sum + share * room_light(around, beam);
}
