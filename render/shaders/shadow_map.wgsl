// Depth of the casters as one light sees them.

#import lights

#import shadow

struct Aim {
    // xyz: the light; w: map size in texels.
    position_m: vec4f,
    receivers_m: vec4f,
    casters_m: vec4f,
}

@group(0) @binding(0) var<uniform> aim: Aim;
@group(0) @binding(1) var<storage, read> objects: array<Object>;

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32) -> @builtin(position) vec4f {
    let view = shadow_view(aim.position_m.xyz, aim.receivers_m, aim.casters_m, u32(aim.position_m.w));
    return shadow_clip(view, (objects[object].world_from_object * vec4f(position, 1.0)).xyz);
}
