// The pixels between those of `dome_visibility`: a bit on which all neighbours on the same surface agree is taken over, and a
// ray is sent only for lights on which some pixel's neighbours in the tile of 8 × 8 disagree.

#import dome

#import dome_ray

// Lights of the current word that some pixel of the tile is undecided about.
var<workgroup> undecided: atomic<u32>;
var<workgroup> undecided_of_all: u32;

// Whether a pixel lies on the same smooth surface.
fn is_alike(place: vec3f, normal: vec3f, there: vec2u) -> bool {
    let offset = textureLoad(places, there, 0) - vec4f(place, 0.0);
    return offset.w > 0.0 && dot(normal, textureLoad(normals, there, 0).xyz) > 0.9
        && abs(dot(offset.xyz, normal)) < 0.3 * length(offset.xyz) + 1e-6;
}

@compute @workgroup_size(8, 8, 1)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = id.xy;
    let size = frame.sizes.yz;
    // The last column and row that `dome_visibility` did.
    let last = (size - 1u) & vec2u(~1u);
    let low = min(at & vec2u(~1u), last);
    let high = min((at + 1u) & vec2u(~1u), last);
    var place = vec4f(0.0);
    var normal = vec3f(0.0);
    var is_alike_at = vec4<bool>(false);
    if all(at < size) && ((at.x | at.y) & 1u) == 1u {
        place = textureLoad(places, at, 0);
    }
    if place.w > 0.0 {
        normal = textureLoad(normals, at, 0).xyz;
        is_alike_at = vec4<bool>(
            is_alike(place.xyz, normal, low),
            is_alike(place.xyz, normal, high),
            is_alike(place.xyz, normal, vec2u(low.x, high.y)),
            is_alike(place.xyz, normal, vec2u(high.x, low.y)),
        );
    }
    let n_pixels = size.x * size.y;
    let corners = vec4u(low.y, high.y, high.y, low.y) * size.x + vec4u(low.x, high.x, low.x, high.x);
    let n_alike = dot(vec4u(is_alike_at), vec4u(1u));
    var first = frame.counts.z;
    while first < frame.counts.w {
        let word = first / 32u;
        let end = min(frame.counts.w, 32u * word + 32u);
        // Bits of the refreshed lights in this word.
        let refreshed = (0xffffffffu << (first & 31u)) & (0xffffffffu >> (31u - ((end - 1u) & 31u)));
        if local == 0u {
            atomicStore(&undecided, 0u);
        }
        workgroupBarrier();
        var mask = 0u;
        if place.w > 0.0 {
            let from_word = word * n_pixels;
            let there = vec4u(
                bits[from_word + corners.x],
                bits[from_word + corners.y],
                bits[from_word + corners.z],
                bits[from_word + corners.w],
            );
            let seen = select(vec4u(0u), there, is_alike_at);
            let shown = select(vec4u(0xffffffffu), there, is_alike_at);
            let some = (seen.x | seen.y | seen.z | seen.w) & refreshed;
            mask = shown.x & shown.y & shown.z & shown.w & refreshed;
            // One neighbour alone could be across a shadow's edge.
            atomicOr(&undecided, select(refreshed, some & ~mask, n_alike > 1u));
        }
        workgroupBarrier();
        if local == 0u {
            undecided_of_all = atomicLoad(&undecided);
        }
        var open = workgroupUniformLoad(&undecided_of_all);
        while open != 0u {
            let bit = open & (~open + 1u);
            open &= ~bit;
            if place.w > 0.0 {
                mask &= ~bit;
                if arrives(32u * word + countTrailingZeros(bit), place.xyz, normal, at) {
                    mask |= bit;
                }
            }
        }
        if place.w > 0.0 {
            let index = word * n_pixels + at.y * size.x + at.x;
            if refreshed == 0xffffffffu {
                bits[index] = mask;
            } else {
                bits[index] = (bits[index] & ~refreshed) | mask;
            }
        }
        first = end;
    }
    if place.w == 0.0 || bright_light(0u) == NO_LIGHT {
        return;
    }
    let from_word = counts_word() * n_pixels;
    let there = vec4u(
        bits[from_word + corners.x],
        bits[from_word + corners.y],
        bits[from_word + corners.z],
        bits[from_word + corners.w],
    );
    var counts = bits[from_word + at.y * size.x + at.x];
    for (var slot = 0u; slot < BRIGHT_MAX; slot++) {
        let bright = bright_light(slot);
        if bright == NO_LIGHT {
            break;
        }
        if bright < frame.counts.z || bright >= frame.counts.w {
            continue;
        }
        let found = (there >> vec4u(4u * slot)) & vec4u(15u);
        let all_lit = all(!is_alike_at | (found == vec4u(RAYS)));
        let all_dark = all(!is_alike_at | (found == vec4u(0u)));
        var count = select(0u, RAYS, all_lit);
        if n_alike < 2u || !(all_lit || all_dark) {
            count = count_arriving(bright, place.xyz, normal, at);
        }
        counts = insertBits(counts, count, 4u * slot, 4u);
    }
    bits[from_word + at.y * size.x + at.x] = counts;
}
