// sRGB codes of linear light (IEC 61966-2-1).

fn srgb(linear: vec3f) -> vec3f {
    let x = clamp(linear, vec3f(0.0), vec3f(1.0));
    return select(1.055 * pow(x, vec3f(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3f(0.0031308));
}

// One pixel as a 32-bit number, red in the lowest byte.
fn packed_srgb(linear: vec3f) -> u32 {
    let codes = vec3u(round(255.0 * srgb(linear)));
    return codes.r | (codes.g << 8u) | (codes.b << 16u) | (255u << 24u);
}
