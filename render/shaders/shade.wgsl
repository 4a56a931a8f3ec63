// Virtual objects as radiance; phantoms as the ratio by which virtual objects dim the light on them.

#import brdf
#import camera
#import lights
#import sh
#import shadow

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> frame: Frame;
@group(0) @binding(2) var<storage, read> lights: array<Light>;
@group(0) @binding(3) var<storage, read> objects: array<Object>;
@group(0) @binding(4) var<storage, read> materials: array<Material>;
@group(0) @binding(5) var<storage, read> environments: array<Environment>;
// Nine coefficients per environment, sixteen apart.
@group(0) @binding(6) var<storage, read> near_sh: array<vec4f>;
@group(0) @binding(7) var phantom_maps: texture_depth_2d_array;
@group(0) @binding(8) var virtual_maps: texture_depth_2d_array;
@group(0) @binding(9) var depth_sampler: sampler_comparison;
@group(0) @binding(10) var specular: texture_cube_array<f32>;
@group(0) @binding(11) var linear_sampler: sampler;
@group(0) @binding(12) var base_colors: texture_2d_array<f32>;
@group(0) @binding(13) var base_color_sampler: sampler;

// Mips of the specular cube: roughness 0 in the first, 1 in the last.
const LAST_SPECULAR_MIP: f32 = 5.0;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) @interpolate(flat) object: u32,
    @location(4) @interpolate(flat) material: u32,
}

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @location(2) normal: vec3f,
    @location(3) material: u32,
    @location(4) uv: vec2f,
) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let world = (world_from_object * vec4f(position, 1.0)).xyz;
    let direction = (world_from_object * vec4f(normal, 0.0)).xyz;
    return Corner(clip_of(camera, world), world, direction, uv, object, material);
}

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
fn unshadowed(i: u32, point: vec3f, normal: vec3f) -> vec3f {
    let to_light = lights[i].position_m.xyz - point;
    let squared = dot(to_light, to_light);
    return lights[i].intensity.xyz * (max(dot(normal, to_light), 0.0) / (squared * sqrt(squared)));
}

// Share of a light that phantoms let through. The point moves off the surface by the filter's reach, so that a tilted
// surface does not shade itself.
fn past_phantoms(i: u32, point: vec3f, normal: vec3f) -> f32 {
    let reach = (lights[i].position_m.w + 1.5) * lights[i].texel_m.x;
    let clip = lights[i].phantom_clip_from_world * vec4f(point + normal * reach, 1.0);
    return visibility(phantom_maps, depth_sampler, i, clip, vec2f(f32(frame.counts.y), lights[i].position_m.w));
}

// Share of a light that virtual objects let through; `lift` is 1 on virtual objects themselves, 0 on phantoms.
fn past_virtual(i: u32, point: vec3f, normal: vec3f, lift: f32) -> f32 {
    let reach = lift * (lights[i].intensity.w + 1.5) * lights[i].texel_m.y;
    let clip = lights[i].virtual_clip_from_world * vec4f(point + normal * reach, 1.0);
    return visibility(virtual_maps, depth_sampler, i, clip, vec2f(f32(frame.counts.y), lights[i].intensity.w));
}

// Virtual over real: irradiance with all objects over irradiance with the real ones only. Exactly 1 where no virtual
// object is in any light's way.
fn phantom_ratio(point: vec3f, normal: vec3f) -> vec3f {
    let from_ball = distance(point, frame.ball_m.xyz);
    if abs(from_ball - frame.ball_m.w) < 0.02 * frame.ball_m.w {
        // A mirror shows no shadow.
        return vec3f(1.0);
    }
    var lost_any = false;
    var with_virtual = vec3f(0.0);
    var without = vec3f(0.0);
    for (var i = 0u; i < frame.counts.x; i++) {
        let light = unshadowed(i, point, normal);
        if max(light.r, max(light.g, light.b)) > 0.0 {
            let kept = past_virtual(i, point, normal, 0.0);
            let real = light * past_phantoms(i, point, normal);
            lost_any = lost_any || kept < 1.0;
            without += real;
            with_virtual += real * kept;
        }
    }
    if !lost_any {
        return vec3f(1.0);
    }
    let near = near_irradiance(nearest_environment(point), normal);
    return (with_virtual + near) / max(without + near, vec3f(1e-9));
}

