// What a point of an object is made of (glTF 2.0, 3.9). The importing shader declares `materials`, `base_colors` and
// `base_color_sampler`, and imports `lights`.

// A point of a mesh as the vertices give it, world frame.
struct MeshPoint {
    // Unit, interpolated.
    normal: vec3f,
    // xyz: unit tangent; w: the bitangent's sense.
    tangent: vec4f,
    uv: vec2f,
    uv1: vec2f,
    color: vec4f,
    material: u32,
}

struct Substance {
    // Linear; a: opacity.
    base_color: vec4f,
    // Unit, normal map included.
    normal: vec3f,
    metallic: f32,
    // Perceptual.
    roughness: f32,
    // Reflectance at normal and at grazing incidence.
    f0: vec3f,
    f90: f32,
}

fn substance_at(point: MeshPoint) -> Substance {
    let material = materials[point.material];
    var base_color = vec4f(material.base_color.rgb, 1.0) * point.color;
    let layer = i32(material.parameters.z) - 1;
    if layer >= 0 {
        base_color *= vec4f(textureSampleLevel(base_colors, base_color_sampler, point.uv, layer, 0.0).rgb, 1.0);
    }
    let metallic = material.parameters.x;
    return Substance(
        base_color,
        point.normal,
        metallic,
        material.parameters.y,
        mix(material.dielectric.rgb, base_color.rgb, metallic),
        mix(material.dielectric.w, 1.0, metallic),
    );
}
