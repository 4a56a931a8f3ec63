// Phantoms as the ratio by which virtual objects dim the light on them: irradiance with all objects over irradiance with
// the real ones alone. CPU twin: src/reference/receive.rs.

#import camera
#import lights
#import sh

#import direct

@group(0) @binding(6) var<uniform> frame: Frame;

// A loss of light below this share changes no 8-bit code: half a code of 255 in sRGB is 0.4 % at white, more below.
const LEAST_LOSS: f32 = 0.002;

struct Corner {
    @invariant @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
}

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32, @location(2) normal: vec3f) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let world = (world_from_object * vec4f(position, 1.0)).xyz;
    return Corner(clip_of(camera, world), world, (world_from_object * vec4f(normal, 0.0)).xyz);
}

// Exactly 1 where no virtual object is in any light's way.
fn phantom_ratio(pixel: vec2u, point: vec3f, normal: vec3f) -> vec3f {
    let from_ball = distance(point, frame.ball_m.xyz);
    if abs(from_ball - frame.ball_m.w) < 0.02 * frame.ball_m.w {
        // A mirror shows no shadow.
        return vec3f(1.0);
    }
    let without = textureLoad(light_without, pixel, 0).rgb;
    let lost = without - textureLoad(light_with, pixel, 0).rgb;
    if all(lost <= LEAST_LOSS * without) {
        return vec3f(1.0);
    }
    let near = near_irradiance(nearest_environment(point), normal);
    let total = max(without + near, vec3f(1e-9));
    return clamp(total - lost, vec3f(0.0), total) / total;
}

fn nearest_environment(point: vec3f) -> u32 {
    var nearest = 0u;
    for (var i = 1u; i < frame.counts.x; i++) {
        if distance(environments[i].position_m.xyz, point) < distance(environments[nearest].position_m.xyz, point) {
            nearest = i;
        }
    }
    return nearest;
}

// Ratio, and 1 where there is a phantom.
@fragment
fn fragment(corner: Corner) -> @location(0) vec4f {
    return vec4f(phantom_ratio(vec2u(corner.clip.xy), corner.position, normalize(corner.normal)), 1.0);
}
