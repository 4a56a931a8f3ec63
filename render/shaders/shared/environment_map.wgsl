// Light from infinitely far away, one radiance per texel of a cube, drawn by its power: bindings 2 and 3 of group 0
// (src/shadow/path/environment.rs). Needs `cube`.

// xyz: radiance; w: probability that the texel is drawn.
@group(0) @binding(2) var<storage, read> environment: array<vec4f>;
// Texels in an order in which neighbours lie together: bits of the probability of all up to this one, and its index.
@group(0) @binding(3) var<storage, read> cells: array<vec2u>;

struct EnvironmentSample {
    direction: vec3f,
    radiance: vec3f,
    // Per steradian.
    density: f32,
}

// Density per steradian of a texel's directions, drawn evenly over its square.
fn texel_density(probability: f32, size: u32, direction: vec3f) -> f32 {
    let along = max(abs(direction.x), max(abs(direction.y), abs(direction.z)));
    return probability * f32(size * size) / (4.0 * along * along * along);
}

// Radiance from a direction (unit), and the density that `sample_environment` draws it with.
fn environment_towards(size: u32, direction: vec3f) -> vec4f {
    let texel = environment[texel_index(size, direction)];
    return vec4f(texel.rgb, texel_density(texel.w, size, direction));
}

// A point of the unit square: x chooses the texel, and what is left of it and y the place in it, so that points that fill
// the square evenly give directions that do so, too.
fn sample_environment(size: u32, u: vec2f) -> EnvironmentSample {
    var low = 0u;
    var high = 6u * size * size - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if bitcast<f32>(cells[middle].x) > u.x {
            high = middle;
        } else {
            low = middle + 1u;
        }
    }
    let index = cells[low].y;
    let found = environment[index];
    let rest = clamp(1.0 - (bitcast<f32>(cells[low].x) - u.x) / max(found.w, 1e-30), 0.0, 1.0);
    let texel = vec3u(index % size, (index / size) % size, index / (size * size));
    let direction = texel_direction(size, texel, vec2f(rest, u.y));
    return EnvironmentSample(direction, found.rgb, texel_density(found.w, size, direction));
}
