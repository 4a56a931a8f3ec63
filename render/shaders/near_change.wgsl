// What virtual objects change of the light from near things on real surfaces: the light that they send there, less that of
// the real things that they hide. Every second pixel of every second row sends rays into the cone of each object's sphere,
// other ones in each of a tile of 4 × 4 such pixels, which `near_filter` puts together. Light from afar that virtual objects
// hide is a matter of shadows.

#import camera
#import lights
#import sampling
#import brdf
#import bvh
#import scene_ray
#import far_lights
#import near_scene
#import material
#import hit_substance
#import seen
#import real_memory
#import near_path

// The camera's picture as radiance, without virtual shadows, with mips.
@group(0) @binding(14) var unshadowed: texture_2d<f32>;

// Rays of a pixel towards one object, and form factor from which on there are most.
const LEAST_RAYS = 2u;
const MOST_RAYS = 8u;
const CLOSE_SHARE = 0.15;
// Form factor of an object's sphere below which it changes nothing, and above which its whole change counts.
const NO_SHARE = 0.01;
const WHOLE_SHARE = 0.02;
// Sine of the half angle above which rays go to the whole hemisphere.
const WIDE = 0.95;

// Radiance of a real surface as the camera has it, without virtual shadows.
fn unshadowed_radiance(hit: SceneHit, point: vec3f, footprint_m: f32) -> vec3f {
    let pixel = seen_at(point);
    if pixel.x < 0.0 {
        return remembered_radiance(hit);
    }
    let pixels = footprint_m * camera.focal_and_principal_px.x / distance(point, camera.position_m.xyz);
    return textureSampleLevel(unshadowed, linear_sampler, (pixel + 0.5) / camera.limits.zw, log2(max(pixels, 1.0))).rgb;
}

// Radiance along a ray that object `i` changes: its own less that of the real thing behind it.
fn changed_radiance(i: u32, origin: vec3f, direction: vec3f, index: u32) -> vec3f {
    let hit = scene_hit(VIRTUALS, origin, direction, FAR_M);
    if hit.object != i {
        return vec3f(0.0);
    }
    let behind = scene_hit(PHANTOMS, origin, direction, FAR_M);
    var lost = vec3f(0.0);
    if behind.object != NOTHING {
        if behind.distance_m < hit.distance_m {
            return vec3f(0.0);
        }
        lost = unshadowed_radiance(behind, origin + direction * behind.distance_m, RAY_RAD * behind.distance_m);
    }
    return near_radiance(hit, origin, direction, index) - lost;
}

// Change of the irradiance at a place by object `i`.
fn change_by(i: u32, place: vec3f, normal: vec3f, rank: u32) -> vec3f {
    let sphere = instances[i].sphere_m;
    let center = (instances[i].world_from_object * vec4f(sphere.xyz, 1.0)).xyz;
    let radius = sphere.w * length(instances[i].world_from_object[0].xyz);
    let to_center = center - place;
    let sine = radius / max(length(to_center), 1e-6);
    // At most the form factor of the sphere, whose upper part alone may be over the horizon.
    let share = sine * sine * clamp(dot(normal, normalize(to_center)) + sine, 0.0, 1.0);
    if share <= NO_SHARE {
        return vec3f(0.0);
    }
    let is_wide = sine > WIDE;
    let axes = basis_around(select(normalize(to_center), normal, is_wide));
    let cosine = sqrt(max(1.0 - sine * sine, 0.0));
    let rays = clamp(u32(f32(MOST_RAYS) * share / CLOSE_SHARE), LEAST_RAYS, MOST_RAYS);
    var sum = vec3f(0.0);
    for (var i_ray = 0u; i_ray < rays; i_ray++) {
        let ray = rank + 16u * i_ray;
        let random = sample_2d(ray, 0u, 0u);
        // Even in solid angle within the cone, or by the cosine over the hemisphere.
        let height = 1.0 - random.x * (1.0 - cosine);
        let across = sqrt(max(1.0 - height * height, 0.0));
        let angle = 6.2831853 * random.y;
        let in_cone = vec3f(across * cos(angle), across * sin(angle), height);
        let direction = axes * select(in_cone, cosine_direction(random), is_wide);
        let facing = dot(direction, normal);
        if facing > 0.0 {
            let weight = select(facing * 6.2831853 * (1.0 - cosine), 3.1415927, is_wide);
            sum += weight * changed_radiance(i, place + START_M * normal, direction, ray);
        }
    }
    return sum * (smoothstep(NO_SHARE, WHOLE_SHARE, share) / f32(rays));
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(out)) {
        return;
    }
    let place = textureLoad(places, 2u * id.xy, 0);
    var sum = vec3f(0.0);
    if place.w > 0.0 {
        let normal = normalize(textureLoad(normals, 2u * id.xy, 0).xyz);
        for (var i = 0u; i < arrayLength(&instances); i++) {
            if instances[i].facts.y == VIRTUALS && instances[i].facts.x != NO_ROOT {
                sum += change_by(i, place.xyz, normal, rank_in_tile(id.xy));
            }
        }
    }
    textureStore(out, id.xy, vec4f(clamp(sum, vec3f(-60000.0), vec3f(60000.0)), place.w));
}
