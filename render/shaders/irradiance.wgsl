// Light that real things near a virtual object throw on it, as spherical harmonics: one workgroup per environment.
// Light from farther off comes from the lights with their shadows instead.

#import cube
#import sh

@group(0) @binding(0) var environment: texture_2d_array<f32>;
@group(0) @binding(1) var<storage, read> hit_m: array<f32>;
// Nine coefficients per environment, rgb.
@group(0) @binding(2) var<storage, read_write> coefficients: array<vec4f>;

var<workgroup> partial: array<array<vec3f, 9>, 64>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(local_invocation_index) lane: u32) {
    let size = textureDimensions(environment).x;
    var sums: array<vec3f, 9>;
    for (var i = lane; i < 6u * size * size; i += 64u) {
        if hit_m[i] < 1e6 {
            let texel = vec3u(i % size, i / size % size, i / (size * size));
            let direction = texel_direction(size, texel, vec2f(0.5));
            let radiance = textureLoad(environment, texel.xy, texel.z, 0).rgb * texel_solid_angle(size, texel);
            let basis = sh_basis(direction);
            for (var k = 0u; k < 9u; k++) {
                sums[k] += basis[k] * radiance;
            }
        }
    }
    partial[lane] = sums;
    workgroupBarrier();
    if lane < 9u {
        var total = vec3f(0.0);
        for (var i = 0u; i < 64u; i++) {
            total += partial[i][lane];
        }
        coefficients[lane] = vec4f(total, 0.0);
    }
}
