// Percentage-closer filtered shadow maps (Reeves, Salesin, Cook 1987).

// A light's view of a sphere of receivers: a frustum that just holds it.
struct ShadowView {
    position_m: vec3f,
    right: vec3f,
    up: vec3f,
    forward: vec3f,
    // Tangent of half the opening angle; near and far plane, metres; size of a texel in the middle, metres.
    tangent: f32,
    near_m: f32,
    far_m: f32,
    texel_m: f32,
}

// The view of a light at a place, onto `receivers` (centre, radius), as deep as `casters`.
// Computed from eight numbers per light instead of loaded: software drivers load slowly and compute fast.
fn shadow_view(position_m: vec3f, receivers: vec4f, casters: vec4f, map_size: u32) -> ShadowView {
    let to_middle = receivers.xyz - position_m;
    // A light inside the sphere looks at it with a wide angle instead of none.
    let distance = max(length(to_middle), 1.05 * receivers.w);
    let forward = normalize(to_middle);
    // Duff et al. 2017, "Building an orthonormal basis, revisited".
    let sign = select(-1.0, 1.0, forward.z >= 0.0);
    let a = -1.0 / (sign + forward.z);
    let b = forward.x * forward.y * a;
    let right = vec3f(1.0 + sign * forward.x * forward.x * a, sign * b, -sign * forward.x);
    let up = vec3f(b, sign + forward.y * forward.y * a, -forward.y);
    let ratio = receivers.w / distance;
    let tangent = ratio / sqrt(1.0 - ratio * ratio);
    let middle = dot(casters.xyz - position_m, forward);
    let near_m = max(middle - casters.w, 0.02 * distance);
    let far_m = max(middle + casters.w, 2.0 * near_m);
    return ShadowView(position_m, right, up, forward, tangent, near_m, far_m, 2.0 * tangent * distance / f32(map_size));
}

// Clip coordinates in a light's view: depth 0 at the near plane, 1 at the far one.
fn shadow_clip(view: ShadowView, point: vec3f) -> vec4f {
    let offset = point - view.position_m;
    let z = dot(offset, view.forward);
    let depth = view.far_m * (z - view.near_m) / (view.far_m - view.near_m);
    return vec4f(dot(offset, view.right) / view.tangent, dot(offset, view.up) / view.tangent, depth, z);
}

// Share of a light that reaches a point: `filter_size` is the number of taps per side and their reach in texels, each tap
// a bilinear comparison; with reach 0 there is one tap. 1 outside the map: nothing was drawn there.
fn visibility(maps: texture_depth_2d_array, depth_sampler: sampler_comparison, layer: u32, clip: vec4f, filter_size: vec2f) -> f32 {
    if clip.w <= 0.0 {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    if any(abs(ndc.xy) >= vec2f(1.0)) || ndc.z <= 0.0 || ndc.z >= 1.0 {
        return 1.0;
    }
    let uv = ndc.xy * vec2f(0.5, -0.5) + 0.5;
    if filter_size.y <= 0.0 {
        return textureSampleCompareLevel(maps, depth_sampler, uv, layer, ndc.z);
    }
    let taps = i32(filter_size.x);
    let step = 2.0 * filter_size.y / (f32(taps - 1) * f32(textureDimensions(maps).x));
    let middle = 0.5 * f32(taps - 1);
    var sum = 0.0;
    for (var y = 0; y < taps; y++) {
        for (var x = 0; x < taps; x++) {
            let offset = (vec2f(f32(x), f32(y)) - middle) * step;
            sum += textureSampleCompareLevel(maps, depth_sampler, uv + offset, layer, ndc.z);
        }
    }
    return sum / f32(taps * taps);
}
