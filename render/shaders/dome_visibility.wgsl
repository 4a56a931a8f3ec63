// One bit per light for every second pixel of every second row: whether the pixel's ray to the light arrives; and for bright
// lights, how many of several rays. Only the refreshed lights' bits change. `dome_refine` does the pixels between.

#import dome

#import dome_ray

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = 2u * id.xy;
    if any(at >= frame.sizes.yz) {
        return;
    }
    let place = textureLoad(places, at, 0);
    if place.w == 0.0 {
        return;
    }
    let normal = textureLoad(normals, at, 0).xyz;
    let n_pixels = frame.sizes.y * frame.sizes.z;
    let pixel = at.y * frame.sizes.y + at.x;
    var i = frame.counts.z;
    while i < frame.counts.w {
        let word = i / 32u;
        let end = min(frame.counts.w, 32u * word + 32u);
        var mask = 0u;
        if end - i < 32u {
            mask = bits[word * n_pixels + pixel];
        }
        while i < end {
            let bit = 1u << (i & 31u);
            mask &= ~bit;
            if arrives(i, place.xyz, normal, at) {
                mask |= bit;
            }
            i++;
        }
        bits[word * n_pixels + pixel] = mask;
    }
    let at_counts = counts_word() * n_pixels + pixel;
    for (var slot = 0u; slot < BRIGHT_MAX; slot++) {
        let bright = bright_light(slot);
        if bright >= frame.counts.z && bright < frame.counts.w {
            let count = count_arriving(bright, place.xyz, normal, at);
            bits[at_counts] = insertBits(bits[at_counts], count, 4u * slot, 4u);
        }
    }
}
