// Paths traced from the eye through the scene (Kajiya 1986), light drawn both at its source and by chance (Veach and Guibas
// 1995): the reference of all light. Caustics of mirrors and glass come from paths that meet the lamp or the environment by
// chance; a point, spot or directional light is never met, so it makes none.

#import bvh
#import sampling
#import cube
#import environment_map
#import microfacets
#import path_material
#import key_light
#import view

// The corners' normals of a triangle; a.w: its material's index.
struct Corners {
    a: vec4f,
    b: vec4f,
    c: vec4f,
}

struct Settings {
    // First sample and number of samples of this pass, surfaces along a path at most, seed.
    counts: vec4u,
    // Root of the hierarchy; texels along the environment's edge; whether the environment and the light are drawn.
    scene: vec4u,
    // x: 0 both strategies, 1 lights only, 2 surfaces only; y: 1 for rays all over the pixel, 0 through its centre.
    choices: vec4u,
}

struct Sum {
    // xyz: radiance; w: how many first rays met a surface.
    radiance: vec4f,
    squares: vec4f,
}

@group(0) @binding(4) var<storage, read> corners: array<Corners>;
@group(0) @binding(5) var<storage, read> materials: array<PathMaterial>;
@group(0) @binding(6) var<uniform> view: View;
@group(0) @binding(7) var<uniform> light: KeyLight;
@group(0) @binding(8) var<uniform> settings: Settings;
@group(0) @binding(9) var<storage, read_write> sums: array<Sum>;
@group(0) @binding(10) var radiance: texture_storage_2d<rgba16float, write>;

// Decisions of one sample: the pixel's and four for every surface.
const PER_SURFACE = 4u;
// Surfaces after which a dim path may end early.
const SURE_SURFACES = 3u;

struct Surface {
    place: vec3f,
    // The triangle's own normal and the interpolated one, both on the side that the ray comes from.
    face: vec3f,
    normal: vec3f,
    // Whether the ray comes from outside.
    is_outside: bool,
    material: u32,
}

fn surface_at(hit: Hit, to_eye: vec3f) -> Surface {
    let triangle = triangles[hit.triangle];
    let normals = corners[hit.triangle];
    let place = hit.weights.x * triangle.a.xyz + hit.weights.y * triangle.b.xyz + hit.weights.z * triangle.c.xyz;
    var normal = hit.weights.x * normals.a.xyz + hit.weights.y * normals.b.xyz + hit.weights.z * normals.c.xyz;
    var face = normalize(cross(triangle.b.xyz - triangle.a.xyz, triangle.c.xyz - triangle.a.xyz));
    // A mirrored placement turns the corners' order round, never the normals.
    face = select(face, -face, dot(face, normal) < 0.0);
    let is_outside = dot(face, to_eye) > 0.0;
    face = select(-face, face, is_outside);
    normal = normalize(select(-normal, normal, is_outside));
    if dot(normal, to_eye) < 0.0 {
        // An interpolated normal turned away at the outline, as in surface.wgsl.
        normal = normalize(normal - 1.01 * dot(normal, to_eye) * to_eye);
    }
    return Surface(place, face, normal, is_outside, u32(normals.a.w));
}

// Weight of light found one way where `other` is the density of the other way.
fn found_by_light(own: f32, other: f32) -> f32 {
    return select(select(0.0, 1.0, settings.choices.x == 1u), power_weight(own, other), settings.choices.x == 0u);
}

fn found_by_surface(own: f32, other: f32) -> f32 {
    if own == 0.0 {
        // Mirrored or refracted: there is no other way.
        return 1.0;
    }
    return select(select(0.0, 1.0, settings.choices.x == 2u), power_weight(own, other), settings.choices.x == 0u);
}

