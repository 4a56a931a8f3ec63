// What the camera's sensor adds to light: shot noise and read noise. CPU twin: src/reference/noise.rs.

struct Noise {
    // Variance of the signal of red, green and blue per unit of signal: shot noise; w: unused.
    shot: vec4f,
    // Variance of the signal whatever the light: read noise; w: unused.
    read: vec4f,
    // x: number of the frame; y, z, w: unused.
    frame: vec4u,
}

// Four integers that look random, from four (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering": pcg4d).
fn pcg4d(seed: vec4u) -> vec4u {
    var v = seed * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4u(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Three independent normal numbers of mean 0 and variance 1, always the same for a pixel of a frame (Box and Muller 1958).
fn normals_of(pixel: vec2u, frame: u32) -> vec3f {
    // 24 bits are what a float holds; half a step keeps the logarithm's argument above 0.
    let uniforms = (vec4f(pcg4d(vec4u(pixel, frame, 0u)) >> vec4u(8u)) + 0.5) / 16777216.0;
    let radius = sqrt(-2.0 * log(uniforms.xy));
    let angle = 6.28318531 * uniforms.zw;
    return vec3f(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y));
}
