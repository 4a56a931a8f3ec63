// Whether the ray from a pixel's place to a light of the dome arrives: bindings 2 to 5 of group 0.

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> maps: array<u32>;
// Word after word, each for all pixels.
@group(0) @binding(5) var<storage, read_write> bits: array<u32>;

// Lowest step over the surface in texels, and the number of steps of doubling height.
const FIRST_STEP_TEXELS: f32 = 1.0;
const STEPS: i32 = 6;

// What a map stores at a place in texels; empty outside.
fn stored(light: u32, at: vec2f) -> f32 {
    let size = frame.counts.y;
    if any(at < vec2f(0.0)) || any(at >= vec2f(f32(size))) {
        return 0.0;
    }
    let texel = vec2u(at);
    return bitcast<f32>(maps[(light * size + texel.y) * size + texel.x]);
}

// A place on the unit disk for one of the 16 pixels of a tile, turned from light to light (Vogel 1979's spiral).
fn disk(pixel: vec2u, light: u32) -> vec2f {
    let x = pixel.x & 3u;
    let y = pixel.y & 3u;
    // Neighbours in the tile lie far apart on the spiral: an ordered dither matrix (Bayer 1973).
    let mixed = x ^ y;
    let rank = ((mixed & 1u) << 3u) | ((y & 1u) << 2u) | (mixed & 2u) | ((y & 2u) >> 1u);
    let radius = sqrt((f32(rank) + 0.5) / 16.0);
    let angle = 2.3999632 * f32(rank) + 1.7 * f32(light);
    return radius * vec2f(cos(angle), sin(angle));
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
    let sideways = disk(pixel, i) * (light.position_m.w * half_size / (light.depth.w * z));
    // The steps' heights differ from pixel to pixel, so that their bounds do not show.
    let jitter = f32((pixel.x * 5u + pixel.y * 3u + i) & 7u) / 8.0;
    var low = 0.0;
    var high = FIRST_STEP_TEXELS * texel_m * exp2(jitter);
    for (var step = 0; step < STEPS; step++) {
        let middle = select(0.75, 0.5, step == 0) * high;
        let depth = stored(i, at + sideways * middle);
        // Height of what the map shows over the point, along the light's view.
        let height = z - light.depth.y / (light.depth.x - depth);
        if depth > 0.0 && height > low && (height <= high || step == STEPS - 1) {
            return false;
        }
        low = high;
        high *= 2.0;
    }
    return true;
}
