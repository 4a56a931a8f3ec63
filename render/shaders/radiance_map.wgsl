// Probe picture to radiance cube: every direction asks the picture, exactly, for a light at finite distance.
// CPU twin: calib's probe::radiance_map, which also derives the quality.

#import camera
#import cube

struct Probe {
    position_m: vec4f,
    origin_m: vec4f,
    reflectance: vec4f,
    limits: vec4f,
    ramps_px: vec4f,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> probe: Probe;
@group(0) @binding(2) var<storage, read> response: array<f32>;
@group(0) @binding(3) var picture: texture_2d<u32>;
// Distance from the origin to the first phantom in each direction, metres; huge where there is none.
@group(0) @binding(4) var<storage, read> near_m: array<f32>;
// rgb radiance; a: 0 not seen, else 1 plus the bits of channels clipped anywhere, 8 times those clipped everywhere, and 64
// times the quality in 255ths.
@group(0) @binding(5) var<storage, read_write> radiance: array<vec4f>;

#import picture

fn incidence(d: f32, t: f32) -> f32 {
    return atan2(d * sin(t), d * cos(t) - 1.0);
}

fn incidence_slope(d: f32, t: f32) -> f32 {
    return (d * d - d * cos(t)) / (d * d - 2.0 * d * cos(t) + 1.0);
}

// Where the picture shows a light.
struct Place {
    pixel: vec2f,
    // Whether there is such a pixel, inside the picture or not.
    exists: bool,
    // Least of the ramps of trust: 0 to 1, negative where the light is not seen.
    trust: f32,
}

const NOWHERE = Place(vec2f(0.0), false, -1.0);

// 0 at the first of two limits, 1 at and beyond the second, negative before.
fn ramp(value: f32, limits: vec2f) -> f32 {
    return min((value - limits.x) / (limits.y - limits.x), 1.0);
}

// Place that shows a point without the ball's help.
fn place_of(point_world: vec3f) -> Place {
    let point = (camera.camera_from_world * vec4f(point_world, 1.0)).xyz;
    if !is_imaged(camera, point) {
        return NOWHERE;
    }
    let pixel = pixel_of(camera, point);
    var trust = 1.0;
    if is_fisheye(camera) {
        let rho = length(point.xy);
        let outwards = select(vec2f(1.0, 0.0), point.xy / rho, rho > 0.0);
        let left = fisheye_radius(camera, camera.limits.y) - fisheye_radius(camera, atan2(rho, point.z));
        trust = ramp(length(camera.focal_and_principal_px.xy * outwards) * left, probe.ramps_px.zw);
    }
    return Place(pixel, true, select(-1.0, trust, is_inside(camera, pixel)));
}

// Place in which the mirror ball shows a light (calib's probe::mirror_ball derives it).
fn place_in_ball(light_world: vec3f) -> Place {
    let to_light = light_world - probe.position_m.xyz;
    let to_camera = camera.position_m.xyz - probe.position_m.xyz;
    let radius = probe.position_m.w;
    let a = length(to_camera) / radius;
    let b = length(to_light) / radius;
    if a <= 1.0 || b <= 1.0 {
        return NOWHERE;
    }
    let forward = normalize(to_camera);
    let direction = normalize(to_light);
    let across = direction - forward * dot(direction, forward);
    let phi = atan2(length(across), dot(direction, forward));
    var theta = 0.5 * phi;
    for (var i = 0; i < 8; i++) {
        let difference = incidence(a, theta) - incidence(b, phi - theta);
        let slope = max(incidence_slope(a, theta) + incidence_slope(b, phi - theta), 0.1);
        theta = clamp(theta - difference / slope, 0.0, phi);
    }
    if a * cos(theta) <= 1.0 {
        return NOWHERE;
    }
    let sideways = across / max(length(across), 1e-9);
    let normal = forward * cos(theta) + sideways * sin(theta);
    var place = place_of(probe.position_m.xyz + normal * radius);
    if !place.exists {
        return NOWHERE;
    }
    // The outline beside it: there the ray touches the ball.
    let outline = forward / a + sideways * sqrt(1.0 - 1.0 / (a * a));
    let in_camera = (camera.camera_from_world * vec4f(probe.position_m.xyz + outline * radius, 1.0)).xyz;
    if is_imaged(camera, in_camera) {
        place.trust = min(place.trust, ramp(distance(pixel_of(camera, in_camera), place.pixel), probe.ramps_px.xy));
    }
    place.trust = min(place.trust, ramp(cos(incidence(a, theta)), probe.limits.xy));
    if phi < probe.limits.z {
        place.trust = -1.0;
    }
    return place;
}

// Place by the simple sphere map of 2006 (Supan, section 3.4): everything infinitely far away.
fn place_in_sphere_map(direction: vec3f) -> Place {
    let along = (camera.camera_from_world * vec4f(direction, 0.0)).xyz;
    var middle = camera.focal_and_principal_px.zw;
    var half = camera.focal_and_principal_px.xy * fisheye_radius(camera, camera.limits.y);
    var towards_viewer = along.z;
    if probe.position_m.w > 0.0 {
        let center = (camera.camera_from_world * vec4f(probe.position_m.xyz, 1.0)).xyz;
        let corner = vec3f(probe.position_m.ww, 0.0);
        if !is_imaged(camera, center - corner) || !is_imaged(camera, center + corner) {
            return NOWHERE;
        }
        let low = pixel_of(camera, center - corner);
        let high = pixel_of(camera, center + corner);
        middle = 0.5 * (low + high);
        half = 0.5 * (high - low);
        towards_viewer = -along.z;
    } else if !is_fisheye(camera) {
        return NOWHERE;
    }
    var halfway = vec3f(along.xy, towards_viewer + probe.reflectance.w);
    halfway.z = max(halfway.z, 0.0);
    let pixel = middle + half * halfway.xy / max(length(halfway), 1e-9);
    return Place(pixel, true, select(-1.0, 1.0, is_inside(camera, pixel)));
}

fn place_of_light(direction: vec3f, distance: f32) -> Place {
    if probe.reflectance.w >= 0.0 {
        return place_in_sphere_map(direction);
    }
    let light = probe.origin_m.xyz + direction * distance;
    if probe.position_m.w > 0.0 {
        return place_in_ball(light);
    }
    return place_of(light);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = u32(probe.limits.w);
    let index = (texel.z * size + texel.y) * size + texel.x;
    let distance = min(near_m[index], probe.origin_m.w);
    var sum = vec3f(0.0);
    var n_seen = 0.0;
    var clipped = 0u;
    var all_clipped = 7u;
    var trust = 0.0;
    var exist = true;
    var pixels: array<vec2f, 4>;
    for (var i = 0u; i < 4u; i++) {
        let offset = vec2f(0.25) + 0.5 * vec2f(f32(i & 1u), f32(i >> 1u));
        let place = place_of_light(texel_direction(size, texel, offset), distance);
        pixels[i] = place.pixel;
        exist &= place.exists;
        if place.trust >= 0.0 {
            let found = sample_picture(camera, place.pixel);
            sum += found.radiance;
            clipped |= found.clipped;
            all_clipped &= found.all_clipped;
            n_seen += 1.0;
            trust += 0.25 * place.trust * place.trust * (3.0 - 2.0 * place.trust);
        }
    }
    if n_seen < 2.0 {
        radiance[index] = vec4f(0.0);
        return;
    }
    // Pixels per texel: twice the cross product of the diagonals of the quadrilateral between the texel's quarters.
    let one = pixels[3] - pixels[0];
    let other = pixels[2] - pixels[1];
    let sharpness = select(0.0, min(2.0 * abs(one.x * other.y - one.y * other.x), 1.0), exist);
    let quality = floor(255.0 * sharpness * trust + 0.5);
    let bits = f32(clipped | (all_clipped << 3u));
    radiance[index] = vec4f(sum / (n_seen * probe.reflectance.xyz), 1.0 + bits + 64.0 * quality);
}
