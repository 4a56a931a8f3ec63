// Whether the ray from a pixel's place to a light of the dome arrives: bindings 2 to 5 of group 0.

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> maps: array<u32>;
// Word after word, each for all pixels.
@group(0) @binding(5) var<storage, read_write> bits: array<u32>;

// Lowest step over the surface in texels; how much higher each is than the one below; and their number, so that the last
// begins 100 to 250 texels high: more than what stands in a map of 256 is tall.
const FIRST_STEP_TEXELS: f32 = 1.0;
const GROWTH: f32 = 2.5;
const LOG2_GROWTH: f32 = 1.3219281;
const STEPS: i32 = 7;
// Steps overlap by this factor, or a ray would slip between two of them where what stands in the way is aslant.
const OVERLAP: f32 = 1.3;

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

// A place on the unit disk for each of the 16 pixels of a tile, turned from light to light (Vogel 1979's spiral).
fn disk(rank: u32, light: u32) -> vec2f {
    let radius = sqrt((f32(rank) + 0.5) / 16.0);
    let angle = 2.3999632 * f32(rank) + 1.7 * f32(light);
    return radius * vec2f(cos(angle), sin(angle));
}

// A place in a texel for each of the 16, so that together they look at all of it: texels do not show at edges.
fn in_texel(rank: u32) -> vec2f {
    let turned = (rank * 7u) & 15u;
    return (vec2f(f32(turned & 3u), f32(turned >> 2u)) - 1.5) / 4.0;
}

fn arrives(i: u32, point: vec3f, normal: vec3f, pixel: vec2u) -> bool {
    let light = lights[i];
    if light.intensity.w == 0.0 || dot(normal, light.position_m.xyz - point) <= 0.0 {
        return false;
    }
    let texel_m = light.depth.z;
    let lifted = vec4f(point + normal * (1.5 * texel_m), 1.0);
    let z = dot(light.forward, lifted);
    if z <= 0.0 {
        return true;
    }
    let half_size = 0.5 * f32(frame.counts.y);
    let at = vec2f(dot(light.right, lifted), -dot(light.up, lifted)) * (half_size / z) + half_size;
    if frame.sizes.w == 0u {
        return stored(i, at) <= light.depth.x - light.depth.y / z;
    }
    // Texels that the ray moves sideways per metre of height.
    let rank = rank_in_tile(pixel);
    let from_texel = at + in_texel(rank);
    let sideways = disk(rank, i) * (light.position_m.w * half_size / (light.depth.w * z));
    // The steps' heights differ from pixel to pixel, so that their bounds do not show.
    let jitter = fract(0.618034 * f32(rank) + 0.37 * f32(i));
    var low = 0.0;
    var high = FIRST_STEP_TEXELS * texel_m * exp2(LOG2_GROWTH * jitter);
    for (var step = 0; step < STEPS; step++) {
        // The geometric mean of the step's bounds; the first has none below.
        let middle = select(0.632, 0.5, step == 0) * high;
        let depth = stored(i, from_texel + sideways * middle);
        // Height of what the map shows over the point, along the light's view.
        let height = z - light.depth.y / (light.depth.x - depth);
        if depth > 0.0 && height > low / OVERLAP && (height <= high * OVERLAP || step == STEPS - 1) {
            return false;
        }
        low = high;
        high *= GROWTH;
    }
    return true;
}
