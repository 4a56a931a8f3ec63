// Real things in the light of virtual lamps: how light a surface is tells how much of a lamp's light it sends back. Albedo is
// π times radiance, as the camera sees it, over irradiance. CPU twin: src/reference/lamp_receive.rs.

#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> response: array<f32>;
@group(0) @binding(2) var picture: texture_2d<u32>;
// Irradiance of all light in the room past the real things; w: 0 where there is no phantom, or one that mirrors.
@group(0) @binding(3) var real_light: texture_2d<f32>;
// Irradiance of virtual lamps, past all objects.
@group(0) @binding(4) var light_lamps: texture_2d<f32>;
// Place and normal of the phantom that a pixel shows; place's w: 0 where there is none.
@group(0) @binding(5) var places: texture_2d<f32>;
@group(0) @binding(6) var normals: texture_2d<f32>;
// Albedo; w: 1 where it was estimated.
@group(0) @binding(7) var out_albedo: texture_storage_2d<rgba16float, write>;
// Radiance that the lamps add.
@group(0) @binding(8) var out: texture_storage_2d<rgba16float, write>;

// Nothing matt is lighter: fresh snow is not, and what looks lighter is clipped, glossy, or lit by light that was not measured.
const LIGHTEST: f32 = 0.95;
// Where the picture is too dark to tell, surfaces are taken to be as light as those of rooms are on average.
const COMMON: f32 = 0.3;
// A picture of white that is below this code tells nothing.
const DARK_CODE: u32 = 2u;
// Pixels whose codes differ by less show the same surface: some times the noise of a camera.
const SAME_CODES: i32 = 4;
// Light that varies by this factor within twice so many pixels has an edge there: that of a real shadow.
const SHADOW_EDGE: f32 = 1.15;
const SHADOW_STEP_PX: i32 = 3;
// Albedo of one surface varies by this share.
const GRAIN: f32 = 0.1;
// A change of radiance below this share changes no 8-bit code (shaders/receive.wgsl).
const LEAST_CHANGE: f32 = 0.002;

fn signal_at(code: vec3u) -> vec3f {
    return vec3f(response[code.r], response[code.g], response[code.b]);
}

// Mean over the pixels around that show the same surface: a lamp is not to light up the camera's noise (Lee 1983, "Digital
// image smoothing and the sigma filter").
fn smooth_signal(pixel: vec2i) -> vec3f {
    let own = textureLoad(picture, pixel, 0).rgb;
    let size = vec2i(textureDimensions(picture));
    var sum = vec3f(0.0);
    var n = 0.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = pixel + vec2i(dx, dy);
            if any(at < vec2i(0)) || any(at >= size) {
                continue;
            }
            let code = textureLoad(picture, at, 0).rgb;
            if all(abs(vec3i(code) - vec3i(own)) < vec3i(SAME_CODES)) {
                sum += signal_at(code);
                n += 1.0;
            }
        }
    }
    return sum / n;
}

// Radiance, in the rig's common RGB, of a signal.
fn radiance_of(signal: vec3f, per_radiance: vec3f) -> vec3f {
    return max((camera.common_from_camera * vec4f(signal / per_radiance, 0.0)).xyz, vec3f(0.0));
}

// Signal per radiance at a pixel.
fn signal_per_radiance(pixel: vec2i) -> vec3f {
    return camera.signal_per_radiance.xyz * vignetting(camera, vec2f(pixel));
}

// Albedo of a surface that sends `radiance` in `irradiance`.
fn albedo_of(radiance: vec3f, irradiance: vec3f, per_radiance: vec3f) -> vec3f {
    let sent = 3.1415927 * radiance;
    let dark = 3.1415927 * response[DARK_CODE] / per_radiance;
    return min((sent + COMMON * dark) / (irradiance + dark), vec3f(LIGHTEST));
}

// What lamps add to the radiance of a surface.
fn lit_by_lamps(pixel: vec2i, albedo: vec3f) -> vec3f {
    return albedo * textureLoad(light_lamps, pixel, 0).rgb * 0.31830987;
}

// Whether the pixel `at` shows the surface at `place` with this normal, and not another one or the same one turned.
fn shows(at: vec2i, place: vec4f, normal: vec3f) -> bool {
    let apart_m = 0.002 + 0.005 * distance(place.xyz, camera.position_m.xyz);
    let there = textureLoad(places, at, 0);
    let is_same = abs(dot(there.xyz - place.xyz, normal)) < apart_m && dot(textureLoad(normals, at, 0).xyz, normal) > 0.9;
    return there.w == place.w && (place.w == 0.0 || is_same);
}

// Whether a pixel shows more than one surface.
fn is_edge(pixel: vec2i) -> bool {
    const STEPS = array(vec2i(1, 0), vec2i(-1, 0), vec2i(0, 1), vec2i(0, -1));
    var steps = STEPS;
    let size = vec2i(textureDimensions(places));
    let place = textureLoad(places, pixel, 0);
    let normal = textureLoad(normals, pixel, 0).xyz;
    for (var i = 0; i < 4; i++) {
        if !shows(clamp(pixel + steps[i], vec2i(0), size - 1), place, normal) {
            return true;
        }
    }
    return false;
}

