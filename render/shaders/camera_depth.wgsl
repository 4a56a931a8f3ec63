// Depth of the phantoms as the scene camera sees them, through its own lens.

#import camera
#import lights

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32) -> @invariant @builtin(position) vec4f {
    return clip_of(camera, (objects[object].world_from_object * vec4f(position, 1.0)).xyz);
}
