// Radiance cube convolved with the GGX lobe of one roughness, by filtered importance sampling
// (Krivanek and Colbert 2008: each sample reads the mip whose texel covers the sample's solid angle).
// The lobe is that of normal = view = reflection direction (Karis 2013). CPU twin: src/reference/prefilter_specular.rs.

#import brdf
#import cube

struct Lobe {
    // x: GGX alpha; y: edge of the source's cube in texels; z: number of samples.
    parameters: vec4f,
}

@group(0) @binding(0) var<uniform> lobe: Lobe;
@group(0) @binding(1) var source: texture_cube<f32>;
@group(0) @binding(2) var linear_sampler: sampler;
@group(0) @binding(3) var out: texture_storage_2d_array<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    let size = textureDimensions(out).x;
    if any(texel.xy >= vec2u(size)) {
        return;
    }
    let normal = texel_direction(size, texel, vec2f(0.5));
    let alpha = lobe.parameters.x;
    let n_samples = u32(lobe.parameters.z);
    let texel_sr = 12.566371 / (6.0 * lobe.parameters.y * lobe.parameters.y);
    var sum = vec4f(0.0);
    var weights = 0.0;
    for (var i = 0u; i < n_samples; i++) {
        let half_vector = sample_ggx(hammersley(i, n_samples), alpha, normal);
        let cos_half = dot(normal, half_vector);
        let light = 2.0 * cos_half * half_vector - normal;
        let cos_light = dot(normal, light);
        if cos_light > 0.0 {
            // pdf of the light direction: D cos_half / (4 cos_half).
            let sample_sr = 4.0 / (ggx_distribution(cos_half, alpha) * f32(n_samples));
            let level = max(0.5 * log2(sample_sr / texel_sr) + 1.0, 0.0);
            sum += cos_light * textureSampleLevel(source, linear_sampler, light, level);
            weights += cos_light;
        }
    }
    textureStore(out, texel.xy, texel.z, sum / max(weights, 1e-6));
}
