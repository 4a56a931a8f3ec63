// Radiance of a substance from the light that it gets (glTF 2.0, appendix B, as layers that pass on what they do not
// reflect). Needs `material`; its twin is src/reference/substance_light.rs.

// How much of what facets lose between each other is put back: 0 single scattering as in appendix B, 1 all of it.
override FACETS: f32 = 0.0;

// Light on a point.
struct SurfaceLight {
    // On the surface, what is occluded left out.
    irradiance: vec3f,
    // From around the mirrored direction, filtered for the roughness; the same for the coat.
    mirrored: vec3f,
    coat_mirrored: vec3f,
    // From behind a transparent surface, what it absorbs left out.
    through: vec3f,
}

// x, y: factors of the reflectances at normal and grazing incidence; z: albedo of a white sheen.
fn albedos_at(roughness: f32, cosine: f32) -> vec3f {
    let half_cell = 0.5 / vec2f(textureDimensions(albedos));
    let place = clamp(vec2f(cosine, roughness), half_cell, 1.0 - half_cell);
    return textureSampleLevel(albedos, map_sampler, place, 0.0).xyz;
}

// Share of light from all around that a rough surface reflects, with what its facets pass on to each other by Turquin 2019
// ("Practical multiple scattering compensation for microfacet models", eq. 16).
fn layer_albedo(f0: vec3f, f90: f32, roughness: f32, cosine: f32) -> vec3f {
    let split = albedos_at(roughness, cosine);
    let white = max(split.x + split.y, 1e-3);
    return (f0 * split.x + f90 * split.y) * (1.0 + FACETS * f0 * (1.0 - white) / white);
}

fn largest(color: vec3f) -> f32 {
    return max(color.r, max(color.g, color.b));
}

// Radiance towards `to_eye` (unit).
fn sent_radiance(made: Substance, to_eye: vec3f, light: SurfaceLight) -> vec3f {
    let white = light.irradiance * 0.31830987;
    if made.model == GLOSS_IN_ALPHA {
        return made.emission + made.base_color.rgb * mix(light.mirrored, white, made.base_color.a);
    }
    let cosine = clamp(dot(made.normal, to_eye), 0.0, 1.0);
    let dielectric = layer_albedo(made.dielectric_f0, made.dielectric_f90, made.roughness, cosine);
    let metal = layer_albedo(made.base_color.rgb, 1.0, made.roughness, cosine);
    // What the dielectric does not reflect enters it (KHR_materials_specular: of the brightest channel, so that no colour
    // gains by it) and is scattered or goes through (KHR_materials_transmission).
    let entering = (1.0 - largest(dielectric)) * made.base_color.rgb;
    let below = entering * mix(white, light.through, made.transmission);
    var radiance = mix(dielectric * light.mirrored + below, metal * light.mirrored, made.metallic);
    // KHR_materials_sheen; fibres scatter so widely that their light is that of a matt surface.
    let sheen = albedos_at(made.sheen_roughness, cosine).z;
    radiance = (1.0 - largest(made.sheen) * sheen) * radiance + made.sheen * sheen * white;
    radiance += made.emission;
    // KHR_materials_clearcoat.
    let coat_cosine = clamp(dot(made.coat_normal, to_eye), 0.0, 1.0);
    let coat = made.coat * layer_albedo(vec3f(0.04), 1.0, made.coat_roughness, coat_cosine);
    return (1.0 - coat) * radiance + coat * light.coat_mirrored;
}
