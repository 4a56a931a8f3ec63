// Corners of shadow volumes: where the object is, or pushed away from the light to infinity.

#import key_light
#import lights
#import view

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
@group(0) @binding(2) var<uniform> light: KeyLight;

const AT_INFINITY: u32 = 0x80000000u;

@vertex
fn vertex(@location(0) position: vec3f, @location(1) object: u32) -> @builtin(position) vec4f {
    let place = objects[object & ~AT_INFINITY].world_from_object * vec4f(position, 1.0);
    if (object & AT_INFINITY) == 0u {
        return view.clip_from_world * place;
    }
    let is_directional = light.position_m.w > 1.5 && light.position_m.w < 2.5;
    let away = select(place.xyz - light.position_m.xyz, -light.u.xyz, is_directional);
    let clip = view.clip_from_world * vec4f(away, 0.0);
    // On the far plane, not beyond it by a rounding.
    return vec4f(clip.xy, clip.w, clip.w);
}
