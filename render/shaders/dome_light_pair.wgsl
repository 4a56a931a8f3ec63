// Irradiance of all lights of a dome past the real things, and past all things: two sets of bits.

#import dome

#import dome_bright

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
    let bright = bright_irradiance(pixel, place.xyz, normal);
    real += bright.arriving;
    lost += bright.lost;
    textureStore(without, at.xy, vec4f(real, 1.0));
    textureStore(with_virtual, at.xy, vec4f(max(real - lost, vec3f(0.0)), 1.0));
}
