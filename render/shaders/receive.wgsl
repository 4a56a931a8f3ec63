// Phantoms as the ratio by which virtual objects change the light on them: irradiance with all objects over irradiance with
// the real ones alone. CPU twin: src/reference/receive.rs.

#import camera
#import lights
#import sh

#import direct

@group(0) @binding(8) var<uniform> frame: Frame;
// Place and normal of the phantom that a pixel shows; place's w: 0 where there is none.
@group(0) @binding(9) var places: texture_2d<f32>;
@group(0) @binding(10) var normals: texture_2d<f32>;
// Light that the picture does not have although no known thing is in its way, and what virtual objects would take of it.
@group(0) @binding(11) var light_absent: texture_2d<f32>;
@group(0) @binding(12) var light_returned: texture_2d<f32>;
// Ratio, and 1 where there is a phantom.
@group(0) @binding(13) var out: texture_storage_2d<rgba16float, write>;
// Irradiance in the room past the real things; w: 0 where there is no phantom, or one that mirrors.
@group(0) @binding(14) var out_light: texture_storage_2d<rgba16float, write>;

// A change of light below this share changes no 8-bit code: half a code of 255 in sRGB is 0.4 % at white, more below.
const LEAST_CHANGE: f32 = 0.002;
// No surface gets more than so many times the light that it had: its picture is mostly noise then.
const MOST: f32 = 16.0;

// Whether a point lies on the ball: a mirror shows no shadow.
fn is_on_ball(point: vec3f) -> bool {
    return abs(distance(point, frame.ball_m.xyz) - frame.ball_m.w) < 0.02 * frame.ball_m.w;
}

// Irradiance from afar that the picture has.
fn far_irradiance(pixel: vec2u) -> vec3f {
    return max(textureLoad(light_without, pixel, 0).rgb - textureLoad(light_absent, pixel, 0).rgb, vec3f(0.0));
}

// Irradiance of all light in the room.
fn real_irradiance(pixel: vec2u, point: vec3f, normal: vec3f) -> vec3f {
    return far_irradiance(pixel) + near_irradiance(nearest_environment(point, frame.counts.x), normal);
}

// Exactly 1 where virtual objects change nothing; the light of virtual lamps comes on top (shaders/lamp_receive.wgsl).
fn phantom_ratio(pixel: vec2u, real: vec3f) -> vec3f {
    let gained = textureLoad(light_with, pixel, 0).rgb - textureLoad(light_without, pixel, 0).rgb
        + textureLoad(light_near, pixel, 0).rgb
        + textureLoad(light_returned, pixel, 0).rgb;
    if all(abs(gained) <= LEAST_CHANGE * far_irradiance(pixel)) {
        return vec3f(1.0);
    }
    let total = max(real, vec3f(1e-9));
    return clamp((total + gained) / total, vec3f(0.0), vec3f(MOST));
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var ratio = vec4f(0.0);
    var light = vec4f(0.0);
    if place.w > 0.0 && is_on_ball(place.xyz) {
        ratio = vec4f(1.0);
    } else if place.w > 0.0 {
        light = vec4f(real_irradiance(at.xy, place.xyz, textureLoad(normals, at.xy, 0).xyz), 1.0);
        ratio = vec4f(phantom_ratio(at.xy, light.rgb), 1.0);
    }
    textureStore(out_light, at.xy, light);
    textureStore(out, at.xy, ratio);
}