// Distance along a ray to the rectangle's shining side, and the density per steradian of drawing that place on it.
fn rectangle_ahead(origin: vec3f, direction: vec3f) -> vec2f {
    let across = cross(light.u.xyz, light.v.xyz);
    let cosine = -dot(direction, across);
    if settings.scene.w == 0u || light.position_m.w < 2.5 || cosine <= 0.0 {
        return vec2f(FAR_M, 0.0);
    }
    let distance_m = dot(origin - light.position_m.xyz, across) / cosine;
    let offset = origin + distance_m * direction - light.position_m.xyz;
    let at = vec2f(dot(offset, light.u.xyz) / dot(light.u.xyz, light.u.xyz), dot(offset, light.v.xyz) / dot(light.v.xyz, light.v.xyz));
    if distance_m <= 0.0 || any(abs(at) > vec2f(1.0)) {
        return vec2f(FAR_M, 0.0);
    }
    // Area times cosine is four times `cosine`: `across` is as long as a quarter of the area.
    return vec2f(distance_m, distance_m * distance_m / (4.0 * cosine));
}

// Light of the lamp, drawn at its source.
fn from_light(surface: Surface, origin: vec3f, frame: mat3x3f, outgoing: vec3f, u: vec2f) -> vec3f {
    var towards: vec3f;
    var distance_m = FAR_M;
    var arriving: vec3f;
    var density = 0.0;
    if light.position_m.w > 2.5 {
        let at = 2.0 * u - 1.0;
        let to_light = light.position_m.xyz + at.x * light.u.xyz + at.y * light.v.xyz - origin;
        distance_m = length(to_light);
        towards = to_light / max(distance_m, 1e-12);
        let cosine = -dot(cross(light.u.xyz, light.v.xyz), towards);
        if cosine <= 0.0 {
            return vec3f(0.0);
        }
        density = distance_m * distance_m / (4.0 * cosine);
        arriving = light.power.rgb / density;
    } else {
        towards = light.u.xyz;
        if light.position_m.w < 1.5 {
            let to_light = light.position_m.xyz - origin;
            distance_m = length(to_light);
            towards = to_light / max(distance_m, 1e-12);
        }
        arriving = unshadowed_key(light, origin, towards);
    }
    if dot(surface.face, towards) <= 0.0 {
        return vec3f(0.0);
    }
    let found = scattered(materials[surface.material], outgoing, towards * frame);
    var share = found.value * arriving;
    if density > 0.0 {
        share *= found_by_light(density, found.density);
    }
    if all(share <= vec3f(0.0)) || any_hit(settings.scene.x, origin, towards, 0.9999 * distance_m) {
        return vec3f(0.0);
    }
    return share;
}

// Light of the environment, drawn at its source.
fn from_environment(surface: Surface, origin: vec3f, frame: mat3x3f, outgoing: vec3f, u: vec2f) -> vec3f {
    let drawn = sample_environment(settings.scene.y, u);
    if dot(surface.face, drawn.direction) <= 0.0 || drawn.density <= 0.0 {
        return vec3f(0.0);
    }
    let found = scattered(materials[surface.material], outgoing, drawn.direction * frame);
    let share = found.value * drawn.radiance * (found_by_light(drawn.density, found.density) / drawn.density);
    if all(share <= vec3f(0.0)) || any_hit(settings.scene.x, origin, drawn.direction, FAR_M) {
        return vec3f(0.0);
    }
    return share;
}

// Light that a ray meets by chance: the rectangle before `limit`, the environment where nothing is hit. `density`: how the
// ray was drawn, 0 for the only one possible.
fn met_by_chance(origin: vec3f, direction: vec3f, density: f32, hit: Hit, is_first: bool) -> vec3f {
    var sum = vec3f(0.0);
    let rectangle = rectangle_ahead(origin, direction);
    // The eye itself does not see the lamp, as in the pictures of all other methods.
    if !is_first && rectangle.x < hit.distance_m {
        sum += light.power.rgb * found_by_surface(density, rectangle.y);
    }
    if hit.triangle == NOTHING {
        let sky = environment_towards(settings.scene.y, direction);
        if settings.scene.z == 0u {
            sum += sky.rgb;
        } else {
            sum += sky.rgb * found_by_surface(density, sky.w);
        }
    }
    return sum;
}

