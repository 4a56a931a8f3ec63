// Distances from the middle of a virtual object to the first phantom in every direction, per texel of its cube.

#import bvh
#import cube
#import lights
#import scene_ray

// Where the object is. The scene's vertices, which have this place elsewhere, are not read here.
@group(0) @binding(3) var<uniform> environment: Environment;
// Metres; NOTHING_M where there is none.
@group(0) @binding(4) var<storage, read_write> hit_m: array<f32>;

// As in src/probe/surroundings.rs.
const NOTHING_M = 1e9;
// Phantoms nearer than this are left out: the object's own footprint, metres.
const FROM_M = 1e-3;
// Edge of the cube, texels (ENVIRONMENT_SIZE in src/passes/mod.rs).
const SIZE = 128u;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) texel: vec3u) {
    if any(texel.xy >= vec2u(SIZE)) {
        return;
    }
    let direction = texel_direction(SIZE, texel, vec2f(0.5));
    let start = environment.position_m.xyz + direction * FROM_M;
    let hit = scene_hit(PHANTOMS, start, direction, NOTHING_M);
    let distance = select(hit.distance_m + FROM_M, NOTHING_M, hit.object == NOTHING);
    hit_m[(texel.z * SIZE + texel.y) * SIZE + texel.x] = distance;
}
