// Irradiance of all lights of a dome past the real things, and past all things: two sets of bits.

#import dome

@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> past_real: array<u32>;
@group(0) @binding(5) var<storage, read> past_virtual: array<u32>;
@group(0) @binding(6) var without: texture_storage_2d<rgba16float, write>;
@group(0) @binding(7) var with_virtual: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= frame.sizes.yz) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(without, at.xy, vec4f(0.0));
        textureStore(with_virtual, at.xy, vec4f(0.0));
        return;
    }
    let normal = textureLoad(normals, at.xy, 0).xyz;
    let n_pixels = frame.sizes.y * frame.sizes.z;
    let pixel = at.y * frame.sizes.y + at.x;
    // Light from above alone, where `w` says so, is seen by as much of a tilted surface.
    var real = mix(1.0, 0.5 + 0.5 * normal.z, frame.unshaded.w) * frame.unshaded.rgb;
    // Light that virtual objects take; exactly 0 where they take none.
    var lost = vec3f(0.0);
    var real_bits = 0u;
    var virtual_bits = 0u;
    for (var i = 0u; i < frame.counts.x; i++) {
        if (i & 31u) == 0u {
            real_bits = past_real[(i / 32u) * n_pixels + pixel];
            virtual_bits = past_virtual[(i / 32u) * n_pixels + pixel];
        }
        let share = unshadowed(lights[i].position_m.xyz, place.xyz, normal);
        let arriving = lights[i].intensity.rgb * (share * f32(real_bits & 1u));
        real += arriving;
        lost += arriving * f32(~virtual_bits & 1u);
        real_bits >>= 1u;
        virtual_bits >>= 1u;
    }
    let real_counts = past_real[counts_word() * n_pixels + pixel];
    let virtual_counts = past_virtual[counts_word() * n_pixels + pixel];
    for (var slot = 0u; slot < BRIGHT_MAX; slot++) {
        let bright = bright_light(slot);
        if bright == NO_LIGHT {
            break;
        }
        let share = f32(extractBits(real_counts, 4u * slot, 4u)) / f32(RAYS);
        let direct = unshadowed(lights[bright].position_m.xyz, place.xyz, normal);
        let arriving = lights[bright].intensity.rgb * (share * direct);
        real += arriving;
        lost += arriving * (1.0 - f32(extractBits(virtual_counts, 4u * slot, 4u)) / f32(RAYS));
    }
    textureStore(without, at.xy, vec4f(real, 1.0));
    textureStore(with_virtual, at.xy, vec4f(max(real - lost, vec3f(0.0)), 1.0));
}
