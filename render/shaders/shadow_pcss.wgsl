// Percentage-closer soft shadows of a rectangular light (Fernando 2005): search the blockers, estimate the penumbra's width
// by similar triangles, filter over that width.
//
// The map lies parallel to the light and its axes are the light's, so the filter is a box of the light's own shape and the
// depths are those of the similar triangles.

#import map_view
#import key_light

const N_SEARCH: u32 = 32u;
const N_FILTER: u32 = 64u;

@group(0) @binding(0) var<uniform> atlas: Atlas;
@group(0) @binding(1) var<storage, read> views: array<MapView>;
@group(0) @binding(2) var<uniform> light: KeyLight;
@group(0) @binding(3) var depths: texture_depth_2d;
// Nearest depths of the map, level by level (src/shadow/nearest.rs).
@group(0) @binding(4) var<storage, read> nearest: array<f32>;
@group(0) @binding(5) var places: texture_2d<f32>;
@group(0) @binding(6) var normals: texture_2d<f32>;
@group(0) @binding(7) var visibility: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var share = 1.0;
    if place.w > 0.0 {
        share = share_lit(place.xyz, textureLoad(normals, at.xy, 0).xyz, vec2f(at.xy));
    }
    textureStore(visibility, at.xy, vec4f(vec3f(share), 1.0));
}

fn share_lit(point: vec3f, normal: vec3f, pixel: vec2f) -> f32 {
    let highest = dot(normal, light.position_m.xyz - point) + abs(dot(normal, light.u.xyz)) + abs(dot(normal, light.v.xyz));
    if highest <= 0.0 {
        // The whole light is behind the surface.
        return 0.0;
    }
    let seen = seen_from(views[0], atlas.shape.x, point, normal);
    if !seen.is_seen {
        return 1.0;
    }
    let search = search_reach(seen);
    if search.x < 0.0 {
        return 1.0;
    }
    let shift = vec2f(noise(pixel), noise(pixel + vec2f(47.0, 17.0)));
    let blocker_m = mean_blocker_m(seen, search, shift);
    if blocker_m <= 0.0 {
        return 1.0 + blocker_m;
    }
    return filtered(seen, max(reach_at(seen, blocker_m), vec2f(0.5)), shift);
}

// Half the penumbra that something at a distance from the light casts around the seen point, texels.
fn reach_at(seen: Seen, blocker_m: f32) -> vec2f {
    let half_light_m = vec2f(length(light.u.xyz), length(light.v.xyz));
    return half_light_m * max(seen.distance_m - blocker_m, 0.0) / (blocker_m * seen.texel_m);
}

fn metres(depth: f32) -> f32 {
    let near = views[0].forward.w;
    let far = views[0].middle.z;
    return far * near / max(far - depth * (far - near), 1e-12);
}

// Half the part of the map that can hold blockers, texels; negative where there are none. What is nearest in the whole map
// says how far that part reaches, what is nearest in the part narrows it.
fn search_reach(seen: Seen) -> vec2f {
    var depth = nearest[arrayLength(&nearest) - 1u];
    var reach = vec2f(0.0);
    for (var i = 0u; i < 3u; i++) {
        if depth >= seen.depth - depth_bias(seen, 1.0) {
            return vec2f(-1.0);
        }
        reach = max(reach_at(seen, metres(depth)), vec2f(0.5));
        let narrower = nearest_within(seen.texel, reach);
        if narrower <= depth {
            break;
        }
        depth = narrower;
    }
    return reach;
}

fn nearest_within(texel: vec2f, reach: vec2f) -> f32 {
    // The finest level has half the map's edge, rounded up to a power of two.
    let finest = 1u << (32u - countLeadingZeros((atlas.shape.x + 1u) / 2u - 1u));
    // Cells at least as wide as the reach: three a side at most.
    let wanted = u32(max(ceil(log2(max(reach.x, reach.y))) - 1.0, 0.0));
    let level = min(wanted, firstTrailingBit(finest));
    let edge = finest >> level;
    // The levels before are a geometric series.
    let start = (finest * finest - edge * edge) / 3u * 4u;
    let cell = f32(2u << level);
    let low = clamp(vec2i(floor((texel - reach) / cell)), vec2i(0), vec2i(i32(edge) - 1));
    let high = clamp(vec2i(floor((texel + reach) / cell)), vec2i(0), vec2i(i32(edge) - 1));
    var least = 1.0;
    for (var y = low.y; y <= high.y; y++) {
        for (var x = low.x; x <= high.x; x++) {
            least = min(least, nearest[start + u32(y) * edge + u32(x)]);
        }
    }
    return least;
}

