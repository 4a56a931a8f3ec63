// Puts the rays of a tile of 4 × 4 pixels together where virtual objects are rough: the mean over those around a pixel that lie
// on the same surface. Mirrors stay sharp.

@group(0) @binding(0) var places: texture_2d<f32>;
@group(0) @binding(1) var gloss: texture_2d<f32>;
@group(0) @binding(2) var meshes: texture_2d<f32>;
@group(0) @binding(3) var reflected: texture_2d<f32>;
@group(0) @binding(4) var filtered: texture_storage_2d<rgba16float, write>;

// Below this a surface is a perfect mirror (src/passes/reflect.rs).
override MIRROR_ROUGHNESS: f32 = 0.05;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let size = textureDimensions(places);
    if any(id.xy >= size) {
        return;
    }
    let here = textureLoad(reflected, id.xy, 0);
    let place = textureLoad(places, id.xy, 0);
    let substance = textureLoad(gloss, id.xy, 0);
    if place.w == 0.0 || substance.w < MIRROR_ROUGHNESS {
        textureStore(filtered, id.xy, here);
        return;
    }
    let object = textureLoad(meshes, id.xy, 0).w;
    // Normals may differ by one and a half times the slope at which half the facets are steeper.
    let steepest = 1.5 * substance.w * substance.w;
    let least_cosine = inverseSqrt(1.0 + steepest * steepest);
    var sum = here.rgb;
    var weight = 1.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let at = vec2i(id.xy) + vec2i(dx, dy);
            if (dx == 0 && dy == 0) || any(at < vec2i(0)) || any(at >= vec2i(size)) {
                continue;
            }
            let there = textureLoad(gloss, at, 0);
            let is_other = textureLoad(meshes, at, 0).w != object || dot(there.xyz, substance.xyz) < least_cosine;
            if is_other || abs(there.w - substance.w) > 0.1 {
                continue;
            }
            // Five wide with half weight at the ends: every pixel of a 4 × 4 tile counts once.
            let share = select(1.0, 0.5, abs(dx) == 2) * select(1.0, 0.5, abs(dy) == 2);
            sum += share * textureLoad(reflected, at, 0).rgb;
            weight += share;
        }
    }
    textureStore(filtered, id.xy, vec4f(sum / weight, 1.0));
}
