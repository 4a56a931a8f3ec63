// Light from infinitely far away, one radiance per texel of a cube, drawn by its power: bindings 2 and 3 of group 0
// (src/shadow/path/environment.rs). Needs `cube`.

// xyz: radiance; w: probability that the texel is drawn.
@group(0) @binding(2) var<storage, read> environment: array<vec4f>;
// Alias table (Walker 1977; built as Vose 1991): bits of the probability that a texel stays itself, and what else it is.
@group(0) @binding(3) var<storage, read> aliases: array<vec2u>;

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

fn sample_environment(size: u32, texel_point: vec2f, inside: vec2f) -> EnvironmentSample {
    let n = 6u * size * size;
    var index = min(u32(texel_point.x * f32(n)), n - 1u);
    let entry = aliases[index];
    if texel_point.y >= bitcast<f32>(entry.x) {
        index = entry.y;
    }
    let texel = vec3u(index % size, (index / size) % size, index / (size * size));
    let direction = texel_direction(size, texel, inside);
    let found = environment[index];
    return EnvironmentSample(direction, found.rgb, texel_density(found.w, size, direction));
}