// Pixel `i` of 25 around another, and whether it shows the same surface.
struct Near {
    at: vec2i,
    is_same: bool,
}

fn near(pixel: vec2i, i: i32) -> Near {
    let at = pixel + SHADOW_STEP_PX * vec2i(i % 5 - 2, i / 5 - 2);
    let is_inside = all(at >= vec2i(0)) && all(at < vec2i(textureDimensions(picture)));
    if !is_inside || textureLoad(real_light, at, 0).w == 0.0 {
        return Near(at, false);
    }
    return Near(at, shows(at, textureLoad(places, pixel, 0), textureLoad(normals, pixel, 0).xyz));
}

// Albedo of the surface that a pixel shows. At the edge of a real shadow the light that was computed may change a little
// before or after the picture does. There the pixel is taken for the surface beside the edge that it can be: one whose albedo
// lies between those that the pixel would have in the most and in the least of the light around. A second round leaves out
// what the first one's mean shows to be another surface, or misplaced as well.
fn albedo_at(pixel: vec2i, light: vec3f, per_radiance: vec3f) -> vec3f {
    let radiance = radiance_of(smooth_signal(pixel), per_radiance);
    let own = albedo_of(radiance, light, per_radiance);
    var least = light;
    var most = light;
    for (var i = 0; i < 25; i++) {
        let other = near(pixel, i);
        if other.is_same {
            let there = textureLoad(real_light, other.at, 0).rgb;
            least = min(least, there);
            most = max(most, there);
        }
    }
    if all(most <= SHADOW_EDGE * least) {
        return own;
    }
    let darkest = albedo_of(radiance, most, per_radiance);
    let lightest = albedo_of(radiance, least, per_radiance);
    var beside = own;
    for (var round = 0; round < 2; round++) {
        var sum = vec3f(0.0);
        var n = 0.0;
        for (var i = 0; i < 25; i++) {
            let other = near(pixel, i);
            let there = textureLoad(real_light, other.at, 0).rgb;
            // Beside the edge, not in it.
            if !other.is_same || !(all(there > 0.95 * most) || all(there < 1.05 * least)) {
                continue;
            }
            let code = textureLoad(picture, other.at, 0).rgb;
            let signal = signal_per_radiance(other.at);
            let albedo = albedo_of(radiance_of(signal_at(code), signal), there, signal);
            let is_possible = all(albedo > 0.95 * darkest) && all(albedo < 1.05 * lightest);
            if is_possible && (round == 0 || all(abs(albedo - beside) < 2.0 * GRAIN * beside)) {
                sum += albedo;
                n += 1.0;
            }
        }
        if n > 0.0 {
            beside = sum / n;
        }
    }
    // The grain of a surface stays.
    return select(beside, own, all(abs(own - beside) < GRAIN * beside));
}

// What lamps add to a pixel at an edge: a mixture of what they add to the surfaces around, as the picture mixes them. Where
// its code lies between those of two surfaces, the inverse distances to both are their shares. w: 0 where no pixel around shows
// one surface alone.
fn added_at_edge(pixel: vec2i) -> vec4f {
    let size = vec2i(textureDimensions(picture));
    let own = vec3f(textureLoad(picture, pixel, 0).rgb);
    var sum = vec3f(0.0);
    var weights = 0.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = pixel + vec2i(dx, dy);
            if any(at < vec2i(0)) || any(at >= size) || is_edge(at) {
                continue;
            }
            let code = textureLoad(picture, at, 0).rgb;
            let weight = 1.0 / (1.0 + distance(vec3f(code), own));
            let light = textureLoad(real_light, at, 0);
            let per_radiance = signal_per_radiance(at);
            let albedo = albedo_of(radiance_of(signal_at(code), per_radiance), light.rgb, per_radiance);
            sum += select(vec3f(0.0), weight * lit_by_lamps(at, albedo), light.w > 0.0);
            weights += weight;
        }
    }
    return vec4f(sum / max(weights, 1e-6), f32(weights > 0.0));
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(picture)) {
        return;
    }
    let light = textureLoad(real_light, at.xy, 0);
    var albedo = vec4f(0.0);
    var added = vec3f(0.0);
    if light.w > 0.0 {
        let pixel = vec2i(at.xy);
        let per_radiance = signal_per_radiance(pixel);
        albedo = vec4f(albedo_at(pixel, light.rgb, per_radiance), 1.0);
        added = lit_by_lamps(pixel, albedo.rgb);
        if is_edge(pixel) {
            let mixed = added_at_edge(pixel);
            added = select(added, mixed.rgb, mixed.w > 0.0);
        }
        let own = radiance_of(signal_at(textureLoad(picture, at.xy, 0).rgb), per_radiance);
        if all(added <= LEAST_CHANGE * own) {
            added = vec3f(0.0);
        }
    }
    textureStore(out_albedo, at.xy, albedo);
    textureStore(out, at.xy, vec4f(min(added, vec3f(60000.0)), 1.0));
}
