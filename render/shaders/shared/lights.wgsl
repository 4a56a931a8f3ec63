// What all fragments share: lights, objects, materials, environments. World frame, metres.

struct Frame {
    counts: vec4u,
    ball_m: vec4f,
    // Spheres (centre, radius) that hold the receivers, the virtual objects, and everything.
    receivers_m: vec4f,
    virtuals_m: vec4f,
    everything_m: vec4f,
    // Spheres around virtual objects, four at most, a negative radius for none.
    casters_m: array<vec4f, 4>,
}

struct Light {
    position_m: vec4f,
    intensity: vec4f,
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
