// Matt surfaces under one light past its shadow and under light that comes from everywhere alike.

#import key_light

@group(0) @binding(0) var<uniform> light: KeyLight;
// w: 1 when `visibility` holds the irradiance of all light.
@group(0) @binding(1) var<uniform> ambient: vec4f;
@group(0) @binding(2) var places: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var colors: texture_2d<f32>;
// Share of the light that arrives, or irradiance.
@group(0) @binding(5) var visibility: texture_2d<f32>;
@group(0) @binding(6) var radiance: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    if place.w == 0.0 {
        textureStore(radiance, at.xy, vec4f(ambient.rgb, 0.0));
        return;
    }
    let normal = textureLoad(normals, at.xy, 0).xyz;
    let share = textureLoad(visibility, at.xy, 0).rgb;
    var irradiance = share;
    if ambient.w == 0.0 {
        irradiance = unshadowed_key(light, place.xyz, normal) * share + 3.14159265 * ambient.rgb;
    }
    let reflected = textureLoad(colors, at.xy, 0).rgb * irradiance / 3.14159265;
    textureStore(radiance, at.xy, vec4f(reflected, 1.0));
}
