// What the scene camera sees through its own lens: place and normal of the first surface of every pixel.

#import camera
#import lights

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

struct Corner {
    @invariant @builtin(position) clip: vec4f,
    @location(0) place: vec3f,
    @location(1) normal: vec3f,
    @location(2) @interpolate(flat) object: u32,
}

struct Targets {
    @location(0) place: vec4f,
    @location(1) normal: vec4f,
}

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32, @location(2) normal: vec3f) -> Corner {
    let world_from_object = objects[object].world_from_object;
    let place = (world_from_object * vec4f(position, 1.0)).xyz;
    return Corner(clip_of(camera, place), place, (world_from_object * vec4f(normal, 0.0)).xyz, object);
}

@fragment
fn fragment(corner: Corner) -> Targets {
    let to_eye = camera.position_m.xyz - corner.place;
    var normal = normalize(corner.normal);
    if dot(normal, to_eye) < 0.0 {
        // Seen from behind (an open mesh) or an interpolated normal turned away at the outline.
        normal = normalize(normal - 1.01 * dot(normal, to_eye) / dot(to_eye, to_eye) * to_eye);
    }
    return Targets(vec4f(corner.place, 1.0), vec4f(normal, f32(corner.object)));
}
