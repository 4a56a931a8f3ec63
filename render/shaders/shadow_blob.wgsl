// A soft dark spot under every object.

#import view

// Binding numbers and members: src/shadow/blob.rs.
struct Blob {
    // xyz: middle of the object; w: its index.
    center_m: vec4f,
    // xyz: unit direction against which the spot falls; w: height of the object's lowest part, metres.
    up: vec4f,
    // Place across `up`, relative to the middle, to place in the footprint's unit circle: rows x and y.
    across_x: vec4f,
    across_y: vec4f,
    // x: height over which the spot fades, metres; y: radius beyond which there is none, in footprints.
    fade: vec4f,
}

struct Blobs {
    counts: vec4u,
    blobs: array<Blob, 200>,
}

@group(0) @binding(0) var<uniform> all: Blobs;
@group(0) @binding(1) var places: texture_2d<f32>;
@group(0) @binding(2) var normals: texture_2d<f32>;
@group(0) @binding(3) var visibility: texture_storage_2d<rgba16float, write>;

// Radius at which a spot that touches is still as dark as in the middle, in footprints.
const CORE: f32 = 0.55;
// How far below an object's middle a surface has to be.
const LOWER_M: f32 = 0.0002;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    let normal = textureLoad(normals, at.xy, 0);
    var lit = 1.0;
    if place.w > 0.0 {
        for (var i = 0u; i < all.counts.x; i++) {
            lit *= 1.0 - darkness(i, place.xyz, normal);
        }
    }
    textureStore(visibility, at.xy, vec4f(lit, lit, lit, 1.0));
}

fn darkness(i: u32, place: vec3f, normal: vec4f) -> f32 {
    // What the object is sunk into gets its spot, what stands beside it none; it gets none itself.
    let center = all.blobs[i].center_m;
    let offset = place - center.xyz;
    if offset.z > -LOWER_M || normal.w == center.w {
        return 0.0;
    }
    let circle = vec2f(dot(all.blobs[i].across_x.xyz, offset), dot(all.blobs[i].across_y.xyz, offset));
    let reach = all.blobs[i].fade.y;
    if dot(circle, circle) >= reach * reach {
        return 0.0;
    }
    let up = all.blobs[i].up;
    let facing = dot(normal.xyz, up.xyz);
    let near = 1.0 / (1.0 + max(up.w - place.z, 0.0) / all.blobs[i].fade.x);
    // The spot grows wider and paler with height.
    let edge = 1.0 + (reach - 1.0) * (1.0 - 0.5 * near);
    let soft = 1.0 - smoothstep(CORE * near, edge, length(circle));
    return soft * near * near * smoothstep(0.0, 0.2, facing);
}
