// Probe picture to radiance cube: every direction asks the picture, exactly, for a light at finite distance.
// CPU twin: src/reference/radiance_map.rs.

#import camera
#import cube

struct Probe {
    position_m: vec4f,
    reflectance: vec4f,
    limits: vec4f,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> probe: Probe;
@group(0) @binding(2) var<storage, read> response: array<f32>;
@group(0) @binding(3) var picture: texture_2d<u32>;
// Distance from the probe to the first phantom in each direction, metres; huge where there is none.
@group(0) @binding(4) var<storage, read> near_m: array<f32>;
// rgb radiance; a: 0 not seen, else 1 plus the bits of channels clipped anywhere plus 8 times those clipped everywhere.
@group(0) @binding(5) var<storage, read_write> radiance: array<vec4f>;

#import picture

fn incidence(d: f32, t: f32) -> f32 {
    return atan2(d * sin(t), d * cos(t) - 1.0);
}

fn incidence_slope(d: f32, t: f32) -> f32 {
    return (d * d - d * cos(t)) / (d * d - 2.0 * d * cos(t) + 1.0);
}

struct Seen {
    pixel: vec2f,
    is_seen: bool,
}

// Pixel in which the mirror ball shows the light at `distance` towards `direction` (src/probe/mirror_ball.rs derives it).
fn seen_in_ball(direction: vec3f, distance: f32) -> Seen {
    let to_camera = camera.position_m.xyz - probe.position_m.xyz;
    let radius = probe.position_m.w;
    let a = length(to_camera) / radius;
    let b = distance / radius;
    let forward = normalize(to_camera);
    let across = direction - forward * dot(direction, forward);
    let phi = atan2(length(across), dot(direction, forward));
    if phi < probe.limits.y || a <= 1.0 || b <= 1.0 {
        return Seen(vec2f(0.0), false);
    }
    var theta = 0.5 * phi;
    for (var i = 0; i < 8; i++) {
        let difference = incidence(a, theta) - incidence(b, phi - theta);
        let slope = max(incidence_slope(a, theta) + incidence_slope(b, phi - theta), 0.1);
        theta = clamp(theta - difference / slope, 0.0, phi);
    }
    if a * cos(theta) <= 1.0 || cos(incidence(a, theta)) < probe.limits.x {
        return Seen(vec2f(0.0), false);
    }
    let normal = forward * cos(theta) + across * (sin(theta) / max(length(across), 1e-9));
    return seen_directly(probe.position_m.xyz + normal * radius);
}

// Whether bilinear sampling would mix in the black around a fisheye's picture: nearer than two pixels to its end.
fn is_at_rim(point: vec3f) -> bool {
    let angle = atan2(length(point.xy), point.z);
    return camera.position_m.w > 0.5 && angle > camera.limits.y - 2.0 / camera.focal_and_principal_px.x;
}

fn seen_directly(point_world: vec3f) -> Seen {
    let point = (camera.camera_from_world * vec4f(point_world, 1.0)).xyz;
    if !is_imaged(camera, point) || is_at_rim(point) {
        return Seen(vec2f(0.0), false);
    }
    let pixel = pixel_of(camera, point);
    return Seen(pixel, is_inside(camera, pixel));
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = u32(probe.limits.z);
    let index = (texel.z * size + texel.y) * size + texel.x;
    let distance = min(near_m[index], probe.reflectance.w);
    var sum = vec3f(0.0);
    var n_seen = 0.0;
    var clipped = 0u;
    var all_clipped = 7u;
    for (var i = 0u; i < 4u; i++) {
        let offset = vec2f(0.25) + 0.5 * vec2f(f32(i & 1u), f32(i >> 1u));
        let direction = texel_direction(size, texel, offset);
        var seen: Seen;
        if probe.position_m.w > 0.0 {
            seen = seen_in_ball(direction, distance);
        } else {
            seen = seen_directly(probe.position_m.xyz + direction * distance);
        }
        if seen.is_seen {
            let found = sample_picture(camera, seen.pixel);
            sum += found.radiance;
            clipped |= found.clipped;
            all_clipped &= found.all_clipped;
            n_seen += 1.0;
        }
    }
    if n_seen < 2.0 {
        radiance[index] = vec4f(0.0);
    } else {
        radiance[index] = vec4f(sum / (n_seen * probe.reflectance.xyz), 1.0 + f32(clipped | (all_clipped << 3u)));
    }
}
