// Virtual objects as radiance; phantoms as the ratio by which virtual objects dim the light on them.

#import brdf
#import camera
#import lights
#import sh
#import shadow

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> frame: Frame;
// Uniform, not storage: software drivers read storage one lane at a time.
@group(0) @binding(2) var<uniform> lights: array<Light, 144>;
@group(0) @binding(3) var<storage, read> objects: array<Object>;
@group(0) @binding(4) var<storage, read> materials: array<Material>;
@group(0) @binding(5) var<uniform> environments: array<Environment, 16>;
// Nine coefficients per environment, sixteen apart.
@group(0) @binding(6) var<uniform> near_sh: array<vec4f, 256>;
@group(0) @binding(7) var phantom_maps: texture_depth_2d_array;
@group(0) @binding(8) var virtual_maps: texture_depth_2d_array;
@group(0) @binding(9) var depth_sampler: sampler_comparison;
@group(0) @binding(10) var specular: texture_cube_array<f32>;
@group(0) @binding(11) var linear_sampler: sampler;
@group(0) @binding(12) var base_colors: texture_2d_array<f32>;
@group(0) @binding(13) var base_color_sampler: sampler;

// Mips of the specular cube: roughness 0 in the first, 1 in the last.
const LAST_SPECULAR_MIP: f32 = 5.0;

// A loss of light below this share changes no 8-bit code: half a code of 255 in sRGB is 0.4 % at white, more below.
const LEAST_LOSS: f32 = 0.002;

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

// Virtual over real: irradiance with all objects over irradiance with the real ones only. Exactly 1 where no virtual
// object is in any light's way.
fn phantom_ratio(point: vec3f, normal: vec3f) -> vec3f {
    let from_ball = distance(point, frame.ball_m.xyz);
    if abs(from_ball - frame.ball_m.w) < 0.02 * frame.ball_m.w {
        // A mirror shows no shadow.
        return vec3f(1.0);
    }
    var lost = vec3f(0.0);
    var arriving = vec3f(0.0);
    for (var i = 0u; i < frame.counts.x; i++) {
        let light = lights[i];
        let direct = unshadowed(light, point, normal);
        arriving += direct;
        if any(direct > vec3f(0.0)) && may_be_shaded(light, point) {
            lost += direct * (1.0 - past_virtual(i, light, point, normal, 0.0));
        }
    }
    if all(lost <= LEAST_LOSS * arriving) {
        return vec3f(1.0);
    }
    lost = vec3f(0.0);
    var without = vec3f(0.0);
    for (var i = 0u; i < frame.counts.x; i++) {
        let light = lights[i];
        let direct = unshadowed(light, point, normal);
        if any(direct > vec3f(0.0)) {
            let real = direct * past_phantoms(i, light, point, normal);
            without += real;
            if may_be_shaded(light, point) {
                lost += real * (1.0 - past_virtual(i, light, point, normal, 0.0));
            }
        }
    }
    let near = near_irradiance(nearest_environment(point), normal);
    let total = max(without + near, vec3f(1e-9));
    return max(total - lost, vec3f(0.0)) / total;
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
            let light = lights[i];
            let direct = unshadowed(light, corner.position, normal);
            if any(direct > vec3f(0.0)) {
                let past_real = past_phantoms(i, light, corner.position, normal);
                irradiance += direct * past_real * past_virtual(i, light, corner.position, normal, 1.0);
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
