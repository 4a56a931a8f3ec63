// Radiance of virtual objects where rays meet them, without shadows: all the light of the object's environment. The importing
// shader declares `harmonics`, `specular`, `linear_sampler`, `environments` and what `material` needs, and imports `bvh`,
// `scene_ray`, `lights`, `sh`, `brdf` and `material`.

// Irradiance of all the light around environment `slot`.
fn around_irradiance(slot: u32, normal: vec3f) -> vec3f {
    let basis = sh_basis(normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * harmonics[16u * slot + i].rgb;
    }
    return max(sum, vec3f(0.0));
}

// Radiance towards the start of a ray along `direction` that has met a virtual object.
fn virtual_hit_radiance(hit: SceneHit, origin: vec3f, direction: vec3f) -> vec3f {
    let surface = hit_surface(hit, origin, direction);
    let slot = instances[hit.object].facts.z;
    let point = MeshPoint(surface.normal, vec4f(1.0, 0.0, 0.0, 1.0), surface.uv, surface.uv, vec4f(1.0), surface.material);
    let substance = substance_at(point);
    var radiance = (1.0 - substance.metallic) * substance.base_color.rgb * around_irradiance(slot, surface.normal) * 0.31830987;
    if max(substance.f0.r, max(substance.f0.g, substance.f0.b)) > 0.0 {
        let split = environment_brdf(substance.roughness, max(-dot(surface.normal, direction), 0.0));
        // Mips of the specular cube: roughness 0 in the first, 1 in the last.
        let mirrored = textureSampleLevel(specular, linear_sampler, reflect(direction, surface.normal), slot, 5.0 * substance.roughness);
        radiance += mirrored.rgb * (substance.f0 * split.x + split.y * substance.f90);
    }
    return radiance;
}
