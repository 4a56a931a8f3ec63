// What all fragments share: objects, materials, environments. World frame, metres.

struct Frame {
    // x: number of environments.
    counts: vec4u,
    ball_m: vec4f,
}

struct Object {
    world_from_object: mat4x4f,
    environment: vec4u,
}

struct Map {
    matrix: vec4f,
    place: vec4f,
    facts: vec4u,
}

struct Material {
    base_color: vec4f,
    dielectric: vec4f,
    emission: vec4f,
    attenuation: vec4f,
    sheen: vec4f,
    surface: vec4f,
    coat: vec4f,
    glass: vec4f,
    kinds: vec4u,
    maps: array<Map, 14>,
}

struct Environment {
    position_m: vec4f,
    probe_m: vec4f,
}
