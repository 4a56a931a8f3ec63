// Depth of the casters as one light sees them.

#import lights

@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32) -> @builtin(position) vec4f {
    return clip_from_world * (objects[object].world_from_object * vec4f(position, 1.0));
}
