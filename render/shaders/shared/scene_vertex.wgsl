// The scene's vertices where they stand now, and the light on them: bindings 0 to 5 of group 0 (src/passes/memory.rs). Needs
// `lights` and `sh`.

@group(0) @binding(0) var<storage, read> vertex_words: array<u32>;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
// x: part of the real things that it belongs to, NO_PART for none; y: 1 where the probe sees it.
@group(0) @binding(2) var<storage, read> facts: array<vec2u>;
@group(0) @binding(3) var<uniform> environments: array<Environment, 16>;
// Nine coefficients per environment, sixteen apart: all its light.
@group(0) @binding(4) var<uniform> harmonics: array<vec4f, 256>;
// x: number of environments.
@group(0) @binding(5) var<uniform> counts: vec4u;

const VERTEX_WORDS = 20u;
const NO_PART = 0xffffffffu;

struct PlacedVertex {
    place: vec3f,
    // Unit.
    normal: vec3f,
}

fn vertex_vector(vertex: u32, word: u32) -> vec3f {
    let at = vertex * VERTEX_WORDS + word;
    return bitcast<vec3f>(vec3u(vertex_words[at], vertex_words[at + 1u], vertex_words[at + 2u]));
}

fn placed_vertex(vertex: u32) -> PlacedVertex {
    let world_from_object = objects[vertex_words[vertex * VERTEX_WORDS + 3u]].world_from_object;
    let place = (world_from_object * vec4f(vertex_vector(vertex, 0u), 1.0)).xyz;
    let normal = (world_from_object * vec4f(vertex_vector(vertex, 4u), 0.0)).xyz;
    return PlacedVertex(place, normalize(normal));
}

// Irradiance of all the light around the nearest environment.
fn irradiance_at(vertex: PlacedVertex) -> vec3f {
    var nearest = 0u;
    for (var i = 1u; i < counts.x; i++) {
        if distance(environments[i].position_m.xyz, vertex.place) < distance(environments[nearest].position_m.xyz, vertex.place) {
            nearest = i;
        }
    }
    let basis = sh_basis(vertex.normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * harmonics[16u * nearest + i].rgb;
    }
    return max(sum, vec3f(0.0));
}
