// The real mirror ball shows virtual objects and their shadows: the ratio by which they change what it mirrors, per pixel. All
// other pixels keep their ratio.

#import bvh
#import scene_ray
#import camera
#import lights
#import sh
#import brdf
#import material
#import hit_substance
#import seen
#import ray_light
#import real_memory
#import virtual_hit

// Ratio on phantoms, alpha 1 where there is one.
@group(0) @binding(13) var phantom_ratio: texture_2d<f32>;
@group(0) @binding(14) var out: texture_storage_2d<rgba16float, write>;

// Rays along each edge of a pixel.
const RAYS = 2u;
// No picture is made brighter than so many times: it is mostly noise then.
const MOST = 64.0;

// From the ball's place in a pixel to that in the next one; zero where the next one shows something else.
fn step_to(pixel: vec2i, step: vec2i, here: vec3f) -> vec3f {
    let size = vec2i(textureDimensions(real_places));
    let ahead = textureLoad(real_places, min(pixel + step, size - 1), 0);
    let back = textureLoad(real_places, max(pixel - step, vec2i(0)), 0);
    if ahead.w > 0.0 && is_on_ball(ahead.xyz) {
        return ahead.xyz - here;
    }
    return select(vec3f(0.0), here - back.xyz, back.w > 0.0 && is_on_ball(back.xyz));
}

// Ratio along one ray; `shown` is the radiance that the picture shows there.
fn ratio_along(beam: Beam, shown: vec3f) -> vec3f {
    let hit = scene_hit(ALL_OBJECTS, beam.origin, beam.direction, FAR_M);
    if hit.object == NOTHING {
        return vec3f(1.0);
    }
    let facts = instances[hit.object].facts;
    if (facts.y & VIRTUALS) != 0u {
        let light = probe.ball_reflectance.rgb * light_along(beam, facts.z);
        return min(light / max(shown, vec3f(1e-6)), vec3f(MOST));
    }
    let pixel = seen_at(beam.origin + beam.direction * hit.distance_m);
    if pixel.x < 0.0 {
        return vec3f(1.0);
    }
    let there = textureLoad(phantom_ratio, vec2i(round(pixel)), 0);
    return select(vec3f(1.0), there.rgb, there.a > 0.0);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(phantom_ratio)) {
        return;
    }
    var ratio = textureLoad(phantom_ratio, at.xy, 0);
    let place = textureLoad(real_places, at.xy, 0);
    if place.w > 0.0 && is_on_ball(place.xyz) {
        let right = step_to(vec2i(at.xy), vec2i(1, 0), place.xyz);
        let down = step_to(vec2i(at.xy), vec2i(0, 1), place.xyz);
        let width_m = max(length(right), length(down)) / f32(RAYS);
        let shown = textureLoad(real, at.xy, 0).rgb;
        var sum = vec3f(0.0);
        for (var i = 0u; i < RAYS * RAYS; i++) {
            let offset = (vec2f(vec2u(i % RAYS, i / RAYS)) + 0.5) / f32(RAYS) - 0.5;
            let normal = normalize(place.xyz + right * offset.x + down * offset.y - probe.ball_m.xyz);
            let on_ball = probe.ball_m.xyz + normal * probe.ball_m.w;
            let from_eye = on_ball - camera.position_m.xyz;
            let spread = width_m / length(from_eye) + 2.0 * width_m / probe.ball_m.w;
            // The phantom is made of flat triangles, some of which lie a little outside of the ball.
            let start = on_ball + 0.01 * probe.ball_m.w * normal;
            sum += ratio_along(Beam(start, reflect(normalize(from_eye), normal), width_m, spread), shown);
        }
        ratio = vec4f(sum / f32(RAYS * RAYS), 1.0);
    }
    textureStore(out, at.xy, ratio);
}
