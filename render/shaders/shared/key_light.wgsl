// The one light of the one-light methods (src/shadow/light.rs). World frame, metres, linear RGB.
struct KeyLight {
    // w: 0 point, 1 spot, 2 directional, 3 rectangle.
    position_m: vec4f,
    u: vec4f,
    v: vec4f,
    power: vec4f,
}

// Irradiance of a rectangle on a surface by Lambert's sum over its edges, cut at the surface's horizon (Baum, Rushmeier,
// Winget 1989, "Improving radiosity solutions through the use of analytically determined form-factors").
fn rect_irradiance(light: KeyLight, point: vec3f, normal: vec3f) -> vec3f {
    let center = light.position_m.xyz - point;
    let u = light.u.xyz;
    let v = light.v.xyz;
    if dot(cross(u, v), center) >= 0.0 {
        // Behind the rectangle.
        return vec3f(0.0);
    }
    var corners = array<vec3f, 4>(center - u - v, center - u + v, center + u + v, center + u - v);
    var sum = 0.0;
    var first = vec3f(0.0);
    var last = vec3f(0.0);
    var n_kept = 0u;
    for (var i = 0u; i < 4u; i++) {
        let a = corners[i];
        let b = corners[(i + 1u) % 4u];
        let height_a = dot(a, normal);
        let height_b = dot(b, normal);
        if height_a <= 0.0 && height_b <= 0.0 {
            continue;
        }
        var from_corner = a;
        var to_corner = b;
        if height_a < 0.0 {
            from_corner = a + (b - a) * (height_a / (height_a - height_b));
        }
        if height_b < 0.0 {
            to_corner = a + (b - a) * (height_a / (height_a - height_b));
        }
        if n_kept == 0u {
            first = from_corner;
        } else if any(last != from_corner) {
            sum += edge_irradiance(last, from_corner, normal);
        }
        sum += edge_irradiance(from_corner, to_corner, normal);
        last = to_corner;
        n_kept += 1u;
    }
    if n_kept > 0u && any(last != first) {
        sum += edge_irradiance(last, first, normal);
    }
    return light.power.rgb * max(0.5 * sum, 0.0);
}

fn edge_irradiance(a: vec3f, b: vec3f, normal: vec3f) -> f32 {
    let across = cross(a, b);
    let size = length(across);
    if size <= 1e-12 {
        return 0.0;
    }
    return atan2(size, dot(a, b)) * dot(across / size, normal);
}

// Irradiance on a surface, shadows aside.
fn unshadowed_key(light: KeyLight, point: vec3f, normal: vec3f) -> vec3f {
    if light.position_m.w > 2.5 {
        return rect_irradiance(light, point, normal);
    }
    if light.position_m.w > 1.5 {
        return light.power.rgb * max(dot(normal, light.u.xyz), 0.0);
    }
    let to_light = light.position_m.xyz - point;
    let squared = max(dot(to_light, to_light), 1e-12);
    let towards = to_light * inverseSqrt(squared);
    var share = 1.0;
    if light.position_m.w > 0.5 {
        share = smoothstep(light.v.w, max(light.u.w, light.v.w + 1e-6), dot(-towards, light.u.xyz));
    }
    return light.power.rgb * (share * max(dot(normal, towards), 0.0) / squared);
}
