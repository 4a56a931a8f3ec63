// What picture and predicted light say of a phantom's pixel: bindings 8 to 13 of group 0, beside those of `direct`.

@group(0) @binding(8) var<uniform> frame: Frame;
@group(0) @binding(9) var places: texture_2d<f32>;
@group(0) @binding(10) var normals: texture_2d<f32>;
// Irradiance of the bright lights past the real things that are known.
@group(0) @binding(11) var light_bright: texture_2d<f32>;
@group(0) @binding(12) var picture: texture_2d<u32>;
@group(0) @binding(13) var<storage, read> response: array<f32>;

struct PhantomPixel {
    radiance: vec3f,
    // Predicted, near things included.
    irradiance: vec3f,
    bright: vec3f,
    // Whether the picture tells the radiance: no channel clips.
    is_clear: bool,
}

fn phantom_pixel(pixel: vec2u, near: vec3f) -> PhantomPixel {
    let seen = sample_picture(camera, vec2f(pixel));
    return PhantomPixel(
        seen.radiance,
        textureLoad(light_without, pixel, 0).rgb + near,
        textureLoad(light_bright, pixel, 0).rgb,
        seen.clipped == 0u,
    );
}

// Logarithm of the reflectance of a surface of this radiance; dark noise counts as a thousandth.
fn log_reflectance(radiance: vec3f, irradiance: vec3f) -> vec3f {
    return log(max(3.14159265 * radiance / max(irradiance, vec3f(1e-9)), vec3f(1e-3)));
}
