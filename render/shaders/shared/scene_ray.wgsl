// Rays against the scene's objects, each behind its own hierarchy in its own frame: bindings 0 to 3 of group 0
// (src/scene_rays.rs). World frame, metres. Needs `bvh`.

struct Instance {
    world_from_object: mat4x4f,
    object_from_world: mat4x4f,
    // Sphere around the object in its own frame: centre, radius.
    sphere_m: vec4f,
    // Root of its hierarchy; 1 for a phantom, 2 for a virtual object; slot of its environment; unused.
    facts: vec4u,
}

@group(0) @binding(2) var<storage, read> instances: array<Instance>;
// The scene's vertices, VERTEX_WORDS words each (`Vertex` in src/scene/gltf_mesh.rs).
@group(0) @binding(3) var<storage, read> vertex_words: array<u32>;

const VERTEX_WORDS = 20u;
// Which objects a ray looks for.
const PHANTOMS = 1u;
const VIRTUALS = 2u;
const ALL_OBJECTS = 3u;

struct SceneHit {
    // FAR_M or the limit where nothing is hit.
    distance_m: f32,
    // Index of the object, NOTHING for none.
    object: u32,
    triangle: u32,
    // Weights of the triangle's corners.
    weights: vec3f,
}

// What a ray has hit, world frame.
struct HitSurface {
    place: vec3f,
    // Interpolated unit normal, on the side that the ray comes from.
    normal: vec3f,
    uv: vec2f,
    uv1: vec2f,
    color: vec4f,
    material: u32,
}

// The first place where a ray (unit direction) meets object `i`, or `nearest` where that is not farther.
fn object_hit(i: u32, origin: vec3f, direction: vec3f, nearest: SceneHit) -> SceneHit {
    let start = (instances[i].object_from_world * vec4f(origin, 1.0)).xyz;
    let way = (instances[i].object_from_world * vec4f(direction, 0.0)).xyz;
    let scale = length(way);
    let towards = way / scale;
    let sphere = instances[i].sphere_m;
    let to_center = sphere.xyz - start;
    let along = dot(to_center, towards);
    let off2 = dot(to_center, to_center) - along * along;
    if off2 > sphere.w * sphere.w || along < -sphere.w || along - sphere.w > nearest.distance_m * scale {
        return nearest;
    }
    let hit = closest_hit(instances[i].facts.x, start, towards, nearest.distance_m * scale);
    if hit.triangle == NOTHING {
        return nearest;
    }
    return SceneHit(hit.distance_m / scale, i, hit.triangle, hit.weights);
}

// The first of the `wanted` objects along a ray (unit direction), nearer than `limit`.
fn scene_hit(wanted: u32, origin: vec3f, direction: vec3f, limit: f32) -> SceneHit {
    var found = SceneHit(limit, NOTHING, NOTHING, vec3f(0.0));
    for (var i = 0u; i < arrayLength(&instances); i++) {
        let facts = instances[i].facts;
        if (facts.y & wanted) != 0u && facts.x != NO_ROOT {
            found = object_hit(i, origin, direction, found);
        }
    }
    return found;
}

fn vertex_float(vertex: u32, word: u32) -> f32 {
    return bitcast<f32>(vertex_words[vertex * VERTEX_WORDS + word]);
}

fn hit_surface(hit: SceneHit, origin: vec3f, direction: vec3f) -> HitSurface {
    let triangle = triangles[hit.triangle];
    let corners = vec3u(u32(triangle.a.w), u32(triangle.b.w), u32(triangle.c.w));
    var normal = vec3f(0.0);
    var uv = vec2f(0.0);
    var uv1 = vec2f(0.0);
    var color = vec4f(0.0);
    for (var i = 0u; i < 3u; i++) {
        let corner = corners[i];
        normal += hit.weights[i] * vec3f(vertex_float(corner, 4u), vertex_float(corner, 5u), vertex_float(corner, 6u));
        uv += hit.weights[i] * vec2f(vertex_float(corner, 8u), vertex_float(corner, 9u));
        uv1 += hit.weights[i] * vec2f(vertex_float(corner, 10u), vertex_float(corner, 11u));
        color += hit.weights[i] * vec4f(
            vertex_float(corner, 16u), vertex_float(corner, 17u), vertex_float(corner, 18u), vertex_float(corner, 19u),
        );
    }
    // Normals go by the transposed inverse.
    let turned = transpose(mat3x3f(
        instances[hit.object].object_from_world[0].xyz,
        instances[hit.object].object_from_world[1].xyz,
        instances[hit.object].object_from_world[2].xyz,
    )) * normal;
    let towards = normalize(turned);
    return HitSurface(
        origin + direction * hit.distance_m,
        select(towards, -towards, dot(towards, direction) > 0.0),
        uv,
        uv1,
        color,
        vertex_words[corners.x * VERTEX_WORDS + 7u],
    );
}
