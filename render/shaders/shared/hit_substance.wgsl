// What virtual objects are made of where rays meet them, as shares of light. The importing shader declares `camera` and what
// `material` needs, and imports `camera`, `scene_ray`, `brdf` and `material`.

struct HitSubstance {
    // Radiance that it sends by itself.
    emission: vec3f,
    // Share of the light from all around that its matt part scatters.
    albedo: vec3f,
    // Share of what comes along the mirrored direction that goes on along the ray.
    mirrored: vec3f,
    // Share of what comes from behind it that goes on along the ray: glass.
    through: vec3f,
    // Perceptual.
    roughness: f32,
}

// Normal maps and coats are left out.
fn hit_substance(surface: HitSurface, direction: vec3f) -> HitSubstance {
    // Any tangent does: normals of maps are not used.
    let tangent = vec4f(1.0, 0.0, 0.0, 1.0);
    let point = MeshPoint(surface.normal, tangent, surface.uv, surface.uv1, surface.color, surface.material);
    let made = substance_at(point);
    let color = made.base_color.rgb;
    if made.model == UNLIT {
        return HitSubstance(color / camera.signal_per_radiance.y, vec3f(0.0), vec3f(0.0), vec3f(0.0), 1.0);
    }
    if made.model == GLOSS_IN_ALPHA {
        let alpha = made.base_color.a;
        return HitSubstance(made.emission, alpha * color, (1.0 - alpha) * color, vec3f(0.0), made.roughness);
    }
    let split = environment_brdf(made.roughness, max(-dot(surface.normal, direction), 0.0));
    let mirrored = made.f0 * split.x + split.y * made.f90;
    let base = (1.0 - made.metallic) * color;
    let glass = made.transmission;
    return HitSubstance(made.emission, (1.0 - glass) * base, mirrored, glass * base * (1.0 - mirrored), made.roughness);
}
