// Radiance of real surfaces: the camera's picture, and what is remembered at the scene's vertices where the camera does not
// see now (src/passes/memory.rs). The importing shader declares `camera`, `real` (the camera's picture as radiance, with
// mips), `real_places`, `real_memory: array<vec4f>` and `linear_sampler`, and imports `seen`, `bvh` and `scene_ray`.

// Radiance that the camera's picture shows at a pixel, averaged over `footprint_m` metres of the surface at `point`.
fn pictured_radiance(pixel: vec2f, point: vec3f, footprint_m: f32) -> vec3f {
    let pixels = footprint_m * camera.focal_and_principal_px.x / distance(point, camera.position_m.xyz);
    return textureSampleLevel(real, linear_sampler, (pixel + 0.5) / camera.limits.zw, log2(max(pixels, 1.0))).rgb;
}

// Radiance remembered where a ray has met a phantom.
fn remembered_radiance(hit: SceneHit) -> vec3f {
    let triangle = triangles[hit.triangle];
    return hit.weights.x * real_memory[u32(triangle.a.w)].rgb
        + hit.weights.y * real_memory[u32(triangle.b.w)].rgb
        + hit.weights.z * real_memory[u32(triangle.c.w)].rgb;
}

// Radiance of the phantom that a ray has met, averaged over `footprint_m` metres of it.
fn real_hit_radiance(hit: SceneHit, origin: vec3f, direction: vec3f, footprint_m: f32) -> vec3f {
    let point = origin + direction * hit.distance_m;
    let pixel = seen_at(point);
    if pixel.x >= 0.0 {
        return pictured_radiance(pixel, point, footprint_m);
    }
    return remembered_radiance(hit);
}
