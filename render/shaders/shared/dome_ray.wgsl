// Whether the ray from a pixel's place to a light of the dome arrives: bindings 2 to 5 of group 0.

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> maps: array<u32>;
// Word after word, each for all pixels.
@group(0) @binding(5) var<storage, read_write> bits: array<u32>;

// Lowest step over the surface in texels; how much higher each is than the one below; and their number, so that the last
// begins 64 to 128 texels high: most of what stands in a map of 256 is lower.
const FIRST_STEP_TEXELS: f32 = 1.0;
const GROWTH: f32 = 2.0;
const LOG2_GROWTH: f32 = 1.0;
const STEPS: i32 = 8;
// Steps overlap by this factor, or a ray would slip between two of them where what stands in the way is aslant.
const OVERLAP: f32 = 1.05;

// What a map stores at a place in texels; empty outside.
fn stored(light: u32, at: vec2f) -> f32 {
    let size = frame.counts.y;
    if any(at < vec2f(0.0)) || any(at >= vec2f(f32(size))) {
        return 0.0;
    }
    let texel = vec2u(at);
    return bitcast<f32>(maps[(light * size + texel.y) * size + texel.x]);
}

// Number of a pixel in its tile of 4 × 4: neighbours are far apart (an ordered dither matrix: Bayer 1973).
fn rank_in_tile(pixel: vec2u) -> u32 {
    let x = pixel.x & 3u;
    let y = pixel.y & 3u;
    let mixed = x ^ y;
    return ((mixed & 1u) << 3u) | ((y & 1u) << 2u) | (mixed & 2u) | ((y & 2u) >> 1u);
}

// Place number `index` of `n` on the unit disk, turned from light to light (Vogel 1979's spiral).
fn disk(index: u32, n: u32, light: u32) -> vec2f {
    let radius = sqrt((f32(index) + 0.5) / f32(n));
    let angle = 2.3999632 * f32(index) + 1.7 * f32(light);
    return radius * vec2f(cos(angle), sin(angle));
}

// A place in a texel for each of 16 pixels, so that together they look at all of it: texels do not show at edges.
fn in_texel(rank: u32) -> vec2f {
    let turned = (rank * 7u) & 15u;
    return (vec2f(f32(turned & 3u), f32(turned >> 2u)) - 1.5) / 4.0;
}

// A place as a light's map sees it.
struct Seen {
    // In texels.
    at: vec2f,
    // Depth along the light's view, metres; 0 for a place that the light does not reach or that turns away.
    z: f32,
    // Texels that a ray to the light's edge moves sideways per metre of height.
    reach: f32,
}

fn seen_by(light: DomeLight, point: vec3f, normal: vec3f) -> Seen {
    if light.intensity.w == 0.0 || dot(normal, light.position_m.xyz - point) <= 0.0 {
        return Seen(vec2f(0.0), 0.0, 0.0);
    }
    let lifted = vec4f(point + normal * (1.5 * light.depth.z), 1.0);
    let z = max(dot(light.forward, lifted), 0.0);
    let half_size = 0.5 * f32(frame.counts.y);
    let at = vec2f(dot(light.right, lifted), -dot(light.up, lifted)) * (half_size / max(z, 1e-6)) + half_size;
    return Seen(at, z, light.position_m.w * half_size / (light.depth.w * max(z, 1e-6)));
}

// Whether a ray arrives at a place on the light, through the light's map taken as a relief: in steps of growing height, what
// the map shows there stands in the way if its height is that of the step.
fn ray_arrives(i: u32, light: DomeLight, seen: Seen, from_texel: vec2f, sideways: vec2f, jitter: f32) -> bool {
    var low = 0.0;
    var high = FIRST_STEP_TEXELS * light.depth.z * exp2(LOG2_GROWTH * jitter);
    for (var step = 0; step < STEPS; step++) {
        // The geometric mean of the step's bounds; the first has none below.
        let middle = select(0.7071, 0.5, step == 0) * high;
        let depth = stored(i, from_texel + sideways * middle);
        // Height of what the map shows over the point, along the light's view.
        let height = seen.z - light.depth.y / (light.depth.x - depth);
        if depth > 0.0 && height > low / OVERLAP && (height <= high * OVERLAP || step == STEPS - 1) {
            return false;
        }
        low = high;
        high *= GROWTH;
    }
    return true;
}

// Whether the pixel's one ray to a light arrives; false for a bright light, whose rays are counted elsewhere.
fn arrives(i: u32, point: vec3f, normal: vec3f, pixel: vec2u) -> bool {
    if frame.sizes.w != 0u && is_bright(i) {
        return false;
    }
    let light = lights[i];
    let seen = seen_by(light, point, normal);
    if seen.z == 0.0 {
        return false;
    }
    if frame.sizes.w == 0u {
        return stored(i, seen.at) <= light.depth.x - light.depth.y / seen.z;
    }
    let rank = rank_in_tile(pixel);
    // The steps' heights differ from pixel to pixel, so that their bounds do not show.
    let jitter = fract(0.618034 * f32(rank) + 0.37 * f32(i));
    return ray_arrives(i, light, seen, seen.at + in_texel(rank), disk(rank, 16u, i) * seen.reach, jitter);
}

// How many of the pixel's rays to a bright light arrive, 0 to RAYS.
fn count_arriving(i: u32, point: vec3f, normal: vec3f, pixel: vec2u) -> u32 {
    let light = lights[i];
    let seen = seen_by(light, point, normal);
    if seen.z == 0.0 {
        return 0u;
    }
    let rank = rank_in_tile(pixel);
    var count = 0u;
    for (var ray = 0u; ray < RAYS; ray++) {
        let index = rank + 16u * ray;
        let jitter = fract(0.618034 * f32(index));
        let from_texel = seen.at + in_texel(index + ray);
        if ray_arrives(i, light, seen, from_texel, disk(index, 16u * RAYS, i) * seen.reach, jitter) {
            count++;
        }
    }
    return count;
}