fn nearest_environment(point: vec3f) -> u32 {
    var nearest = 0u;
    for (var i = 1u; i < frame.counts.z; i++) {
        if distance(environments[i].position_m.xyz, point) < distance(environments[nearest].position_m.xyz, point) {
            nearest = i;
        }
    }
    return nearest;
}

// Direction in which environment `slot`, taken at its own place, shows what a ray from `point` meets. The cube's alpha
// holds distances; three rounds bring the ray and the surface together.
fn parallax_corrected(slot: u32, point: vec3f, direction: vec3f) -> vec3f {
    let from_center = point - environments[slot].position_m.xyz;
    var towards = direction;
    for (var i = 0; i < 3; i++) {
        let distance_m = textureSampleLevel(specular, linear_sampler, towards, slot, 0.0).a;
        let b = dot(from_center, direction);
        let inside = distance_m * distance_m - dot(from_center, from_center);
        if inside <= 0.0 {
            return towards;
        }
        towards = from_center + direction * (-b + sqrt(b * b + inside));
    }
    return towards;
}

fn virtual_radiance(corner: Corner) -> vec3f {
    let material = materials[corner.material];
    let slot = objects[corner.object].environment.x;
    let to_eye = normalize(camera.position_m.xyz - corner.position);
    var normal = normalize(corner.normal);
    if dot(normal, to_eye) < 0.0 {
        // Seen from behind (an open mesh) or an interpolated normal turned away at the outline.
        normal = normalize(normal - 1.01 * dot(normal, to_eye) * to_eye);
    }
    var base_color = material.base_color.rgb;
    let layer = i32(material.parameters.z) - 1;
    if layer >= 0 {
        base_color *= textureSampleLevel(base_colors, base_color_sampler, corner.uv, layer, 0.0).rgb;
    }
    let metallic = material.parameters.x;
    let roughness = material.parameters.y;
    let f0 = mix(material.dielectric.rgb, base_color, metallic);
    let f90 = mix(material.dielectric.w, 1.0, metallic);
    var radiance = vec3f(0.0);
    if metallic < 1.0 {
        var irradiance = near_irradiance(slot, normal);
        for (var i = 0u; i < frame.counts.x; i++) {
            let light = unshadowed(i, corner.position, normal);
            if max(light.r, max(light.g, light.b)) > 0.0 {
                let kept = past_phantoms(i, corner.position, normal) * past_virtual(i, corner.position, normal, 1.0);
                irradiance += light * kept;
            }
        }
        radiance += (1.0 - metallic) * base_color * irradiance * 0.31830987;
    }
    if max(f0.r, max(f0.g, f0.b)) > 0.0 {
        let reflected = reflect(-to_eye, normal);
        let towards = parallax_corrected(slot, corner.position, reflected);
        let split = environment_brdf(roughness, max(dot(normal, to_eye), 0.0));
        let prefiltered = textureSampleLevel(specular, linear_sampler, towards, slot, roughness * LAST_SPECULAR_MIP).rgb;
        radiance += prefiltered * (f0 * split.x + split.y * f90);
    }
    return radiance;
}

struct Targets {
    // Radiance of virtual objects and 1 where there is one.
    @location(0) virtual_radiance: vec4f,
    // Ratio on phantoms and 1 where there is one.
    @location(1) phantom_ratio: vec4f,
}

@fragment
fn fragment(corner: Corner) -> Targets {
    if objects[corner.object].environment.y == 1u {
        return Targets(vec4f(min(virtual_radiance(corner), vec3f(60000.0)), 1.0), vec4f(0.0));
    }
    return Targets(vec4f(0.0), vec4f(phantom_ratio(corner.position, normalize(corner.normal)), 1.0));
}
