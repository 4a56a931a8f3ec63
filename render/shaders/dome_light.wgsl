// Irradiance of all lights of a dome past the shadows that the bits tell.

#import dome

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> bits: array<u32>;
@group(0) @binding(5) var irradiance: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= frame.sizes.yz) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(irradiance, at.xy, vec4f(0.0));
        return;
    }
    let normal = textureLoad(normals, at.xy, 0).xyz;
    let n_pixels = frame.sizes.y * frame.sizes.z;
    let pixel = at.y * frame.sizes.y + at.x;
    // Light from above alone, where `w` says so, is seen by as much of a tilted surface.
    var sum = mix(1.0, 0.5 + 0.5 * normal.z, frame.unshaded.w) * frame.unshaded.rgb;
    var mask = 0u;
    for (var i = 0u; i < frame.counts.x; i++) {
        if (i & 31u) == 0u {
            mask = bits[(i / 32u) * n_pixels + pixel];
        }
        let share = unshadowed(lights[i].position_m.xyz, place.xyz, normal);
        sum += lights[i].intensity.rgb * (share * f32(mask & 1u));
        mask >>= 1u;
    }
    let counts = bits[counts_word() * n_pixels + pixel];
    for (var slot = 0u; slot < BRIGHT_MAX; slot++) {
        let bright = bright_light(slot);
        if bright == NO_LIGHT {
            break;
        }
        let share = f32(extractBits(counts, 4u * slot, 4u)) / f32(RAYS);
        sum += lights[bright].intensity.rgb * (share * unshadowed(lights[bright].position_m.xyz, place.xyz, normal));
    }
    textureStore(irradiance, at.xy, vec4f(sum, 1.0));
}
