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

struct Material {
    base_color: vec4f,
    dielectric: vec4f,
    parameters: vec4f,
}

struct Environment {
    position_m: vec4f,
    probe_m: vec4f,
}
