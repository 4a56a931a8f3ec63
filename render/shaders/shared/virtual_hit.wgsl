// Virtual objects where rays meet them. The importing shader declares `harmonics` and what `material` needs, and imports
// `bvh`, `scene_ray`, `lights`, `sh`, `brdf` and `material`.

// What a ray meets on a virtual object.
struct VirtualHit {
    place: vec3f,
    // Unit, on the side that the ray comes from.
    normal: vec3f,
    // Radiance of its matt part: all the light of its environment, which nothing shades.
    radiance: vec3f,
    // Share of what comes along the mirrored direction that goes on along the ray.
    mirrored: vec3f,
    // Share of what comes from behind it that goes on along the ray: glass.
    through: vec3f,
    // Perceptual.
    roughness: f32,
}

// Irradiance of all the light around environment `slot`.
fn around_irradiance(slot: u32, normal: vec3f) -> vec3f {
    let basis = sh_basis(normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * harmonics[16u * slot + i].rgb;
    }
    return max(sum, vec3f(0.0));
}

fn virtual_hit(hit: SceneHit, origin: vec3f, direction: vec3f) -> VirtualHit {
    let surface = hit_surface(hit, origin, direction);
    let point = MeshPoint(surface.normal, vec4f(1.0, 0.0, 0.0, 1.0), surface.uv, surface.uv, vec4f(1.0), surface.material);
    let substance = substance_at(point);
    let irradiance = around_irradiance(instances[hit.object].facts.z, surface.normal);
    let split = environment_brdf(substance.roughness, max(-dot(surface.normal, direction), 0.0));
    let mirrored = substance.f0 * split.x + split.y * substance.f90;
    let glass = substance.transmission;
    let base = (1.0 - substance.metallic) * substance.base_color.rgb;
    return VirtualHit(
        surface.place,
        surface.normal,
        (1.0 - glass) * base * irradiance * 0.31830987,
        mirrored,
        glass * base * (1.0 - mirrored),
        substance.roughness,
    );
}