// A refracted or mirrored direction on the wrong side of the triangle (interpolated normals at outlines).
fn is_on_wrong_side(surface: Surface, frame: mat3x3f, bounce: Bounce) -> bool {
    return (dot(frame * bounce.direction, surface.face) > 0.0) != (bounce.direction.z > 0.0);
}

// Radiance along a ray from the eye; w: 1 where it meets a surface.
fn traced(eye: vec3f, first_direction: vec3f, index: u32, seed: u32) -> vec4f {
    var sum = vec3f(0.0);
    var weight = vec3f(1.0);
    var origin = eye;
    var direction = first_direction;
    var density = 0.0;
    var is_surface = 0.0;
    // How much denser radiance is where the path runs than at the eye: inside glass by the square of its index.
    var squeeze = 1.0;
    for (var n_surfaces = 0u; ; n_surfaces++) {
        let hit = closest_hit(settings.scene.x, origin, direction, FAR_M);
        sum += weight * met_by_chance(origin, direction, density, hit, n_surfaces == 0u);
        if hit.triangle == NOTHING {
            break;
        }
        is_surface = 1.0;
        if n_surfaces >= settings.counts.z {
            break;
        }
        let surface = surface_at(hit, -direction);
        let material = materials[surface.material];
        let outside = off_surface(surface.place, surface.face);
        var frame = basis_around(surface.normal);
        var outgoing = -direction * frame;
        let dimension = 1u + PER_SURFACE * n_surfaces;
        if settings.scene.w != 0u && (settings.choices.x != 2u || light.position_m.w < 2.5) {
            sum += weight * from_light(surface, outside, frame, outgoing, sample_2d(index, seed, dimension));
        }
        if settings.scene.z != 0u && settings.choices.x != 2u {
            sum += weight * from_environment(surface, outside, frame, outgoing, sample_2d(index, seed, dimension + 1u));
        }
        let u = sample_2d(index, seed, dimension + 2u);
        let choices = sample_2d(index, seed, dimension + 3u);
        let eta = select(material.parameters.z, 1.0 / material.parameters.z, surface.is_outside);
        var bounce = scatter(material, outgoing, eta, u, choices.x);
        if is_on_wrong_side(surface, frame, bounce) {
            if choices.x >= glass_share(material) {
                break;
            }
            frame = basis_around(surface.face);
            outgoing = -direction * frame;
            bounce = scatter(material, outgoing, eta, u, choices.x);
        }
        weight *= bounce.weight;
        if all(weight <= vec3f(0.0)) {
            break;
        }
        if bounce.direction.z < 0.0 {
            squeeze *= eta * eta;
        }
        if n_surfaces >= SURE_SURFACES {
            let survival = clamp(max(weight.x, max(weight.y, weight.z)) / squeeze, 0.05, 1.0);
            if choices.y >= survival {
                break;
            }
            weight /= survival;
        }
        direction = normalize(frame * bounce.direction);
        density = bounce.density;
        origin = off_surface(surface.place, select(-surface.face, surface.face, bounce.direction.z > 0.0));
    }
    return vec4f(sum, is_surface);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    let size = vec2u(view.size_px.xy);
    if any(at.xy >= size) {
        return;
    }
    let pixel = at.y * size.x + at.x;
    let seed = pcg(pixel ^ pcg(settings.counts.w));
    var sum = sums[pixel];
    for (var i = settings.counts.x; i < settings.counts.x + settings.counts.y; i++) {
        let inside = select(vec2f(0.5), sample_2d(i, seed, 0u), settings.choices.y == 1u);
        let clip = (vec2f(at.xy) + inside) * view.size_px.zw * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
        // The far plane is infinitely far away: what lies on it is a direction.
        let direction = normalize((view.world_from_clip * vec4f(clip, 1.0, 1.0)).xyz);
        let found = traced(view.eye_m.xyz, direction, i, seed);
        sum.radiance += found;
        sum.squares += vec4f(found.rgb * found.rgb, 1.0);
    }
    sums[pixel] = sum;
    let mean = sum.radiance / max(sum.squares.w, 1.0);
    textureStore(radiance, at.xy, vec4f(min(mean.rgb, vec3f(60000.0)), mean.w));
}
