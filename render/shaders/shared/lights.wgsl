// What all fragments share: lights, objects, materials, environments. World frame, metres.

struct Frame {
    counts: vec4u,
    ball_m: vec4f,
}

struct Light {
    position_m: vec4f,
    intensity: vec4f,
    texel_m: vec4f,
    phantom_clip_from_world: mat4x4f,
    virtual_clip_from_world: mat4x4f,
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
