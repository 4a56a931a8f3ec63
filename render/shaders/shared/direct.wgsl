// Light from the key lights and from near things on a surface: bindings 0 to 8 of group 0 (src/passes/direct.rs).

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> frame: Frame;
// Uniform, not storage: software drivers read storage one lane at a time.
@group(0) @binding(2) var<uniform> lights: array<Light, 144>;
@group(0) @binding(3) var<storage, read> objects: array<Object>;
@group(0) @binding(4) var<uniform> environments: array<Environment, 16>;
// Nine coefficients per environment, sixteen apart.
@group(0) @binding(5) var<uniform> near_sh: array<vec4f, 256>;
@group(0) @binding(6) var phantom_maps: texture_depth_2d_array;
@group(0) @binding(7) var virtual_maps: texture_depth_2d_array;
@group(0) @binding(8) var depth_sampler: sampler_comparison;

// Irradiance from real things near environment `slot`.
fn near_irradiance(slot: u32, normal: vec3f) -> vec3f {
    let basis = sh_basis(normal);
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        sum += sh_cosine(i) * basis[i] * near_sh[16u * slot + i].rgb;
    }
    return max(sum, vec3f(0.0));
}

// Irradiance of a light on a surface, shadows aside.
fn unshadowed(light: Light, point: vec3f, normal: vec3f) -> vec3f {
    let to_light = light.position_m.xyz - point;
    let squared = dot(to_light, to_light);
    return light.intensity.xyz * (max(dot(normal, to_light), 0.0) / (squared * sqrt(squared)));
}

// Share of a light that phantoms let through. The point moves off the surface by the filter's reach, so that a tilted
// surface does not shade itself.
fn past_phantoms(i: u32, light: Light, point: vec3f, normal: vec3f) -> f32 {
    let view = shadow_view(light.position_m.xyz, frame.receivers_m, frame.everything_m, frame.counts.w);
    let radius = light.position_m.w;
    let clip = shadow_clip(view, point + normal * ((radius + 1.5) * view.texel_m));
    return visibility(phantom_maps, depth_sampler, i, clip, vec2f(f32(frame.counts.y), radius));
}

// Share of a light that virtual objects let through; `lift` is 1 on virtual objects themselves, 0 on phantoms.
fn past_virtual(i: u32, light: Light, point: vec3f, normal: vec3f, lift: f32) -> f32 {
    let view = shadow_view(light.position_m.xyz, frame.virtuals_m, frame.everything_m, frame.counts.w);
    let radius = light.intensity.w;
    let clip = shadow_clip(view, point + normal * (lift * (radius + 1.5) * view.texel_m));
    return visibility(virtual_maps, depth_sampler, i, clip, vec2f(f32(frame.counts.y), radius));
}

// Whether the ray from a point towards a light passes a sphere.
fn passes(sphere: vec4f, point: vec3f, to_light: vec3f) -> bool {
    let to_center = sphere.xyz - point;
    let along = dot(to_center, to_light);
    return along > -sphere.w && dot(to_center, to_center) - along * along < sphere.w * abs(sphere.w);
}

// Whether a virtual object may stand between a point and a light.
fn may_be_shaded(light: Light, point: vec3f) -> bool {
    let to_light = normalize(light.position_m.xyz - point);
    return passes(frame.casters_m[0], point, to_light) || passes(frame.casters_m[1], point, to_light)
        || passes(frame.casters_m[2], point, to_light) || passes(frame.casters_m[3], point, to_light);
}

