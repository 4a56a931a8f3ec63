// What `near_change` found at every second pixel of every second row, for all pixels: the mean over the tile of 8 × 8 around a
// pixel, of places on the same surface.

@group(0) @binding(0) var places: texture_2d<f32>;
@group(0) @binding(1) var normals: texture_2d<f32>;
// Half as wide and high; a: 1 where there is a surface.
@group(0) @binding(2) var change: texture_2d<f32>;
@group(0) @binding(3) var filtered: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(places)) {
        return;
    }
    let place = textureLoad(places, id.xy, 0);
    let normal = textureLoad(normals, id.xy, 0).xyz;
    let size = vec2i(textureDimensions(change));
    var sum = vec3f(0.0);
    var weight = 0.0;
    for (var dy = -2; dy <= 2 && place.w > 0.0; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = vec2i(id.xy / 2u) + vec2i(dx, dy);
            if any(at < vec2i(0)) || any(at >= size) {
                continue;
            }
            let found = textureLoad(change, at, 0);
            let offset = textureLoad(places, 2 * at, 0).xyz - place.xyz;
            let turned = dot(textureLoad(normals, 2 * at, 0).xyz, normal);
            if found.a == 0.0 || turned < 0.9 || abs(dot(offset, normal)) > 0.2 * length(offset) + 1e-5 {
                continue;
            }
            // Five wide with half weight at the ends: every place of a tile counts once.
            let share = select(1.0, 0.5, abs(dx) == 2) * select(1.0, 0.5, abs(dy) == 2);
            sum += share * found.rgb;
            weight += share;
        }
    }
    textureStore(filtered, id.xy, vec4f(sum / max(weight, 1.0), 1.0));
}
