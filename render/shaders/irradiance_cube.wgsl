// Irradiance on a surface for every normal: the radiance cube under the cosine. CPU twin: src/reference/irradiance_cube.rs.

#import cube
#import light_tree
#import lobe_sum

fn weights(cosines: vec4f, variance: f32) -> vec4f {
    return above_horizon(cosines, variance) * (1.0 - variance);
}
