// The pixels between those of `dome_visibility`: a bit on which all neighbours on the same surface agree is taken over, and a
// ray is sent only for lights on which some pixel's neighbours in the tile of 8 × 16 disagree.

#import dome

#import dome_ray

// Lights of the current word that some pixel of the tile is undecided about.
var<workgroup> undecided: atomic<u32>;
var<workgroup> undecided_of_all: u32;

// Whether a pixel lies on the same smooth surface.
fn is_alike(place: vec3f, normal: vec3f, there: vec4f, normal_there: vec3f) -> bool {
    let offset = there.xyz - place;
    return there.w > 0.0 && dot(normal, normal_there) > 0.9 && abs(dot(offset, normal)) < 0.3 * length(offset) + 1e-6;
}

@compute @workgroup_size(8, 4, 1)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    var place: array<vec4f, 4>;
    var normal: array<vec3f, 4>;
    // Four bits per row: which of the four neighbours are alike.
    var alike: array<u32, 4>;
    let size = frame.sizes.yz;
    // The last column and row that `dome_visibility` did.
    let last = (size - 1u) & vec2u(~1u);
    for (var row = 0u; row < ROWS; row++) {
        let at = vec2u(id.x, id.y * ROWS + row);
        place[row] = vec4f(0.0);
        alike[row] = 0u;
        if any(at >= size) || ((at.x | at.y) & 1u) == 0u {
            continue;
        }
        place[row] = textureLoad(places, at, 0);
        normal[row] = textureLoad(normals, at, 0).xyz;
        for (var corner = 0u; corner < 4u; corner++) {
            let from_pixel = min((at & vec2u(~1u)) + 2u * (vec2u(corner, corner >> 1u) & vec2u(1u)) * (at & vec2u(1u)), last);
            let there = textureLoad(places, from_pixel, 0);
            if is_alike(place[row].xyz, normal[row], there, textureLoad(normals, from_pixel, 0).xyz) {
                alike[row] |= 1u << corner;
            }
        }
    }
    let n_pixels = size.x * size.y;
    var first = frame.counts.z;
    while first < frame.counts.w {
        let word = first / 32u;
        let end = min(frame.counts.w, 32u * word + 32u);
        // Bits of the refreshed lights in this word.
        let refreshed = (0xffffffffu << (first & 31u)) & (0xffffffffu >> (31u - ((end - 1u) & 31u)));
        var mask: array<u32, 4>;
        if local == 0u {
            atomicStore(&undecided, 0u);
        }
        workgroupBarrier();
        for (var row = 0u; row < ROWS; row++) {
            let at = vec2u(id.x, id.y * ROWS + row);
            mask[row] = 0u;
            if place[row].w == 0.0 {
                continue;
            }
            var some = 0u;
            var every = refreshed;
            for (var corner = 0u; corner < 4u; corner++) {
                if (alike[row] & (1u << corner)) != 0u {
                    let from_pixel = min((at & vec2u(~1u)) + 2u * (vec2u(corner, corner >> 1u) & vec2u(1u)) * (at & vec2u(1u)), last);
                    let there = bits[word * n_pixels + from_pixel.y * size.x + from_pixel.x];
                    some |= there & refreshed;
                    every &= there;
                }
            }
            mask[row] = every;
            // One neighbour alone could be across a shadow's edge.
            let n_alike = countOneBits(alike[row]);
            atomicOr(&undecided, select(refreshed, some & ~every, n_alike > 1u));
        }
        workgroupBarrier();
        if local == 0u {
            undecided_of_all = atomicLoad(&undecided);
        }
        var open = workgroupUniformLoad(&undecided_of_all);
        while open != 0u {
            let bit = open & (~open + 1u);
            open &= ~bit;
            let i = 32u * word + countTrailingZeros(bit);
            let light = lights[i];
            for (var row = 0u; row < ROWS; row++) {
                if place[row].w > 0.0 {
                    mask[row] &= ~bit;
                    if light.intensity.w > 0.0 && arrives(i, light, place[row].xyz, normal[row], vec2u(id.x, id.y * ROWS + row)) {
                        mask[row] |= bit;
                    }
                }
            }
        }
        for (var row = 0u; row < ROWS; row++) {
            if place[row].w > 0.0 {
                let at = word * n_pixels + (id.y * ROWS + row) * size.x + id.x;
                if refreshed == 0xffffffffu {
                    bits[at] = mask[row];
                } else {
                    bits[at] = (bits[at] & ~refreshed) | mask[row];
                }
            }
        }
        first = end;
    }
}
