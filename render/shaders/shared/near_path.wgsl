// Light that reaches a place from near things: paths over virtual surfaces that end at the first real one, whose radiance the
// camera's picture tells. Light from afar enters where a path meets a virtual surface. The importing shader declares
// `specular`, `linear_sampler` and what `far_lights`, `material` and `real_surface` need, and imports them, `bvh`, `scene_ray`,
// `sampling`, `brdf` and `lights`.

// Virtual surfaces on a path at most.
const PATH_SURFACES = 3u;
// Rays start so far off a surface, metres: more than a rasterised place is wrong, less than contact shows.
const START_M = 2e-4;
// What a ray stands for, radians: a cosine lobe shared by the rays of a tile of 4 × 4 pixels, and a diffuse bounce.
const RAY_RAD = 0.11;
const BOUNCE_RAD = 0.5;
// Light from afar in mirrors is taken from lobes at least so rough: a lamp in a mirror is met too seldom otherwise.
const LEAST_ROUGHNESS = 0.4;
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

// Radiance that arrives along a ray (unit direction) from near things. `first` is the object that it has to meet first, or
// NOTHING for any; a: 1 where it does, and all is 0 where it meets another. `index` numbers the ray among those of its tile.
fn near_radiance(origin: vec3f, direction: vec3f, first: u32, index: u32) -> vec4f {
    var sum = vec3f(0.0);
    var share = vec3f(1.0);
    var place = origin;
    var along = direction;
    var width_rad = RAY_RAD;
    // Slot and roughness of the mirror that the ray comes from; NOTHING after a matt surface, which has met the lights.
    var mirror = NOTHING;
    var roughness = 0.0;
    for (var surfaces = 0u; surfaces <= PATH_SURFACES; surfaces++) {
        let hit = scene_hit(ALL_OBJECTS, place, along, FAR_M);
        if surfaces == 0u && first != NOTHING && hit.object != first {
            return vec4f(0.0);
        }
        if hit.object == NOTHING {
            if mirror != NOTHING {
                sum += share * textureSampleLevel(specular, linear_sampler, along, mirror, 5.0 * roughness).rgb;
            }
            return vec4f(sum, 1.0);
        }
        if instances[hit.object].facts.y == PHANTOMS {
            let real_thing = real_radiance(place + along * hit.distance_m, width_rad * hit.distance_m);
            return vec4f(sum + share * real_thing, 1.0);
        }
        if surfaces == PATH_SURFACES {
            return vec4f(sum, 1.0);
        }
        let surface = hit_surface(hit, place, along);
        let made = substance_at(MeshPoint(
            surface.normal, vec4f(1.0, 0.0, 0.0, 1.0), surface.uv, surface.uv, vec4f(1.0), surface.material,
        ));
        let split = environment_brdf(made.roughness, max(-dot(surface.normal, along), 0.0));
        let mirrored = select(vec3f(0.0), made.f0 * split.x + split.y * made.f90, made.f0 > vec3f(0.0));
        let albedo = (1.0 - made.metallic) * made.base_color.rgb;
        let random = sample_2d(index, 0u, 3u * surfaces + 1u);
        place = surface.place + START_M * surface.normal;
        sum += share * albedo * 0.31830987
            * far_irradiance(place, surface.normal, random.x, sample_2d(index, 0u, 3u * surfaces + 2u));
        let mirrors = luminance_of(mirrored) / max(luminance_of(mirrored) + luminance_of(albedo), 1e-6);
        if random.y < mirrors {
            share *= mirrored / mirrors;
            along = reflect(along, surface.normal);
            mirror = instances[hit.object].facts.z;
            roughness = max(made.roughness, LEAST_ROUGHNESS);
            width_rad = max(width_rad, roughness * roughness);
        } else {
            share *= albedo / (1.0 - mirrors);
            along = basis_around(surface.normal) * cosine_direction(sample_2d(index, 0u, 3u * surfaces + 3u));
            mirror = NOTHING;
            width_rad = BOUNCE_RAD;
        }
        if max(share.r, max(share.g, share.b)) < LEAST_SHARE {
            return vec4f(sum, 1.0);
        }
    }
    return vec4f(sum, 1.0);
}
