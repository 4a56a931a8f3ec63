// Casters flattened onto a plane as a light projects them.

#import lights
#import view

// A plane turned towards the light, and a place on the light, homogeneous.
struct Projection {
    plane: vec4f,
    light: vec4f,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
@group(0) @binding(2) var<storage, read> projections: array<Projection>;

// What one place on the light takes away.
override share: f32 = 1.0;
// Casters nearer to the plane than this are part of it.
override lowest_m: f32 = 0.001;

struct Corner {
    @builtin(position) clip: vec4f,
    // Height over the plane, and how far below the light, both times the same factor for a light at infinity.
    @location(0) heights: vec2f,
}

@vertex
fn receiver(@location(0) position: vec3f) -> @builtin(position) vec4f {
    return view.clip_from_world * vec4f(position, 1.0);
}

@vertex
fn caster(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @builtin(instance_index) instance: u32,
) -> Corner {
    let projection = projections[instance];
    let place = objects[object].world_from_object * vec4f(position, 1.0);
    let height = dot(projection.plane, place);
    let light_height = dot(projection.plane, projection.light);
    // Blinn 1988, "Me and my (fake) shadow".
    let flat_place = light_height * place - height * projection.light;
    return Corner(view.clip_from_world * flat_place, vec2f(height, flat_place.w));
}

@fragment
fn fragment(corner: Corner) -> @location(0) vec4f {
    // No anti-shadow: what is below the plane or not below the light casts none. Cut per pixel, so exactly.
    if corner.heights.x <= lowest_m || corner.heights.y <= 0.0 {
        discard;
    }
    return vec4f(share, share, share, 0.0);
}

@fragment
fn nothing() -> @location(0) vec4f {
    return vec4f(0.0);
}
