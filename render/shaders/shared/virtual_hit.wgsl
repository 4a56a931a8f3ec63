// Virtual objects where rays meet them. The importing shader declares `harmonics` and what `hit_substance` needs, and imports
// `bvh`, `scene_ray`, `lights`, `sh` and `hit_substance`.

// What a ray meets on a virtual object.
struct VirtualHit {
    place: vec3f,
    // Unit, on the side that the ray comes from.
    normal: vec3f,
    // Radiance that it sends by itself, and that of its matt part: all the light of its environment, which nothing shades.
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
    let made = hit_substance(surface, direction);
    let irradiance = around_irradiance(instances[hit.object].facts.z, surface.normal);
    return VirtualHit(
        surface.place,
        surface.normal,
        made.emission + made.albedo * irradiance * 0.31830987,
        made.mirrored,
        made.through,
        made.roughness,
    );
}
