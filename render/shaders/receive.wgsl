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

// A change of light below this share changes no 8-bit code: half a code of 255 in sRGB is 0.4 % at white, more below.
const LEAST_CHANGE: f32 = 0.002;
// No surface gets more than so many times the light that it had: its picture is mostly noise then.
const MOST: f32 = 16.0;

// Exactly 1 where virtual objects change nothing.
fn phantom_ratio(pixel: vec2u, point: vec3f, normal: vec3f) -> vec3f {
    let from_ball = distance(point, frame.ball_m.xyz);
    if abs(from_ball - frame.ball_m.w) < 0.02 * frame.ball_m.w {
        // A mirror shows no shadow.
        return vec3f(1.0);
    }
    let predicted = textureLoad(light_without, pixel, 0).rgb;
    let without = max(predicted - textureLoad(light_absent, pixel, 0).rgb, vec3f(0.0));
    let gained = textureLoad(light_with, pixel, 0).rgb - predicted
        + textureLoad(light_lamps, pixel, 0).rgb
        + textureLoad(light_near, pixel, 0).rgb
        + textureLoad(light_returned, pixel, 0).rgb;
    if all(abs(gained) <= LEAST_CHANGE * without) {
        return vec3f(1.0);
    }
    let near = near_irradiance(nearest_environment(point, frame.counts.x), normal);
    let total = max(without + near, vec3f(1e-9));
    return clamp((total + gained) / total, vec3f(0.0), vec3f(MOST));
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var ratio = vec4f(0.0);
    if place.w > 0.0 {
        ratio = vec4f(phantom_ratio(at.xy, place.xyz, textureLoad(normals, at.xy, 0).xyz), 1.0);
    }
    textureStore(out, at.xy, ratio);
}
