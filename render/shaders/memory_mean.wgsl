// Mean ratio of radiance to irradiance over the seen vertices of each part of the real things: one workgroup per part.

// x: first of its members; y: their number.
@group(0) @binding(0) var<storage, read> parts: array<vec2u>;
// Vertices, part after part.
@group(0) @binding(1) var<storage, read> members: array<u32>;
@group(0) @binding(2) var<storage, read> ratios: array<vec4f>;
// rgb: mean; a: 0 where nothing of the part was ever seen.
@group(0) @binding(3) var<storage, read_write> means: array<vec4f>;

const LANES = 64u;

var<workgroup> partial: array<vec4f, 64>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let part = group.x;
    let range = parts[part];
    var sum = vec4f(0.0);
    for (var i = lane; i < range.y; i += LANES) {
        let ratio = ratios[members[range.x + i]];
        sum += vec4f(ratio.rgb * ratio.a, ratio.a);
    }
    partial[lane] = sum;
    workgroupBarrier();
    if lane == 0u {
        var total = vec4f(0.0);
        for (var i = 0u; i < LANES; i++) {
            total += partial[i];
        }
        means[part] = vec4f(total.rgb / max(total.a, 1e-6), total.a);
    }
}