// Mean distance of the blockers from the light; 0 without any and -1 where nothing else was found. Each counts by the share
// of the light that it covers, seen from the point, so that what is close keeps its sharp shadow; more samples fall on what
// is close to the middle for the same reason.
fn mean_blocker_m(seen: Seen, reach: vec2f, shift: vec2f) -> f32 {
    let bias = plane_bias(seen);
    var sum = vec2f(0.0);
    var n_blocked = 0u;
    for (var i = 0u; i < N_SEARCH; i++) {
        let at = sample_place(i, N_SEARCH, shift);
        let found = blocker_at(seen, at * abs(at) * reach, bias);
        n_blocked += u32(found.is_in_front);
        if found.is_blocker {
            let covered = max(reach_at(seen, found.distance_m), vec2f(0.5));
            let weight = (abs(at.x * at.y) + 1e-3) / sqrt(covered.x * covered.y);
            sum += weight * vec2f(found.distance_m, 1.0);
        }
    }
    if n_blocked == N_SEARCH {
        return -1.0;
    }
    return select(0.0, sum.x / max(sum.y, 1e-30), sum.y > 0.0);
}

fn filtered(seen: Seen, reach: vec2f, shift: vec2f) -> f32 {
    let bias = plane_bias(seen);
    // A filter of few texels needs few samples.
    let n_samples = select(N_FILTER, N_FILTER / 2u, max(reach.x, reach.y) < 4.0);
    var n_near = 0u;
    for (var i = 0u; i < n_samples; i++) {
        n_near += u32(blocker_at(seen, sample_place(i, n_samples, shift) * reach, bias).is_near);
    }
    return 1.0 - f32(n_near) / f32(n_samples);
}

// What a surface must lie behind another one, in depth, and more per texel beside the point: half floats in the normal lift
// its plane.
fn plane_bias(seen: Seen) -> vec2f {
    let tangent = slant(seen);
    return vec2f(depth_bias(seen, 1.0), 2e-3 * (1.0 + tangent * tangent) * texel_depth(seen));
}

struct Found {
    // Nearer to the light than the point's plane.
    is_in_front: bool,
    // And inside the pyramid from the point to the light.
    is_blocker: bool,
    // And not far outside: the wall beyond a corner is in front of the floor's plane, but not in between. A little outside,
    // what is behind it and hidden from the light's middle may well be in between.
    is_near: bool,
    distance_m: f32,
}

// What the map holds `offset` texels beside the seen point.
fn blocker_at(seen: Seen, offset: vec2f, plane: vec2f) -> Found {
    let both = depths_at(depths, vec2i(0), i32(atlas.shape.x), vec2i(floor(seen.texel + offset)), seen);
    let bias = plane.x + plane.y * max(abs(offset.x), abs(offset.y));
    if min(both.y - bias, 1.0) <= both.x {
        return Found(false, false, false, 0.0);
    }
    let distance_m = metres(both.x);
    let own = reach_at(seen, distance_m);
    return Found(true, all(abs(offset) <= own + 1.0), all(abs(offset) <= 2.0 * own + 1.0), distance_m);
}

// Sample `i` of `n` in -1 ..= 1, twice: Hammersley's points, which fall into n different strips along both axes, shifted
// from pixel to pixel so that what is left of the error is noise (Cranley and Patterson 1976).
fn sample_place(i: u32, n: u32, shift: vec2f) -> vec2f {
    let at = vec2f((f32(i) + 0.5) / f32(n), f32(reverseBits(i)) * 2.3283064e-10);
    return 2.0 * fract(at + shift) - 1.0;
}

// Interleaved gradient noise (Jimenez 2014).
fn noise(pixel: vec2f) -> f32 {
    return fract(52.9829189 * fract(dot(pixel, vec2f(0.06711056, 0.00583715))));
}
