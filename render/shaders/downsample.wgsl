// Smaller mips of a radiance cube, weighted by solid angle, and the nodes of its light tree. CPU twin: src/reference/downsample.rs.
// A workgroup takes 32 × 32 texels of the first mip through all levels, down to one node.

#import cube
#import light_tree

@group(0) @binding(0) var source: texture_2d_array<f32>;
@group(0) @binding(1) var<storage, read_write> nodes: array<Node>;
@group(0) @binding(2) var mip_1: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(3) var mip_2: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(4) var mip_3: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(5) var mip_4: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(6) var mip_5: texture_storage_2d_array<rgba16float, write>;

// Light added to every texel where a node's centre is looked for, so that a black node has one.
const FAINT: f32 = 1e-6;

// xyz: radiance times solid angle; w: solid angle.
var<workgroup> powers: array<vec4f, 256>;
// xyz: directions times weights; w: the weights, by which the centre is found.
var<workgroup> moments: array<vec4f, 256>;

fn store_mip(level: u32, texel: vec2u, face: u32, radiance: vec3f) {
    let value = vec4f(min(radiance, vec3f(60000.0)), 1.0);
    switch level {
        case 0u: { textureStore(mip_1, texel, face, value); }
        case 1u: { textureStore(mip_2, texel, face, value); }
        case 2u: { textureStore(mip_3, texel, face, value); }
        case 3u: { textureStore(mip_4, texel, face, value); }
        default: { textureStore(mip_5, texel, face, value); }
    }
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) lane: vec3u) {
    let face = group.z;
    let source_size = textureDimensions(source).x;
    var start = 0u;
    for (var level = 0u; level < 5u; level++) {
        let edge = 16u >> level;
        let is_busy = all(lane.xy < vec2u(edge));
        var power = vec4f(0.0);
        var moment = vec4f(0.0);
        if is_busy {
            for (var i = 0u; i < 4u; i++) {
                let part = 2u * lane.xy + vec2u(i & 1u, i >> 1u);
                if level == 0u {
                    let texel = vec3u(32u * group.xy + part, face);
                    let area_sr = texel_solid_angle(source_size, texel);
                    let radiance = textureLoad(source, texel.xy, face, 0).rgb;
                    let weight = (radiance.r + radiance.g + radiance.b + FAINT) * area_sr;
                    power += vec4f(radiance, 1.0) * area_sr;
                    moment += vec4f(texel_direction(source_size, texel, vec2f(0.5)), 1.0) * weight;
                } else {
                    let at = part.y * (2u * edge) + part.x;
                    power += powers[at];
                    moment += moments[at];
                }
            }
        }
        // Everyone has read before anyone writes, and the other way round.
        workgroupBarrier();
        if is_busy {
            powers[lane.y * edge + lane.x] = power;
            moments[lane.y * edge + lane.x] = moment;
            let size = source_size >> (level + 1u);
            let texel = edge * group.xy + lane.xy;
            let mean = moment.xyz / moment.w;
            let long = length(mean);
            // Of directions with variance v along either axis the mean is 1 - v long.
            nodes[start + (face * size + texel.y) * size + texel.x] =
                Node(vec4f(power.xyz, max(1.0 - long, 0.0)), vec4f(mean / long, power.w));
            store_mip(level, texel, face, power.xyz / power.w);
        }
        start += 6u * (source_size >> (level + 1u)) * (source_size >> (level + 1u));
        workgroupBarrier();
    }
}
