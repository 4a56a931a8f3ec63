// Depth of the casters as lights see them: instance i is drawn into map i.

#import lights
#import map_view

@group(0) @binding(0) var<storage, read> views: array<MapView>;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @builtin(instance_index) index: u32,
) -> @builtin(position) vec4f {
    return map_clip(views[index], (objects[object].world_from_object * vec4f(position, 1.0)).xyz);
}
