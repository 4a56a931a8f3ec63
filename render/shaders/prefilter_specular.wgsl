// Radiance cube convolved with the GGX lobe of one roughness: the lobe of normal = view = reflection direction
// (Karis 2013, "Real shading in Unreal Engine 4"). CPU twin: src/reference/prefilter_specular.rs.

#import cube
#import light_tree
#import lobe_sum

// D(h) cos θ; light spread by a variance v sees it as f + v ∇²f / 2, with f = 1 / (sin² + α² cos²)² of the half angle.
fn weights(cosines: vec4f, variance: f32) -> vec4f {
    let a2 = lobe.parameters.x * lobe.parameters.x;
    let sin2_half = 0.5 - 0.5 * cosines;
    let inverse = 1.0 / (sin2_half + a2 * (1.0 - sin2_half));
    let spread = 1.0 + variance * inverse * (3.0 * sin2_half * inverse - 1.0);
    return above_horizon(cosines, variance) * (a2 * inverse * inverse * spread);
}
