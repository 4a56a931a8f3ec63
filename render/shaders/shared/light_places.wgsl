// Share of the light that arrives at a surface: every place on the light counts by what it would give the surface, if its map
// in `depths`, drawn with its view in `light_places`, says that nothing stands between. 1 where the surface turns away.
fn lit_share(point: vec3f, normal: vec3f, off_m: f32, n_places: u32) -> f32 {
    let size = f32(textureDimensions(depths).x);
    let before = vec4f(point + off_m * normal, 1.0);
    var possible = 0.0;
    var arriving = 0.0;
    for (var i = 0u; i < n_places; i++) {
        let way = light_places[i].position_m.xyz - point;
        let squared = dot(way, way);
        let weight = max(dot(way, normal), 0.0) / (squared * squared);
        if weight == 0.0 {
            continue;
        }
        let clip = light_places[i].clip_from_world * before;
        let ndc = clip.xyz / clip.w;
        var is_lit = true;
        if clip.w > 0.0 && all(abs(ndc.xy) < vec2f(1.0)) {
            let depth = textureLoad(depths, vec2u((ndc.xy * vec2f(0.5, -0.5) + 0.5) * size), i, 0);
            is_lit = depth >= min(ndc.z, 1.0);
        }
        possible += weight;
        arriving += select(0.0, weight, is_lit);
    }
    return select(1.0, arriving / possible, possible > 0.0);
}
