// Radiance cube convolved with the Phong lobe cosⁿ of one exponent. CPU twin: src/reference/prefilter_phong.rs.

#import cube
#import light_tree
#import lobe_sum

// Light spread by a variance v sees the lobe, which is nearly a Gaussian of variance 1 / n, as one of 1 / n + v.
fn weights(cosines: vec4f, variance: f32) -> vec4f {
    let exponent = lobe.parameters.x / (1.0 + lobe.parameters.x * variance);
    return exponent * pow(max(cosines, vec4f(0.0)), vec4f(exponent));
}
