// Virtual objects before a backdrop, or before black on a display that one looks through. CPU twin:
// src/reference/display.rs.

#import camera
#import srgb

// A pinhole.
@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var virtual_radiance: texture_2d<f32>;
@group(0) @binding(2) var phantom_ratio: texture_2d<f32>;
// Real things as they are.
@group(0) @binding(3) var real: texture_2d<f32>;
// Irradiance on phantoms.
@group(0) @binding(4) var light_with: texture_2d<f32>;
@group(0) @binding(5) var light_lamps: texture_2d<f32>;
@group(0) @binding(6) var light_near: texture_2d<f32>;
@group(0) @binding(7) var probe_radiance: texture_cube<f32>;
@group(0) @binding(8) var linear_sampler: sampler;
@group(0) @binding(9) var<storage, read_write> out: array<u32>;
// What virtual lamps add to real things.
@group(0) @binding(10) var lamp_radiance: texture_2d<f32>;

// 0: the world itself, through the display; 1: a colour; 2: the measured light.
override SURROUND: u32 = 0u;
// Whether a backdrop has the phantoms before it, in grey.
override PHANTOMS: u32 = 0u;
// The backdrop's colour, linear; 1 is the display's white.
override RED: f32 = 0.0;
override GREEN: f32 = 0.0;
override BLUE: f32 = 0.0;

// Albedo of grey phantoms.
const GREY: f32 = 0.5;

// What virtual objects add to the light of real things; what they take away cannot be shown.
fn added(pixel: vec2u) -> vec3f {
    let ratio = textureLoad(phantom_ratio, pixel, 0);
    if ratio.a == 0.0 {
        return vec3f(0.0);
    }
    let lamps = textureLoad(lamp_radiance, pixel, 0).rgb;
    return lamps + textureLoad(real, pixel, 0).rgb * (max(ratio.rgb, vec3f(1.0)) - 1.0);
}

// The backdrop, as the display's linear light.
fn backdrop(pixel: vec2u, exposure: f32) -> vec3f {
    if PHANTOMS == 1u && textureLoad(phantom_ratio, pixel, 0).a > 0.0 {
        let irradiance = textureLoad(light_with, pixel, 0).rgb
            + textureLoad(light_lamps, pixel, 0).rgb
            + textureLoad(light_near, pixel, 0).rgb;
        return GREY * 0.31830987 * exposure * max(irradiance, vec3f(0.0));
    }
    if SURROUND == 1u {
        return vec3f(RED, GREEN, BLUE);
    }
    let in_eye = vec3f((vec2f(pixel) - camera.focal_and_principal_px.zw) / camera.focal_and_principal_px.xy, 1.0);
    // The transpose of a rotation is its inverse.
    let direction = (vec4f(in_eye, 0.0) * camera.camera_from_world).xyz;
    return exposure * textureSampleLevel(probe_radiance, linear_sampler, direction, 0.0).rgb;
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = textureDimensions(virtual_radiance);
    if any(at.xy >= size) {
        return;
    }
    // The display's white is what makes the scene camera's green full.
    let exposure = camera.signal_per_radiance.y;
    let over = textureLoad(virtual_radiance, at.xy, 0);
    var behind: vec3f;
    if SURROUND == 0u {
        behind = exposure * added(at.xy);
    } else {
        behind = backdrop(at.xy, exposure);
    }
    out[at.y * size.x + at.x] = packed_srgb(behind * (1.0 - over.a) + exposure * over.rgb);
}
