// Puts the rays of a tile of 4 × 4 pixels together: the mean over those around a pixel that lie on the same surface.

@group(0) @binding(0) var places: texture_2d<f32>;
@group(0) @binding(1) var normals: texture_2d<f32>;
@group(0) @binding(2) var irradiance: texture_2d<f32>;
@group(0) @binding(3) var filtered: texture_storage_2d<rgba16float, write>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let size = textureDimensions(places);
    if any(id.xy >= size) {
        return;
    }
    let here = textureLoad(irradiance, id.xy, 0);
    let place = textureLoad(places, id.xy, 0);
    if place.w == 0.0 {
        textureStore(filtered, id.xy, here);
        return;
    }
    let normal = textureLoad(normals, id.xy, 0).xyz;
    // What a pixel spans on the surface, metres.
    let right = min(id.x + 1u, size.x - 1u);
    let left = max(id.x, 1u) - 1u;
    let step_m = 0.5 * min(
        distance(textureLoad(places, vec2u(right, id.y), 0).xyz, place.xyz),
        distance(textureLoad(places, vec2u(left, id.y), 0).xyz, place.xyz),
    );
    let thickness = max(2.0 * step_m, 1e-5);
    var sum = here.rgb;
    var weight = 1.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = vec2i(id.xy) + vec2i(dx, dy);
            if (dx == 0 && dy == 0) || any(at < vec2i(0)) || any(at >= vec2i(size)) {
                continue;
            }
            let there = textureLoad(places, at, 0);
            let turned = dot(textureLoad(normals, at, 0).xyz, normal);
            if there.w == 0.0 || turned < 0.9 || abs(dot(there.xyz - place.xyz, normal)) > thickness {
                continue;
            }
            // Five wide with half weight at the ends: every pixel of a 4 × 4 tile counts once.
            let share = select(1.0, 0.5, abs(dx) == 2) * select(1.0, 0.5, abs(dy) == 2);
            sum += share * textureLoad(irradiance, at, 0).rgb;
            weight += share;
        }
    }
    textureStore(filtered, id.xy, vec4f(sum / weight, 1.0));
}
