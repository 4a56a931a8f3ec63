// All the light of a radiance cube as spherical harmonics. CPU twin: src/reference/harmonics.rs.
// One workgroup sums the nodes of one level of the light tree.

#import light_tree
#import sh

// x: first node of the level; y: number of its nodes.
@group(0) @binding(0) var<uniform> level: vec4u;
@group(0) @binding(1) var<storage, read> nodes: array<Node>;
// Nine coefficients, rgb.
@group(0) @binding(2) var<storage, read_write> coefficients: array<vec4f>;

const LANES: u32 = 128u;

// xyz: the coefficient; w: solid angle.
var<workgroup> partial: array<array<vec4f, 9>, 128>;

@compute @workgroup_size(128, 1, 1)
fn main(@builtin(local_invocation_index) lane: u32) {
    var sums: array<vec4f, 9>;
    for (var i = lane; i < level.y; i += LANES) {
        let node = nodes[level.x + i];
        let basis = sh_basis(node.direction.xyz);
        // Spread light keeps (1 - v) of the first order and (1 - v)³ of the second: the mean of a Legendre polynomial
        // P_l over a small spread is the mean cosine to the power l (l + 1) / 2.
        let first = 1.0 - node.power.w;
        let second = first * first * first;
        for (var k = 0u; k < 9u; k++) {
            let kept = select(select(second, first, k < 4u), 1.0, k == 0u);
            sums[k] += vec4f(kept * basis[k] * node.power.xyz, node.direction.w);
        }
    }
    partial[lane] = sums;
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            for (var k = 0u; k < 9u; k++) {
                partial[lane][k] += partial[lane + half][k];
            }
        }
    }
    workgroupBarrier();
    if lane < 9u {
        let sum = partial[0][lane];
        // Divided by the summed solid angles, so that uniform light has no error of theirs.
        coefficients[lane] = vec4f(sum.xyz * (12.566371 / sum.w), 0.0);
    }
}
