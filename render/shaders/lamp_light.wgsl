// Light of the virtual lamps on a surface: what they give where nothing is in the way, times the shares that get past all
// objects. Shares of soft lamps are the mean over a tile of 4 × 4 pixels. CPU twin: src/reference/lamp_light.rs.

#import sampling
#import lamp
#import lamp_ray

@group(0) @binding(0) var<uniform> lamps: Lamps;
@group(0) @binding(1) var places: texture_2d<f32>;
@group(0) @binding(2) var normals: texture_2d<f32>;
// Shares by the pixel's own rays, four lamps per layer; the same put together.
@group(0) @binding(3) var own_shares: texture_2d_array<f32>;
@group(0) @binding(4) var out_shares: texture_storage_2d_array<rgba16float, write>;
// Irradiance.
@group(0) @binding(5) var out: texture_storage_2d<rgba16float, write>;

// Places on a soft lamp that its unshaded light is summed up from.
const PLACES = 16u;

// Shares of the pixel's own rays, and the mean over those around it on the same surface.
struct Shares {
    own: array<vec4f, 2>,
    mean: array<vec4f, 2>,
}

fn own_at(pixel: vec2i) -> array<vec4f, 2> {
    return array(textureLoad(own_shares, pixel, 0, 0), textureLoad(own_shares, pixel, 1, 0));
}

fn shares_around(pixel: vec2i, place: vec3f, normal: vec3f) -> Shares {
    let size = vec2i(textureDimensions(places));
    let own = own_at(pixel);
    // What a pixel spans on the surface, metres.
    let right = min(pixel + vec2i(1, 0), size - 1);
    let left = max(pixel - vec2i(1, 0), vec2i(0));
    let step_m = 0.5 * min(
        distance(textureLoad(places, right, 0).xyz, place),
        distance(textureLoad(places, left, 0).xyz, place),
    );
    let thickness = max(2.0 * step_m, 1e-5);
    var sum = own;
    var weight = 1.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = pixel + vec2i(dx, dy);
            if (dx == 0 && dy == 0) || any(at < vec2i(0)) || any(at >= size) {
                continue;
            }
            let there = textureLoad(places, at, 0);
            let turned = dot(textureLoad(normals, at, 0).xyz, normal);
            if there.w == 0.0 || turned < 0.9 || abs(dot(there.xyz - place, normal)) > thickness {
                continue;
            }
            // Five wide with half weight at the ends: every pixel of a 4 × 4 tile counts once.
            let share = select(1.0, 0.5, abs(dx) == 2) * select(1.0, 0.5, abs(dy) == 2);
            let shares = own_at(at);
            sum[0] += share * shares[0];
            sum[1] += share * shares[1];
            weight += share;
        }
    }
    return Shares(own, array(sum[0] / weight, sum[1] / weight));
}

// Irradiance of a lamp, relative to its own, where nothing is in the way.
fn unshaded(index: u32, place: vec3f, normal: vec3f) -> f32 {
    let n = select(1u, PLACES, is_lamp_soft(index));
    var sum = 0.0;
    for (var i = 0u; i < n; i++) {
        let ray = lamp_ray(lamps.all[index], place, sample_2d(i, index, 0u));
        sum += ray.strength * max(dot(ray.towards, normal), 0.0);
    }
    return sum / f32(n);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var shares = array<vec4f, 2>();
    var irradiance = vec3f(0.0);
    if place.w > 0.0 {
        let normal = textureLoad(normals, at.xy, 0).xyz;
        var around = shares_around(vec2i(at.xy), place.xyz, normal);
        for (var i = 0u; i < lamps.counts.x; i++) {
            let share = select(around.own[i / 4u][i % 4u], around.mean[i / 4u][i % 4u], is_lamp_soft(i));
            shares[i / 4u][i % 4u] = share;
            irradiance += share * unshaded(i, place.xyz, normal) * lamps.all[i].irradiance.rgb;
        }
    }
    textureStore(out_shares, at.xy, 0, shares[0]);
    textureStore(out_shares, at.xy, 1, shares[1]);
    textureStore(out, at.xy, vec4f(min(irradiance, vec3f(60000.0)), 1.0));
}
