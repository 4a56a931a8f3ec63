// Depth of the casters as one place on the light sees them; the instance is the place.

#import attenuation

#import lights

@group(0) @binding(0) var<storage, read> light_places: array<LightPlace>;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) object: u32,
    @builtin(instance_index) index: u32,
) -> @builtin(position) vec4f {
    return light_places[index].clip_from_world * (objects[object].world_from_object * vec4f(position, 1.0));
}
