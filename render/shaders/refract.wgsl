// What is seen through virtual glass, per pixel: rays refracted into the object, followed through its own mesh, and out again
// (Snell; Fresnel's equations). Light that the first surface does not let in is left to `reflect` and `shade`.

#import bvh
#import scene_ray
#import camera
#import lights
#import sh
#import brdf
#import microfacets
#import material
#import hit_substance
#import pixel_spots
#import seen
#import ray_light
#import real_memory
#import virtual_hit

// xyz: place of the virtual surface; w: 1 where there is one.
@group(0) @binding(13) var places: texture_2d<f32>;
// xyz: normal of the substance; w: perceptual roughness.
@group(0) @binding(14) var gloss: texture_2d<f32>;
// xyz: normal of the mesh; w: index of the object, from 1.
@group(0) @binding(15) var meshes: texture_2d<f32>;
// x: share of the light that enters and goes through; y: index of refraction; z: 0 for a thin wall.
@group(0) @binding(16) var glass: texture_2d<f32>;
@group(0) @binding(17) var out: texture_storage_2d<rgba16float, write>;

// Walls that a ray meets at most inside before all of it leaves.
const INNER_WALLS = 4u;

// Radiance that comes out of object `object` along a beam inside it, towards the beam's origin. Its walls are looked for up to
// `reach_m` away.
fn light_inside(object: u32, start: Beam, ior: f32, reach_m: f32) -> vec3f {
    let slot = instances[object].facts.z;
    var beam = start;
    var share = 1.0;
    var sum = vec3f(0.0);
    for (var i = 0u; i < INNER_WALLS; i++) {
        let hit = object_hit(object, beam.origin, beam.direction, SceneHit(reach_m, NOTHING, NOTHING, vec3f(0.0)));
        // Without a wall to leave by, a thin or an open mesh, the beam is outside already.
        var outside = beam;
        var leaving = share;
        if hit.object != NOTHING {
            let wall = hit_surface(hit, beam.origin, beam.direction);
            let width_m = beam.width_m + beam.spread * hit.distance_m;
            let leaves = refract(beam.direction, wall.normal, ior);
            outside = Beam(off_surface(wall.place, -wall.normal), leaves, width_m, ior * beam.spread);
            if all(leaves == vec3f(0.0)) {
                leaving = 0.0;
            } else {
                let kept = share * fresnel(-dot(beam.direction, wall.normal), ior);
                // What is too little to be followed, or was followed long enough, leaves with the rest.
                let is_last = i + 1u == INNER_WALLS || kept < LEAST_SHARE;
                leaving = select(share - kept, share, is_last);
            }
            beam = Beam(off_surface(wall.place, wall.normal), reflect(beam.direction, wall.normal), width_m, beam.spread);
        }
        if leaving > 0.0 {
            sum += leaving * light_along(outside, slot);
        }
        share -= leaving;
        if share <= 0.0 {
            return sum;
        }
    }
    // Light that is caught between the walls.
    return sum + share * room_light(slot, beam);
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    let made = textureLoad(glass, at.xy, 0);
    var sum = vec3f(0.0);
    if place.w > 0.0 && made.x > 0.0 {
        let substance = textureLoad(gloss, at.xy, 0);
        let mesh = textureLoad(meshes, at.xy, 0);
        let object = u32(mesh.w + 0.5) - 1u;
        let here = Spot(place.xyz, substance.xyz);
        let shape = pixel_shape(vec2i(at.xy), here);
        // A thin wall bends no ray (KHR_materials_transmission: infinitely thin), and spreads light as wide as its reflection.
        let is_thin = made.z == 0.0;
        let eta = select(1.0 / made.y, 1.0, is_thin);
        let reach_m = select(FAR_M, 0.0, is_thin);
        // A rough surface turns the rays by its facets' slopes, less the part that the index of refraction takes.
        let rough = 2.0 * substance.w * substance.w * select(1.0 - eta, 2.0, is_thin);
        for (var i = 0u; i < SPOTS * SPOTS; i++) {
            let spot = spot_of(shape, here, i);
            let from_eye = spot.place - camera.position_m.xyz;
            let towards = normalize(from_eye);
            let enters = select(refract(towards, spot.normal, eta), towards, is_thin);
            let start = spot.place - mesh.xyz * (lift_m(spot.place) + shape.rise_m);
            let spread = eta * (shape.width_m / length(from_eye) + select(shape.turned, 0.0, is_thin)) + rough;
            sum += light_inside(object, Beam(start, enters, shape.width_m, spread), made.y, reach_m);
        }
    }
    textureStore(out, at.xy, vec4f(min(sum / f32(SPOTS * SPOTS), vec3f(60000.0)), place.w));
}
