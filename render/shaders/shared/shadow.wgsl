// Percentage-closer filtered shadow maps (Reeves, Salesin, Cook 1987).

// Share of a light that reaches a point: `taps` × `taps` comparisons over ± `radius` texels, each bilinear.
// 1 outside the map: nothing was drawn there.
fn visibility(maps: texture_depth_2d_array, depth_sampler: sampler_comparison, layer: u32, clip: vec4f, filter_size: vec2f) -> f32 {
    if clip.w <= 0.0 {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    if any(abs(ndc.xy) >= vec2f(1.0)) || ndc.z <= 0.0 || ndc.z >= 1.0 {
        return 1.0;
    }
    let uv = ndc.xy * vec2f(0.5, -0.5) + 0.5;
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
