// Bright lights past two sets of casters: bindings 2 to 5 of group 0.

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> past_real: array<u32>;
@group(0) @binding(5) var<storage, read> past_virtual: array<u32>;

struct BrightLight {
    // Irradiance past the real things.
    arriving: vec3f,
    // What virtual objects take of it; exactly 0 where they take nothing.
    lost: vec3f,
}

// Irradiance of the lights whose rays are counted, at a pixel by its number.
fn bright_irradiance(pixel: u32, place: vec3f, normal: vec3f) -> BrightLight {
    let n_pixels = frame.sizes.y * frame.sizes.z;
    let real_counts = past_real[counts_word() * n_pixels + pixel];
    let virtual_counts = past_virtual[counts_word() * n_pixels + pixel];
    var sum = BrightLight(vec3f(0.0), vec3f(0.0));
    for (var slot = 0u; slot < BRIGHT_MAX; slot++) {
        let bright = bright_light(slot);
        if bright == NO_LIGHT {
            break;
        }
        let share = f32(extractBits(real_counts, 4u * slot, 4u)) / f32(RAYS);
        let direct = unshadowed(lights[bright].position_m.xyz, place, normal);
        let arriving = lights[bright].intensity.rgb * (share * direct);
        sum.arriving += arriving;
        sum.lost += arriving * (1.0 - f32(extractBits(virtual_counts, 4u * slot, 4u)) / f32(RAYS));
    }
    return sum;
}
