// One bit per light for every second pixel of every second row: whether the pixel's ray to the light arrives. Only the
// refreshed lights' bits change. `dome_refine` does the pixels between.

#import dome

#import dome_ray

@compute @workgroup_size(8, 4, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    var place: array<vec4f, 4>;
    var normal: array<vec3f, 4>;
    var pixel: array<u32, 4>;
    let x = 2u * id.x;
    if x >= frame.sizes.y {
        return;
    }
    for (var row = 0u; row < ROWS; row++) {
        let y = 2u * (id.y * ROWS + row);
        place[row] = vec4f(0.0);
        if y < frame.sizes.z {
            place[row] = textureLoad(places, vec2u(x, y), 0);
            normal[row] = textureLoad(normals, vec2u(x, y), 0).xyz;
        }
        pixel[row] = y * frame.sizes.y + x;
    }
    let n_pixels = frame.sizes.y * frame.sizes.z;
    var i = frame.counts.z;
    while i < frame.counts.w {
        let word = i / 32u;
        let end = min(frame.counts.w, 32u * word + 32u);
        var mask: array<u32, 4>;
        for (var row = 0u; row < ROWS; row++) {
            mask[row] = 0u;
            if place[row].w > 0.0 && end - i < 32u {
                mask[row] = bits[word * n_pixels + pixel[row]];
            }
        }
        while i < end {
            let light = lights[i];
            let bit = 1u << (i & 31u);
            for (var row = 0u; row < ROWS; row++) {
                mask[row] &= ~bit;
                if place[row].w > 0.0 && light.intensity.w > 0.0 {
                    let at = vec2u(x, 2u * (id.y * ROWS + row));
                    if arrives(i, light, place[row].xyz, normal[row], at) {
                        mask[row] |= bit;
                    }
                }
            }
            i++;
        }
        for (var row = 0u; row < ROWS; row++) {
            if place[row].w > 0.0 {
                bits[word * n_pixels + pixel[row]] = mask[row];
            }
        }
    }
}
