// A dome of lights (src/shadow/dome). World frame, metres.

struct DomeLight {
    // w: tangent of half the angle that it fills.
    position_m: vec4f,
    // w: 1 for a light that shines.
    intensity: vec4f,
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    // Stored depth is x - y / depth; z: size of a texel, metres; w: tangent of half the opening angle.
    depth: vec4f,
}

struct Frame {
    counts: vec4u,
    sizes: vec4u,
    unshaded: vec4f,
    // A bit per light: those whose shadows show.
    bright: array<vec4u, 2>,
}

@group(0) @binding(0) var<uniform> frame: Frame;
// Uniform, not storage: software drivers read storage one lane at a time.
@group(0) @binding(1) var<uniform> lights: array<DomeLight, 256>;

// Irradiance of a light of intensity 1 on a surface, shadows aside.
fn unshadowed(position_m: vec3f, point: vec3f, normal: vec3f) -> f32 {
    let to_light = position_m - point;
    let inverse = inverseSqrt(dot(to_light, to_light));
    return max(dot(normal, to_light), 0.0) * inverse * inverse * inverse;
}
