// Irradiance of a dome's bright lights past the real things, and what virtual objects take of it.

#import dome

#import dome_bright

@group(0) @binding(6) var arriving: texture_storage_2d<rgba16float, write>;
@group(0) @binding(7) var lost: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) at: vec3u) {
    if any(at.xy >= frame.sizes.yz) {
        return;
    }
    let place = textureLoad(places, at.xy, 0);
    var bright = BrightLight(vec3f(0.0), vec3f(0.0));
    if place.w > 0.0 {
        let normal = textureLoad(normals, at.xy, 0).xyz;
        bright = bright_irradiance(at.y * frame.sizes.y + at.x, place.xyz, normal);
    }
    textureStore(arriving, at.xy, vec4f(bright.arriving, 1.0));
    textureStore(lost, at.xy, vec4f(bright.lost, 1.0));
}
