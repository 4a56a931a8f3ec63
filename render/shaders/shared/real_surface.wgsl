// Radiance that real things send, wherever a ray meets them. The importing shader declares `camera`, `real` (the camera's
// picture as radiance, with mips), `real_places`, `probe_radiance`, `probe` and `linear_sampler`, and imports `seen`.

// Radiance of a real surface at a point, averaged over `footprint_m` metres of it.
fn real_radiance(point: vec3f, footprint_m: f32) -> vec3f {
    let pixel = seen_at(point);
    if pixel.x >= 0.0 {
        let pixels = footprint_m * camera.focal_and_principal_px.x / distance(point, camera.position_m.xyz);
        return textureSampleLevel(real, linear_sampler, (pixel + 0.5) / camera.limits.zw, log2(max(pixels, 1.0))).rgb;
    }
    return textureSampleLevel(probe_radiance, linear_sampler, point - probe.position_m.xyz, 0.0).rgb;
}
