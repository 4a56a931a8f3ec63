// Light that reaches a place from near things: paths over virtual surfaces that end at the first real one, whose radiance the
// camera's picture tells. Light from afar enters where a path meets a virtual surface. The importing shader declares
// `specular`, `linear_sampler` and what `far_lights`, `hit_substance` and `real_memory` need, and imports them, `bvh`,
// `scene_ray`, `sampling`, `brdf`, `lights` and `material`.

// Virtual surfaces on a path at most.
const PATH_SURFACES = 3u;
// Rays start so far off a surface, metres: more than a rasterised place is wrong, less than contact shows.
const START_M = 2e-4;
// What a ray stands for, radians: a cosine lobe shared by the rays of a tile of 4 × 4 pixels, and a diffuse bounce.
const RAY_RAD = 0.11;
const BOUNCE_RAD = 0.5;
// Light from afar in mirrors is taken from lobes at least so rough, and is no brighter than so many times what it is on
// average around the direction: a lamp in a mirror is met by too few rays for the bright patch that it throws.
const LEAST_ROUGHNESS = 0.2;
const MOST_MIRRORED = 3.0;
// Roughest mip of the specular cube.
const LAST_MIP = 5.0;
// Below this share of light a path ends.
const LEAST_SHARE = 0.02;

// Number of a pixel in its tile of 4 × 4: neighbours are far apart (an ordered dither matrix: Bayer 1973).
fn rank_in_tile(pixel: vec2u) -> u32 {
    let x = pixel.x & 3u;
    let mixed = x ^ (pixel.y & 3u);
    return ((mixed & 1u) << 3u) | ((pixel.y & 1u) << 2u) | (mixed & 2u) | ((pixel.y & 2u) >> 1u);
}

fn luminance_of(rgb: vec3f) -> f32 {
    return dot(rgb, vec3f(0.2126, 0.7152, 0.0722));
}

// Light from afar that a mirror of environment `slot` sends on.
fn mirrored_radiance(slot: u32, roughness: f32, direction: vec3f) -> vec3f {
    let around = textureSampleLevel(specular, linear_sampler, direction, slot, LAST_MIP).rgb;
    return min(textureSampleLevel(specular, linear_sampler, direction, slot, LAST_MIP * roughness).rgb, MOST_MIRRORED * around);
}

// Radiance that arrives along a ray (unit direction) from near things, the first of which is `first`. `index` numbers the ray
// among those of its tile.
fn near_radiance(first: SceneHit, origin: vec3f, direction: vec3f, index: u32) -> vec3f {
    var hit = first;
    var sum = vec3f(0.0);
    var share = vec3f(1.0);
    var place = origin;
    var along = direction;
    var width_rad = RAY_RAD;
    // Slot and roughness of the mirror that the ray comes from; NOTHING after a matt surface, which has met the lights.
    var mirror = NOTHING;
    var roughness = 0.0;
    for (var surfaces = 0u; surfaces <= PATH_SURFACES; surfaces++) {
        if hit.object == NOTHING {
            if mirror != NOTHING {
                sum += share * mirrored_radiance(mirror, roughness, along);
            }
            return sum;
        }
        if instances[hit.object].facts.y == PHANTOMS {
            let real_thing = real_hit_radiance(hit, place, along, width_rad * hit.distance_m);
            return sum + share * real_thing;
        }
        if surfaces == PATH_SURFACES {
            return sum;
        }
        let surface = hit_surface(hit, place, along);
        let made = hit_substance(surface, along);
        let random = sample_2d(index, 0u, 3u * surfaces + 1u);
        place = surface.place + START_M * surface.normal;
        let from_afar = far_irradiance(place, surface.normal, random.x, sample_2d(index, 0u, 3u * surfaces + 2u));
        sum += share * (made.emission + made.albedo * 0.31830987 * from_afar);
        let mirrors = luminance_of(made.mirrored) / max(luminance_of(made.mirrored) + luminance_of(made.albedo), 1e-6);
        if random.y < mirrors {
            share *= made.mirrored / mirrors;
            along = reflect(along, surface.normal);
            mirror = instances[hit.object].facts.z;
            roughness = max(made.roughness, LEAST_ROUGHNESS);
            width_rad = max(width_rad, roughness * roughness);
        } else {
            share *= made.albedo / (1.0 - mirrors);
            along = basis_around(surface.normal) * cosine_direction(sample_2d(index, 0u, 3u * surfaces + 3u));
            mirror = NOTHING;
            width_rad = BOUNCE_RAD;
        }
        if max(share.r, max(share.g, share.b)) < LEAST_SHARE {
            return sum;
        }
        hit = scene_hit(ALL_OBJECTS, place, along, FAR_M);
    }
    return sum;
}
