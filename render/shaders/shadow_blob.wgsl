// A soft dark spot under every object.

#import view

// Binding numbers and members: src/shadow/blob.rs.
struct Blob {
    // xyz: middle of the object; w: its index.
    center_m: vec4f,
    // xyz: unit direction against which the spot falls; w: half the object's extent along it, metres.
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
            lit *= 1.0 - darkness(all.blobs[i], place.xyz, normal);
        }
    }
    textureStore(visibility, at.xy, vec4f(lit, lit, lit, 1.0));
}

fn darkness(blob: Blob, place: vec3f, normal: vec4f) -> f32 {
    let offset = place - blob.center_m.xyz;
    let circle = vec2f(dot(blob.across_x.xyz, offset), dot(blob.across_y.xyz, offset));
    let radius = length(circle);
    let facing = dot(normal.xyz, blob.up.xyz);
    // Not on the object itself, nor on what turns away.
    if radius >= blob.fade.y || facing <= 0.0 || normal.w == blob.center_m.w {
        return 0.0;
    }
    // How far the surface lies below the object's lowest part; a surface that reaches into the object still gets the spot,
    // one above its middle none.
    let below = -dot(offset, blob.up.xyz);
    if below <= 0.0 {
        return 0.0;
    }
    let height = max(below - blob.up.w, 0.0);
    let near = 1.0 / (1.0 + height / blob.fade.x);
    // The spot grows wider and paler with height.
    let edge = 1.0 + (blob.fade.y - 1.0) * (1.0 - 0.5 * near);
    let soft = 1.0 - smoothstep(CORE * near, edge, radius);
    return soft * near * near * smoothstep(0.0, 0.2, facing);
}
