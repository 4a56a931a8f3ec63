// Irradiance of the environment on the surfaces of a picture, twice: past one set of things, and past that set and another.
// Every ray serves both sums, so that their ratio has little noise. Half of the rays are drawn by the environment's power,
// half by the cosine (Veach and Guibas 1995, the balance heuristic).

#import bvh
#import sampling
#import cube
#import environment_map

struct Settings {
    // First ray and number of rays of this pass, seed, texels along the environment's edge.
    counts: vec4u,
    // Roots of the two hierarchies; z: whether the environment's power is drawn; w: unused.
    roots: vec4u,
    // x: how far off the surface rays start, metres.
    lengths: vec4f,
}

struct Sum {
    without: vec4f,
    with_all: vec4f,
}

@group(0) @binding(4) var places: texture_2d<f32>;
@group(0) @binding(5) var normals: texture_2d<f32>;
@group(0) @binding(6) var<uniform> settings: Settings;
@group(0) @binding(7) var<storage, read_write> sums: array<Sum>;
@group(0) @binding(8) var without: texture_storage_2d<rgba32float, write>;
@group(0) @binding(9) var with_all: texture_storage_2d<rgba32float, write>;

// Direction of ray `index`: even ones by the environment, odd ones by the cosine.
fn drawn_direction(index: u32, seed: u32, frame: mat3x3f) -> vec3f {
    let turn = index / 2u;
    if settings.roots.z == 0u || (index & 1u) == 1u {
        return frame * cosine_direction(sample_2d(select(turn, index, settings.roots.z == 0u), seed, 0u));
    }
    return sample_environment(settings.counts.w, sample_2d(turn, seed, 1u)).direction;
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = textureDimensions(places);
    if any(at.xy >= size) {
        return;
    }
    let pixel = at.y * size.x + at.x;
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(without, at.xy, vec4f(0.0));
        textureStore(with_all, at.xy, vec4f(0.0));
        return;
    }
    let normal = normalize(textureLoad(normals, at.xy, 0).xyz);
    let frame = basis_around(normal);
    let origin = place.xyz + settings.lengths.x * normal;
    let seed = pcg(pixel ^ pcg(settings.counts.z));
    var sum = sums[pixel];
    for (var i = settings.counts.x; i < settings.counts.x + settings.counts.y; i++) {
        let direction = drawn_direction(i, seed, frame);
        let cosine = dot(direction, normal);
        sum.without.w += 1.0;
        if cosine <= 0.0 {
            continue;
        }
        let sky = environment_towards(settings.counts.w, direction);
        var density = cosine * 0.31830987;
        if settings.roots.z != 0u {
            density = 0.5 * (density + sky.w);
        }
        if any_hit(settings.roots.x, origin, direction, FAR_M) {
            continue;
        }
        let arriving = sky.rgb * (cosine / density);
        sum.without += vec4f(arriving, 0.0);
        if !any_hit(settings.roots.y, origin, direction, FAR_M) {
            sum.with_all += vec4f(arriving, 0.0);
        }
    }
    sums[pixel] = sum;
    let n = max(sum.without.w, 1.0);
    textureStore(without, at.xy, vec4f(sum.without.rgb / n, 1.0));
    textureStore(with_all, at.xy, vec4f(sum.with_all.rgb / n, 1.0));
}
