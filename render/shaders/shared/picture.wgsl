// The camera's picture as radiance. The importing shader declares `picture` and `response`.

struct PictureSample {
    radiance: vec3f,
    // Bit per channel of the camera that clips in any of the pixels: 1 red, 2 green, 4 blue.
    clipped: u32,
    // The same where it clips in all of them.
    all_clipped: u32,
}

// Radiance at a pixel inside the picture, bilinear in linear light, in the rig's common RGB.
fn sample_picture(camera: Camera, pixel: vec2f) -> PictureSample {
    let last = vec2i(camera.limits.zw) - 1;
    let corner = clamp(vec2i(floor(pixel)), vec2i(0), max(last - 1, vec2i(0)));
    let f = pixel - vec2f(corner);
    var signal = vec3f(0.0);
    var clipped = 0u;
    var all_clipped = 7u;
    for (var i = 0; i < 4; i++) {
        let step = vec2i(i & 1, i >> 1);
        let weight = mix(1.0 - f.x, f.x, f32(step.x)) * mix(1.0 - f.y, f.y, f32(step.y));
        if weight > 0.0 {
            let code = textureLoad(picture, min(corner + step, last), 0).rgb;
            signal += weight * vec3f(response[code.r], response[code.g], response[code.b]);
            let bits = select(0u, 1u, code.r >= 255u) | select(0u, 2u, code.g >= 255u) | select(0u, 4u, code.b >= 255u);
            clipped |= bits;
            all_clipped &= bits;
        }
    }
    let radiance = signal / (camera.signal_per_radiance.xyz * vignetting(camera, pixel));
    return PictureSample((camera.common_from_camera * vec4f(radiance, 0.0)).xyz, clipped, all_clipped);
}

// Whether bilinear sampling at a pixel stays inside the picture.
fn is_inside(camera: Camera, pixel: vec2f) -> bool {
    return all(pixel >= vec2f(0.0)) && all(pixel <= camera.limits.zw - 1.0);
}
