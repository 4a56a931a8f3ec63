// Light from afar past all shadows, and light from near things: bindings 0 to 7 of group 0 (src/passes/direct.rs).

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
@group(0) @binding(2) var<uniform> environments: array<Environment, 16>;
// Nine coefficients per environment, sixteen apart.
@group(0) @binding(3) var<uniform> near_sh: array<vec4f, 256>;
// Irradiance from afar past the real things alone, and past all objects.
@group(0) @binding(4) var light_without: texture_2d<f32>;
@group(0) @binding(5) var light_with: texture_2d<f32>;
// Irradiance of virtual lamps, past all objects.
@group(0) @binding(6) var light_lamps: texture_2d<f32>;
// Irradiance from near things: all of it on virtual objects, what virtual objects change of it on phantoms.
@group(0) @binding(7) var light_near: texture_2d<f32>;

// Irradiance from real things near environment `slot`.
fn near_irradiance(slot: u32, normal: vec3f) -> vec3f {
    let basis = sh_basis(normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * near_sh[16u * slot + i].rgb;
    }
    return max(sum, vec3f(0.0));
}

// The environment nearest to a point, of `n`.
fn nearest_environment(point: vec3f, n: u32) -> u32 {
    var nearest = 0u;
    for (var i = 1u; i < n; i++) {
        if distance(environments[i].position_m.xyz, point) < distance(environments[nearest].position_m.xyz, point) {
            nearest = i;
        }
    }
    return nearest;
}
